//! Reads captures of network traffic: the classic `pcap` format and `pcapng`, in either byte order.

use portolan_geometry::{Duration, Time};

use crate::RecordingError;
use crate::container::{FileBytes, Source};
use portolan_issue::{IssueKind, IssueLog};

/// Maximum length of a captured packet and of a block, bytes; larger lengths are taken as damage.
const MAX_PACKET: u32 = 1 << 20;
const MAX_BLOCK: u32 = 1 << 24;
/// Maximum number of interfaces of one section; further ones are ignored.
const MAX_INTERFACES: usize = 256;
/// The file is read in pieces of this size, bytes.
const PIECE: u64 = 1 << 20;

/// Whether bytes begin like a capture.
pub(crate) fn sniff(prefix: &[u8]) -> bool {
    matches!(
        prefix,
        [0xd4, 0xc3, 0xb2, 0xa1, ..]
            | [0xa1, 0xb2, 0xc3, 0xd4, ..]
            | [0x4d, 0x3c, 0xb2, 0xa1, ..]
            | [0xa1, 0xb2, 0x3c, 0x4d, ..]
            | [0x0a, 0x0d, 0x0d, 0x0a, ..]
    )
}

/// One captured frame.
pub(crate) struct Frame<'a> {
    /// Time of capture; none where the format does not give it.
    pub time: Option<Time>,
    /// Type of the frames of the interface (LINKTYPE of pcap).
    pub link_type: u32,
    pub bytes: &'a [u8],
}

#[derive(Clone, Copy, Debug)]
struct Interface {
    link_type: u32,
    /// Units of its times per second.
    ticks_per_second: u64,
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Classic { ticks_per_second: u64, link_type: u32 },
    NextGeneration,
}

/// Reads frames one after the other.
pub(crate) struct CaptureReader {
    file: FileBytes,
    format: Format,
    is_big: bool,
    interfaces: Vec<Interface>,
    position: u64,
    /// Bytes of the file from `start`.
    window: Vec<u8>,
    start: u64,
}

impl CaptureReader {
    /// Starts at the beginning; none if the bytes are not a capture.
    pub fn open(source: &Source) -> Result<Option<Self>, RecordingError> {
        let mut file = source.open()?;
        let head = file.peek(0, 24)?.to_vec();
        let magic = [0, 1, 2, 3].map(|i| head.get(i).copied().unwrap_or(0));
        let (format, is_big, position) = match magic {
            [0x0a, 0x0d, 0x0d, 0x0a] => (Format::NextGeneration, false, 0),
            [0xd4, 0xc3, 0xb2, 0xa1] => (classic(&head, 1_000_000, false), false, 24),
            [0xa1, 0xb2, 0xc3, 0xd4] => (classic(&head, 1_000_000, true), true, 24),
            [0x4d, 0x3c, 0xb2, 0xa1] => (classic(&head, 1_000_000_000, false), false, 24),
            [0xa1, 0xb2, 0x3c, 0x4d] => (classic(&head, 1_000_000_000, true), true, 24),
            _ => return Ok(None),
        };
        let (interfaces, window) = (Vec::new(), Vec::new());
        Ok(Some(Self { file, format, is_big, interfaces, position, window, start: 0 }))
    }

