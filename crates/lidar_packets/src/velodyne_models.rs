//! Models of Velodyne sensors: directions and firing times of their beams (user manuals of VLP-16, VLP-32C,
//! HDL-32E and HDL-64E).

use std::f64::consts::PI;

use crate::bytes::u16_at;

/// Bytes of every data packet.
pub(crate) const PACKET_BYTES: usize = 1206;
/// Blocks per packet, bytes per block, channels per block.
pub(crate) const BLOCKS: usize = 12;
pub(crate) const BLOCK_BYTES: usize = 100;
pub(crate) const CHANNELS: usize = 32;
/// First two bytes of a block: beams 0 to 31, or 32 to 63 of an HDL-64E.
pub(crate) const UPPER: u16 = 0xeeff;
pub(crate) const LOWER: u16 = 0xddff;

/// A sensor model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VelodyneModel {
    /// 16 beams within ±15°, also Puck LITE.
    Vlp16,
    /// 16 beams within ±10°.
    PuckHiRes,
    /// VLP-32C "Ultra Puck".
    Vlp32c,
    /// 32 beams, -30.67° to 10.67°.
    Hdl32e,
    /// 64 beams; each sensor has its own calibration.
    Hdl64e,
}

/// One beam: angles in radians, offsets in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Laser {
    /// Angle above the plane of rotation.
    pub elevation: f64,
    /// Subtracted from the azimuth of the block.
    pub azimuth: f64,
    /// Added to the distance.
    pub distance: f64,
    /// Offset of the beam's origin perpendicular to the beam, upwards.
    pub vertical_offset: f64,
    /// Offset of the beam's origin perpendicular to the beam, to the left.
    pub horizontal_offset: f64,
    /// Number counted from the lowest beam.
    pub ring: u16,
}

/// Order of the beams of an HDL-64E within each block of 32, starting with the lowest.
const HDL64_ORDER: [usize; 32] = [
    6, 7, 10, 11, 0, 1, 4, 5, 8, 9, 14, 15, 18, 19, 22, 23, 12, 13, 16, 17, 20, 21, 26, 27, 30, 31, 2, 3, 24,
    25, 28, 29,
];
/// Nominal azimuth offsets of the beams of the upper block of an HDL-64E, degrees.
const HDL64_SPREAD: [f64; 32] = [
    -4.0, -2.2, 4.0, 6.0, 0.8, 2.2, 0.0, 1.5, 4.8, 6.4, 4.0, 6.0, -3.8, -2.0, -4.8, -2.8, 0.5, 2.2, 0.0, 1.7,
    4.9, 6.3, 4.0, 6.0, -3.5, -2.0, -4.6, -2.7, 0.6, 2.0, -0.2, 1.7,
];
/// Elevations of the beams of a VLP-32C in the order of a packet, degrees.
const VLP32_ELEVATIONS: [f64; 32] = [
    -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333,
    0.667, -4.0, -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0, 7.0, 4.667, -2.333, -2.0,
    15.0, 10.333, -1.333,
];
/// Their azimuth offsets, degrees, added to the azimuth of a block.
const VLP32_OFFSETS: [f64; 32] = [
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4,
    -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4,
];

impl VelodyneModel {
    /// The model from a data packet. Unknown products count as a VLP-16; then the second result is false.
    pub fn of(packet: &[u8]) -> (Self, bool) {
        let is_lower = (0..BLOCKS).any(|block| u16_at(packet, block * BLOCK_BYTES) == LOWER);
        if is_lower {
            return (Self::Hdl64e, true);
        }
        match packet.get(PACKET_BYTES - 1) {
            Some(0x21) => (Self::Hdl32e, true),
            Some(0x22 | 0x23) => (Self::Vlp16, true),
            Some(0x24) => (Self::PuckHiRes, true),
            Some(0x28) => (Self::Vlp32c, true),
            _ => (Self::Vlp16, false),
        }
    }

