//! Extracts UDP datagrams from captured frames: Ethernet, VLAN, IPv4 with fragments, IPv6.

use portolan_issue::{IssueKind, IssueLog};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Sender and destination port of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Endpoint {
    /// Address of the sender; IPv4 addresses fill the last four bytes.
    pub source: [u8; 16],
    /// Destination port.
    pub port: u16,
}

/// Maximum number of incomplete datagrams that wait for further fragments.
const MAX_WAITING: usize = 64;
/// Maximum size of a datagram, bytes.
const MAX_DATAGRAM: usize = 65_535;
const UDP: u8 = 17;

/// Reassembles datagrams.
#[derive(Default)]
pub struct Datagrams {
    waiting: BTreeMap<([u8; 8], u16), Pieces>,
    /// Counts up, to find the oldest incomplete datagram.
    age: u64,
}

struct Pieces {
    age: u64,
    bytes: Vec<u8>,
    /// Bytes received so far, and the total number, known once the last fragment has arrived.
    have: usize,
    total: Option<usize>,
}

impl Datagrams {
    /// The datagram that a frame of an interface contains or completes; `link_type` is the LINKTYPE of the
    /// capture.
    pub fn take<'a>(
        &mut self,
        link_type: u32,
        frame: &'a [u8],
        issues: &mut IssueLog,
    ) -> Option<(Endpoint, Cow<'a, [u8]>)> {
        let packet = network_packet(link_type, frame)?;
        match packet.first()? >> 4 {
            4 => self.take_ipv4(packet, issues),
            6 => {
                // Packets with extension headers are not supported.
                let source = packet.get(8..24)?.try_into().ok()?;
                let payload = packet.get(40..)?;
                (*packet.get(6)? == UDP).then(|| udp(source, Cow::Borrowed(payload))).flatten()
            }
            _ => None,
        }
    }

    fn take_ipv4<'a>(
        &mut self,
        packet: &'a [u8],
        issues: &mut IssueLog,
    ) -> Option<(Endpoint, Cow<'a, [u8]>)> {
        let header = usize::from(packet.first()? & 0xf) * 4;
        let total = usize::from(u16_at(packet, 2)?);
        // The length is 0 if the network card does the segmentation.
        let end = if total >= header && header >= 20 { total.min(packet.len()) } else { packet.len() };
        let payload = packet.get(header..end)?;
        if *packet.get(9)? != UDP {
            return None;
        }
        let mut source = [0; 16];
        source.get_mut(12..)?.copy_from_slice(packet.get(12..16)?);
        let flags = u16_at(packet, 6)?;
        let (offset, more) = (usize::from(flags & 0x1fff) * 8, flags & 0x2000 != 0);
        if offset == 0 && !more {
            return udp(source, Cow::Borrowed(payload));
        }
        let key = (packet.get(12..20)?.try_into().ok()?, u16_at(packet, 4)?);
        let whole = self.add_piece(key, offset, more, payload, issues)?;
        udp(source, Cow::Owned(whole))
    }

    fn add_piece(
        &mut self,
        key: ([u8; 8], u16),
        offset: usize,
        more: bool,
        payload: &[u8],
        issues: &mut IssueLog,
    ) -> Option<Vec<u8>> {
        let end = offset + payload.len();
        if end > MAX_DATAGRAM {
            issues.count(IssueKind::LongDatagram, 1);
            return None;
        }
        self.age += 1;
        let age = self.age;
        let pieces = self.waiting.entry(key).or_insert_with(|| Pieces {
            age,
            bytes: Vec::new(),
            have: 0,
            total: None,
        });
        if pieces.bytes.len() < end {
            pieces.bytes.resize(end, 0);
        }
        pieces.bytes.get_mut(offset..end)?.copy_from_slice(payload);
        pieces.have += payload.len();
        if !more {
            pieces.total = Some(end);
        }
        if pieces.total.is_some_and(|total| pieces.have >= total && pieces.bytes.len() == total) {
            return self.waiting.remove(&key).map(|pieces| pieces.bytes);
        }
        if self.waiting.len() > MAX_WAITING {
            let oldest = self.waiting.iter().min_by_key(|(_, pieces)| pieces.age).map(|(key, _)| *key);
            oldest.and_then(|key| self.waiting.remove(&key));
            issues.count(IssueKind::IncompleteDatagram, 1);
        }
        None
    }

    /// Counts the datagrams that were never completed.
    pub fn finish(&mut self, issues: &mut IssueLog) {
        let missing = self.waiting.len() as u64;
        if missing > 0 {
            issues.count(IssueKind::IncompleteDatagram, missing);
        }
        self.waiting.clear();
    }
}