    /// Bytes consumed so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The next frame; none at the end, or if the rest cannot be parsed.
    pub fn next_frame(&mut self, issues: &mut IssueLog) -> Result<Option<Frame<'_>>, RecordingError> {
        match self.format {
            Format::Classic { ticks_per_second, link_type } => {
                let is_big = self.is_big;
                let Some(head) = self.bytes(self.position, 16)? else { return self.end(issues) };
                let [seconds, fraction, length] = [0, 4, 8].map(|at| u32_of(head, at, is_big));
                if length > MAX_PACKET {
                    issues.add(IssueKind::DamagedCapture);
                    return Ok(None);
                }
                let at = self.position + 16;
                self.position = at + u64::from(length);
                let time = time_of(u64::from(seconds), u64::from(fraction), ticks_per_second);
                if self.position > self.file.length() {
                    return self.end(issues);
                }
                self.frame(at, length as usize, Some(time), link_type)
            }
            Format::NextGeneration => self.next_block_frame(issues),
        }
    }

    fn end(&mut self, issues: &mut IssueLog) -> Result<Option<Frame<'_>>, RecordingError> {
        if self.position > self.file.length()
            || (self.position < self.file.length() && self.file.length() > 24)
        {
            issues.add(IssueKind::CutCapture);
        }
        self.position = self.file.length();
        Ok(None)
    }

    fn next_block_frame(&mut self, issues: &mut IssueLog) -> Result<Option<Frame<'_>>, RecordingError> {
        loop {
            let (at, is_big) = (self.position, self.is_big);
            let Some(head) = self.bytes(at, 12)? else { return self.end(issues) };
            let mut kind = u32_of(head, 0, is_big);
            if head.starts_with(&[0x0a, 0x0d, 0x0d, 0x0a]) {
                kind = 0x0a0d_0d0a;
                self.is_big = head.get(8..12) == Some(&[0x1a, 0x2b, 0x3c, 0x4d]);
                self.interfaces.clear();
            }
            let is_big = self.is_big;
            let length = self.bytes(at, 12)?.map_or(0, |head| u32_of(head, 4, is_big));
            if !(12..=MAX_BLOCK).contains(&length) || length % 4 != 0 {
                issues.add(IssueKind::DamagedCapture);
                return Ok(None);
            }
            self.position = at + u64::from(length);
            let Some(block) = self.bytes(at, length as usize)? else { return self.end(issues) };
            match kind {
                1 => {
                    let interface = interface_of(block, is_big);
                    if self.interfaces.len() < MAX_INTERFACES {
                        self.interfaces.push(interface);
                    }
                }
                6 => {
                    let number = u32_of(block, 8, is_big) as usize;
                    let (high, low) = (u32_of(block, 12, is_big), u32_of(block, 16, is_big));
                    let captured = u32_of(block, 20, is_big) as usize;
                    let Some(interface) = self.interfaces.get(number).copied() else {
                        issues.add(IssueKind::UnknownInterface);
                        continue;
                    };
                    let ticks = (u64::from(high) << 32) | u64::from(low);
                    let per_second = interface.ticks_per_second;
                    let time = time_of(ticks / per_second, ticks % per_second, per_second);
                    let bytes =
                        self.bytes(at, length as usize)?.and_then(|block| block.get(28..28 + captured));
                    if bytes.is_none() {
                        issues.add(IssueKind::WrongPacketLength);
                        continue;
                    }
                    return self.frame(at + 28, captured, Some(time), interface.link_type);
                }
                3 => {
                    let original = u32_of(block, 8, is_big) as usize;
                    let captured = original.min(length as usize - 16);
                    let link_type = self.interfaces.first().map_or(1, |interface| interface.link_type);
                    return self.frame(at + 12, captured, None, link_type);
                }
                _ => {}
            }
        }
    }

    fn frame(
        &mut self,
        at: u64,
        length: usize,
        time: Option<Time>,
        link_type: u32,
    ) -> Result<Option<Frame<'_>>, RecordingError> {
        let bytes = self.bytes(at, length)?.unwrap_or_default();
        Ok(Some(Frame { time, link_type, bytes }))
    }

    /// `count` bytes of the file from `at`; none if the file ends before.
    fn bytes(&mut self, at: u64, count: usize) -> Result<Option<&[u8]>, RecordingError> {
        let end = at.saturating_add(count as u64);
        if end > self.file.length() {
            return Ok(None);
        }
        if at < self.start || end > self.start + self.window.len() as u64 {
            self.file.read(at, PIECE.max(count as u64), &mut self.window)?;
            self.start = at;
        }
        let from = (at - self.start) as usize;
        Ok(self.window.get(from..from + count))
    }
}

fn classic(head: &[u8], ticks_per_second: u64, is_big: bool) -> Format {
    // The upper bits of the link type describe check sums.
    Format::Classic { ticks_per_second, link_type: u32_of(head, 20, is_big) & 0x0fff_ffff }
}

/// Parses the type of frames and the unit of times of an interface block.
fn interface_of(block: &[u8], is_big: bool) -> Interface {
    let link_type = u32::from(u16_of(block, 8, is_big));
    let mut ticks_per_second = 1_000_000;
    let mut at = 16;
    while let Some(option) = block.get(at..at + 4) {
        let (code, length) = (u16_of(option, 0, is_big), usize::from(u16_of(option, 2, is_big)));
        if code == 0 {
            break;
        }
        if let (9, Some(resolution)) = (code, block.get(at + 4)) {
            let exponent = u32::from(resolution & 0x7f);
            let base: u64 = if resolution & 0x80 == 0 { 10 } else { 2 };
            ticks_per_second = base.checked_pow(exponent).unwrap_or(ticks_per_second).max(1);
        }
        at += 4 + length.next_multiple_of(4);
    }
    Interface { link_type, ticks_per_second }
}

fn time_of(seconds: u64, fraction: u64, ticks_per_second: u64) -> Time {
    let part = (fraction as f64 / ticks_per_second as f64 * 1e7).round() as i64;
    Time::from_ros(i64::try_from(seconds).unwrap_or(i64::MAX), 0) + Duration::from_ticks(part)
}

fn u32_of(bytes: &[u8], at: usize, is_big: bool) -> u32 {
    let value = bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).unwrap_or([0; 4]);
    if is_big { u32::from_be_bytes(value) } else { u32::from_le_bytes(value) }
}

fn u16_of(bytes: &[u8], at: usize, is_big: bool) -> u16 {
    let value = bytes.get(at..at + 2).and_then(|b| b.try_into().ok()).unwrap_or([0; 2]);
    if is_big { u16::from_be_bytes(value) } else { u16::from_le_bytes(value) }
}