    /// Manufacturer and model, for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vlp16 => "Velodyne VLP-16",
            Self::PuckHiRes => "Velodyne Puck Hi-Res",
            Self::Vlp32c => "Velodyne VLP-32C",
            Self::Hdl32e => "Velodyne HDL-32E",
            Self::Hdl64e => "Velodyne HDL-64E",
        }
    }

    /// Metres per unit of distance.
    pub fn distance_unit(self) -> f64 {
        if self == Self::Vlp32c { 0.004 } else { 0.002 }
    }

    /// Duration of one block, seconds (of one of a pair, where two returns or two halves share an azimuth).
    pub fn block_time(self) -> f64 {
        match self {
            Self::Vlp16 | Self::PuckHiRes => 110.592e-6,
            Self::Vlp32c => 55.296e-6,
            Self::Hdl32e => 46.08e-6,
            Self::Hdl64e => 48.0e-6,
        }
    }

    /// Time from the start of a block to the firing of a channel, seconds.
    pub fn channel_delay(self, channel: usize) -> f64 {
        match self {
            Self::Vlp16 | Self::PuckHiRes => {
                (channel / 16) as f64 * 55.296e-6 + (channel % 16) as f64 * 2.304e-6
            }
            Self::Vlp32c => (channel / 2) as f64 * 2.304e-6,
            Self::Hdl32e => channel as f64 * 1.152e-6,
            Self::Hdl64e => 0.0,
        }
    }

    /// Beam number of a channel.
    pub fn laser_of(self, channel: usize, is_lower: bool) -> usize {
        match self {
            Self::Vlp16 | Self::PuckHiRes => channel % 16,
            Self::Hdl64e if is_lower => channel + CHANNELS,
            _ => channel,
        }
    }

    /// The beams by their numbers. Those of an HDL-64E are nominal, because each unit has its own
    /// calibration.
    pub fn lasers(self) -> Vec<Laser> {
        let degrees: Vec<[f64; 2]> = match self {
            Self::Vlp16 => puck(15.0),
            Self::PuckHiRes => puck(10.0),
            Self::Vlp32c => VLP32_ELEVATIONS.into_iter().zip(VLP32_OFFSETS).map(|(e, o)| [e, -o]).collect(),
            Self::Hdl32e => {
                let base = |i: usize| if i.is_multiple_of(2) { -30.67 } else { -9.33 };
                (0..32).map(|i| [base(i) + (i / 2) as f64 * 4.0 / 3.0, 0.0]).collect()
            }
            Self::Hdl64e => {
                let mut ranks: Vec<(usize, f64)> =
                    HDL64_ORDER.into_iter().zip((0..).map(f64::from)).collect();
                ranks.sort_by_key(|(laser, _)| *laser);
                let block = |lowest: f64, step: f64, spread: f64| {
                    let lasers = ranks.iter().zip(HDL64_SPREAD);
                    lasers.map(move |((_, rank), azimuth)| [lowest + step * rank, spread * azimuth])
                };
                block(-8.52, 0.34, 1.0).chain(block(-24.7, 0.51, 1.7)).collect()
            }
        };
        let laser = |[elevation, azimuth]: &[f64; 2]| Laser {
            elevation: elevation * PI / 180.0,
            azimuth: azimuth * PI / 180.0,
            distance: 0.0,
            vertical_offset: 0.0,
            horizontal_offset: 0.0,
            ring: 0,
        };
        with_rings(degrees.iter().map(laser).collect())
    }
}

/// The interleaved beams of a Puck: even ones from the lowest upwards, odd ones from the middle upwards.
fn puck(half_angle: f64) -> Vec<[f64; 2]> {
    let step = 2.0 * half_angle / 15.0;
    let rank = |i: usize| if i.is_multiple_of(2) { i / 2 } else { 8 + i / 2 };
    (0..16).map(|i| [-half_angle + step * rank(i) as f64, 0.0]).collect()
}

/// Numbers the rings from the lowest beam.
pub(crate) fn with_rings(mut lasers: Vec<Laser>) -> Vec<Laser> {
    let mut order: Vec<&mut Laser> = lasers.iter_mut().collect();
    order.sort_by(|a, b| a.elevation.total_cmp(&b.elevation));
    for (ring, laser) in order.into_iter().enumerate() {
        laser.ring = ring as u16;
    }
    lasers
}

/// Parses a calibration in the format of `velodyne_pointcloud` (YAML with a list `lasers`, keys `laser_id`,
/// `vert_correction`, `rot_correction`, `dist_correction`, `vert_offset_correction`,
/// `horiz_offset_correction`; metres and radians). None if the text is not a calibration.
pub fn parse_calibration(text: &str) -> Option<Vec<Laser>> {
    let mut lasers: Vec<(Option<usize>, Laser)> = Vec::new();
    let words = text.split(['\n', ',', '{', '}']);
    let blank = Laser {
        elevation: 0.0,
        azimuth: 0.0,
        distance: 0.0,
        vertical_offset: 0.0,
        horizontal_offset: 0.0,
        ring: 0,
    };
    for word in words {
        let word = word.trim();
        let starts_entry = word.starts_with('-') && !word.starts_with("--");
        if starts_entry {
            lasers.push((None, blank));
        }
        let Some((key, value)) = word.trim_start_matches("- ").trim().split_once(':') else { continue };
        let (Some((id, laser)), Ok(value)) = (lasers.last_mut(), value.trim().parse::<f64>()) else {
            continue;
        };
        match key.trim() {
            "laser_id" if (0.0..128.0).contains(&value) => *id = Some(value as usize),
            "vert_correction" => laser.elevation = value,
            "rot_correction" => laser.azimuth = value,
            "dist_correction" => laser.distance = value,
            "vert_offset_correction" => laser.vertical_offset = value,
            "horiz_offset_correction" => laser.horizontal_offset = value,
            _ => {}
        }
    }
    let count = lasers.iter().filter_map(|(id, _)| *id).max()? + 1;
    let mut table = vec![None; count];
    for (id, laser) in lasers {
        *table.get_mut(id?)? = Some(laser);
    }
    let table: Vec<Laser> = table.into_iter().collect::<Option<_>>()?;
    let is_finite =
        |l: &Laser| [l.elevation, l.azimuth, l.distance, l.vertical_offset].iter().all(|v| v.is_finite());
    (matches!(count, 16 | 32 | 64) && table.iter().all(is_finite)).then(|| with_rings(table))
}
