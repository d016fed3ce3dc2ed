//! What Ouster's sensors tell about themselves (JSON), and what is assumed where they do not.

use serde_json::Value;

/// Layouts of the channels of lidar packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketProfile {
    /// `LEGACY`, of all firmware before 2.2.
    Legacy,
    /// `RNG19_RFL8_SIG16_NIR16`.
    Single,
    /// `RNG15_RFL8_NIR8`.
    LowData,
    /// `RNG19_RFL8_SIG16_NIR16_DUAL`.
    Dual,
    /// `FUSA_RNG15_RFL8_NIR8_DUAL`.
    LowDataDual,
}

impl PacketProfile {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Legacy, Self::Single, Self::LowData, Self::Dual, Self::LowDataDual];

    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "LEGACY" => Self::Legacy,
            "RNG19_RFL8_SIG16_NIR16" => Self::Single,
            "RNG15_RFL8_NIR8" => Self::LowData,
            "RNG19_RFL8_SIG16_NIR16_DUAL" => Self::Dual,
            "FUSA_RNG15_RFL8_NIR8_DUAL" => Self::LowDataDual,
            _ => return None,
        })
    }
}

/// What is known about a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct OusterMetadata {
    /// Degrees above the plane of rotation, by channel.
    pub altitudes: Vec<f64>,
    /// Degrees from the azimuth of the column, by channel.
    pub azimuths: Vec<f64>,
    /// Distance of the beams' origin from the axis, metres.
    pub beam_origin: f64,
    /// Columns of a whole revolution.
    pub columns_per_frame: usize,
    /// Columns of a packet.
    pub columns_per_packet: usize,
    /// None if it is not given.
    pub profile: Option<PacketProfile>,
    /// Rows of the rotation and the translation in metres.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl OusterMetadata {
    /// What is assumed about a sensor with so many channels: beams at equal angles over the field of view
    /// of an OS1, as many columns as were seen.
    pub fn assumed(channels: usize, columns_per_frame: usize) -> Self {
        let half = if channels == 16 { 16.6 } else { 22.5 };
        let gaps = channels.saturating_sub(1).max(1) as f64;
        Self {
            altitudes: (0..channels).map(|i| half - 2.0 * half * i as f64 / gaps).collect(),
            azimuths: [3.1, 1.0, -1.0, -3.1].into_iter().cycle().take(channels).collect(),
            beam_origin: 0.0158,
            columns_per_frame,
            columns_per_packet: crate::ouster::USUAL_COLUMNS,
            profile: None,
            rotation: [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 0.03618],
        }
    }

    /// Reads the JSON of any firmware; values may stand at the top or in sections. None if it has no angles
    /// of beams.
    pub fn parse(text: &str) -> Option<Self> {
        let root: Value = serde_json::from_str(text).ok()?;
        let numbers = |key: &str| -> Option<Vec<f64>> {
            find(&root, key, 0)?.as_array()?.iter().map(Value::as_f64).collect()
        };
        let number = |key: &str| find(&root, key, 0).and_then(Value::as_f64);
        let text = |key: &str| find(&root, key, 0).and_then(Value::as_str);
        let (altitudes, azimuths) = (numbers("beam_altitude_angles")?, numbers("beam_azimuth_angles")?);
        let is_usable = |list: &[f64]| list.iter().all(|v| v.is_finite() && v.abs() <= 360.0);
        if !matches!(altitudes.len(), 1..=256)
            || altitudes.len() != azimuths.len()
            || !is_usable(&altitudes)
            || !is_usable(&azimuths)
        {
            return None;
        }
        let mode_columns = text("lidar_mode").and_then(|mode| mode.split('x').next()?.parse::<f64>().ok());
        let columns = number("columns_per_frame").or(mode_columns).unwrap_or(1024.0);
        let per_packet = number("columns_per_packet").unwrap_or(16.0);
        if !(1.0..=65_536.0).contains(&columns) || !(1.0..=256.0).contains(&per_packet) {
            return None;
        }
        let mut metadata = Self::assumed(altitudes.len(), columns as usize);
        (metadata.altitudes, metadata.azimuths) = (altitudes, azimuths);
        metadata.columns_per_packet = per_packet as usize;
        metadata.profile = text("udp_profile_lidar").and_then(PacketProfile::named);
        if let Some(origin) = number("lidar_origin_to_beam_origin_mm").filter(|mm| mm.abs() < 1000.0) {
            metadata.beam_origin = 0.001 * origin;
        }
        let matrix = numbers("lidar_to_sensor_transform").filter(|m| m.len() == 16);
        if let Some([a, b, c, _]) = matrix.as_deref().map(|m| m.as_chunks::<4>().0) {
            metadata.rotation = [a, b, c].map(|[x, y, z, _]| [*x, *y, *z]);
            metadata.translation = [a, b, c].map(|[.., millimetres]| 0.001 * millimetres);
        }
        Some(metadata)
    }

    /// A point of the lidar's frame in that of the sensor, metres.
    pub fn sensor_from_lidar(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let turned = self.rotation.map(|[a, b, c]| a * x + b * y + c * z);
        let ([x, y, z], [a, b, c]) = (turned, self.translation);
        [x + a, y + b, z + c]
    }
}

/// The first value of a key, in sections of up to four levels.
fn find<'a>(value: &'a Value, key: &str, depth: usize) -> Option<&'a Value> {
    let object = value.as_object()?;
    if let Some(found) = object.get(key) {
        return Some(found);
    }
    if depth >= 4 {
        return None;
    }
    object.values().find_map(|inner| find(inner, key, depth + 1))
}