/// The IP packet in a frame.
fn network_packet(link_type: u32, frame: &[u8]) -> Option<&[u8]> {
    let (mut kind_at, raw) = match link_type {
        1 => (12, None),                               // Ethernet
        113 => (14, None),                             // Linux cooked
        276 => (0, None),                              // Linux cooked, second version
        0 | 108 => (0, frame.get(4..)),                // loopback
        12 | 14 | 101 | 228 | 229 => (0, Some(frame)), // IP itself
        _ => return None,
    };
    if raw.is_some() {
        return raw;
    }
    if link_type == 276 {
        return matches!(u16_at(frame, 0)?, 0x0800 | 0x86dd).then(|| frame.get(20..)).flatten();
    }
    while matches!(u16_at(frame, kind_at)?, 0x8100 | 0x88a8) {
        kind_at += 4;
    }
    matches!(u16_at(frame, kind_at)?, 0x0800 | 0x86dd).then(|| frame.get(kind_at + 2..)).flatten()
}

fn udp(source: [u8; 16], bytes: Cow<'_, [u8]>) -> Option<(Endpoint, Cow<'_, [u8]>)> {
    let port = u16_at(&bytes, 2)?;
    let length = usize::from(u16_at(&bytes, 4)?);
    let end = if length >= 8 { length.min(bytes.len()) } else { bytes.len() };
    let payload = match bytes {
        Cow::Borrowed(bytes) => Cow::Borrowed(bytes.get(8..end)?),
        Cow::Owned(bytes) => Cow::Owned(bytes.get(8..end)?.to_vec()),
    };
    Some((Endpoint { source, port }, payload))
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes(bytes.get(at..at + 2)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An IPv4 packet without a link layer, with a fragment of a datagram from 10.0.0.1 to port 2368.
    fn piece(bytes: &[u8], offset: u16, more: bool) -> Vec<u8> {
        let length = (20 + bytes.len()) as u16;
        let flags = (offset / 8) | if more { 0x2000 } else { 0 };
        let mut packet = vec![0x45, 0];
        packet.extend(length.to_be_bytes());
        packet.extend([0, 7]);
        packet.extend(flags.to_be_bytes());
        packet.extend([64, UDP, 0, 0, 10, 0, 0, 1, 255, 255, 255, 255]);
        packet.extend(bytes);
        packet
    }

    #[test]
    fn pieces_in_any_order_make_a_datagram_and_missing_ones_are_counted() {
        const RAW_IP: u32 = 101;
        let mut datagram = vec![0x09, 0x40, 0x09, 0x40, 0, 28, 0, 0];
        datagram.extend(0..20);
        let (first, last) = (piece(&datagram[..16], 0, true), piece(&datagram[16..], 16, false));
        let (mut datagrams, mut issues) = (Datagrams::default(), IssueLog::default());
        assert_eq!(datagrams.take(RAW_IP, &last, &mut issues), None);
        let (endpoint, payload) = datagrams.take(RAW_IP, &first, &mut issues).unwrap();
        assert_eq!((endpoint.port, &endpoint.source[12..]), (2368, [10, 0, 0, 1].as_slice()));
        assert_eq!(*payload, datagram[8..]);
        assert_eq!(datagrams.take(RAW_IP, &first, &mut issues), None);
        datagrams.finish(&mut issues);
        assert_eq!(issues.counts(), BTreeMap::from([(IssueKind::IncompleteDatagram, 1)]));
    }
}
