//! Parses the header of Ouster packets: the contents of a packet, the sensor that sent it, and its frame
//! number.
//!
//! All packets except those with the legacy layout (`LEGACY`) begin with a header of 32 bytes, which has one
//! of two layouts.

use crate::bytes::{u16_at, u32_at, u64_at};
use crate::{PacketLayout, is_ouster_imu};

/// Bytes of the header of a packet, and of its footer.
pub(crate) const FRAME_BYTES: usize = 32;
/// Bytes of a packet with zones: header, time, hash of the zones, 16 zones, footer.
const ZONE_PACKET_BYTES: usize = FRAME_BYTES + 8 + 32 + 16 * 36 + FRAME_BYTES;
/// Valid serial numbers; they have twelve digits.
const SERIALS: std::ops::Range<u64> = 100_000_000_000..1_000_000_000_000;

/// Contents of a packet, from its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contents {
    Lidar,
    Imu,
    /// Monitored zones, or contents that later firmware may send.
    Other,
}

/// Layout of a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketHeader {
    /// `STANDARD`: frame numbers have 16 bits.
    Standard,
    /// `FUSA`, for functional safety: frame numbers have 32 bits.
    Fusa,
}

impl PacketHeader {
    /// Recognises the layout of a packet's header. In `STANDARD` the type has two bytes, of which the second
    /// is zero. In `FUSA` the sensor's initialization number starts at this second byte; it is zero there in
    /// one of 256 cases. These are decided by the serial number: where `FUSA` has it, `STANDARD` has zeros.
    pub fn of(packet: &[u8]) -> Self {
        let is_fusa = match (packet.first(), packet.get(1)) {
            (Some(1..=3), Some(0)) => SERIALS.contains(&Self::Fusa.serial_bits(packet)),
            (Some(1..=3), Some(_)) => true,
            _ => false,
        };
        if is_fusa { Self::Fusa } else { Self::Standard }
    }

    /// From its name in metadata.
    pub(crate) fn named(name: &str) -> Option<Self> {
        match name {
            "STANDARD" => Some(Self::Standard),
            "FUSA" => Some(Self::Fusa),
            _ => None,
        }
    }

    pub(crate) fn contents(self, packet: &[u8]) -> Contents {
        let kind = match self {
            Self::Standard => u16_at(packet, 0),
            Self::Fusa => packet.first().copied().map_or(0, u16::from),
        };
        match kind {
            1 => Contents::Lidar,
            2 => Contents::Imu,
            _ => Contents::Other,
        }
    }

    pub(crate) fn frame_number(self, packet: &[u8]) -> u32 {
        match self {
            Self::Standard => u32::from(u16_at(packet, 2)),
            Self::Fusa => u32_at(packet, 4),
        }
    }

    /// The serial number of the sensor; none if the header has none.
    pub fn serial(self, packet: &[u8]) -> Option<u64> {
        Some(self.serial_bits(packet)).filter(|serial| *serial != 0)
    }

    /// A number that changes with each start of the sensor; none if the header has none.
    pub fn initialization(self, packet: &[u8]) -> Option<u32> {
        let at = if self == Self::Standard { 4 } else { 1 };
        Some(u32_at(packet, at) & 0x00ff_ffff).filter(|number| *number != 0)
    }

    fn serial_bits(self, packet: &[u8]) -> u64 {
        let at = if self == Self::Standard { 7 } else { 11 };
        u64_at(packet, at) & 0x00ff_ffff_ffff
    }
}

/// Whether a packet was sent by an Ouster, but neither by its lidar nor by its IMU.
pub fn is_other_ouster_data(packet: &[u8]) -> bool {
    // Packets without a header may begin with any bytes.
    if PacketLayout::guess(packet).is_some() || is_ouster_imu(packet) {
        return false;
    }
    let header = PacketHeader::of(packet);
    let has_serial = SERIALS.contains(&header.serial_bits(packet));
    let kind = packet.first().copied().unwrap_or(0);
    (has_serial && kind >= 3 && header.contents(packet) == Contents::Other)
        || (kind == 3 && packet.len() == ZONE_PACKET_BYTES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_byte_orders_give_sensor_and_packet_kind() {
        let serial = 122_247_000_785_u64.to_le_bytes();
        let mut standard = vec![0; 64];
        standard[0] = 1;
        standard[2..4].copy_from_slice(&700_u16.to_le_bytes());
        standard[4..7].copy_from_slice(&[0x12, 0x34, 0x56]);
        standard[7..12].copy_from_slice(&serial[..5]);
        let header = PacketHeader::of(&standard);
        assert_eq!((header, header.contents(&standard)), (PacketHeader::Standard, Contents::Lidar));
        assert_eq!(header.initialization(&standard), Some(0x56_3412));
        assert_eq!((header.serial(&standard), header.frame_number(&standard)), (Some(122_247_000_785), 700));
        // The second initialization number has zero as its first byte.
        for initialization in [[0x12, 0x34, 0x56], [0, 0x34, 0x56]] {
            let mut fusa = vec![0; 64];
            fusa[0] = 2;
            fusa[1..4].copy_from_slice(&initialization);
            fusa[4..8].copy_from_slice(&70_000_u32.to_le_bytes());
            fusa[11..16].copy_from_slice(&serial[..5]);
            let header = PacketHeader::of(&fusa);
            assert_eq!((header, header.contents(&fusa)), (PacketHeader::Fusa, Contents::Imu));
            assert_eq!((header.serial(&fusa), header.frame_number(&fusa)), (Some(122_247_000_785), 70_000));
        }
        assert!(!is_other_ouster_data(&standard));
        standard[0] = 4;
        assert!(is_other_ouster_data(&standard) && !is_other_ouster_data(&[0; 64]));
    }
}
