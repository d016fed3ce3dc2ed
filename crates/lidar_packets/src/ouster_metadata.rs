//! Reads the metadata of Ouster sensors (JSON), with defaults for missing values.

use serde_json::Value;

use crate::ouster::USUAL_COLUMNS;
use crate::{PacketHeader, PacketLayout, PacketProfile};

/// Properties of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct OusterMetadata {
    /// Elevation of the beam above the plane of rotation, degrees, by channel.
    pub altitudes: Vec<f64>,
    /// Offset of the beam from the azimuth of the column, degrees, by channel.
    pub azimuths: Vec<f64>,
    /// Origin of the beams: distance ahead of the axis, and height above the origin of the lidar's frame,
    /// metres.
    pub beam_origin: [f64; 2],
    /// Columns per revolution.
    pub columns_per_frame: usize,
    /// Columns per packet.
    pub columns_per_packet: usize,
    /// None if it is not given.
    pub profile: Option<PacketProfile>,
    /// None if it is not given.
    pub header: Option<PacketHeader>,
    /// Serial number of the sensor; none if the metadata do not contain it.
    pub serial: Option<u64>,
    /// A number that changes with each start of the sensor; none if the metadata do not contain it.
    pub initialization: Option<u32>,
    /// Port to which it sends lidar packets.
    pub lidar_port: Option<u16>,
    /// Extrinsics sensor from lidar: rows of the rotation matrix, and the translation in metres.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl OusterMetadata {
    /// Default for a sensor with this number of channels: beams at equal angles over the field of view of an
    /// OS1, and as many columns as were seen.
    pub fn assumed(channels: usize, columns_per_frame: usize) -> Self {
        let half = if channels == 16 { 16.6 } else { 22.5 };
        let gaps = channels.saturating_sub(1).max(1) as f64;
        Self {
            altitudes: (0..channels).map(|i| half - 2.0 * half * i as f64 / gaps).collect(),
            azimuths: [3.1, 1.0, -1.0, -3.1].into_iter().cycle().take(channels).collect(),
            beam_origin: [0.0158, 0.0],
            columns_per_frame,
            columns_per_packet: USUAL_COLUMNS,
            profile: None,
            header: None,
            serial: None,
            initialization: None,
            lidar_port: None,
            rotation: [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0, 0.0, 0.03618],
        }
    }

    /// Parses the JSON of any firmware; values may be at the top level or in sections. None if it has no beam
    /// angles.
    pub fn parse(text: &str) -> Option<Self> {
        let json = Json(serde_json::from_str(text).ok()?);
        let altitudes = json.numbers("beam_altitude_angles")?;
        let azimuths = json.numbers("beam_azimuth_angles")?;
        let is_usable = |list: &[f64]| list.iter().all(|v| v.is_finite() && v.abs() <= 360.0);
        if !matches!(altitudes.len(), 1..=256)
            || altitudes.len() != azimuths.len()
            || !is_usable(&altitudes)
            || !is_usable(&azimuths)
        {
            return None;
        }
        let mode = json.text("lidar_mode");
        let mode_columns = mode.and_then(|mode| mode.split('x').next()?.parse::<f64>().ok());
        let columns = json.number("columns_per_frame").or(mode_columns).unwrap_or(1024.0);
        let per_packet = json.number("columns_per_packet").unwrap_or(16.0);
        if !(1.0..=65_536.0).contains(&columns) || !(1.0..=256.0).contains(&per_packet) {
            return None;
        }
        let mut metadata = Self::assumed(altitudes.len(), columns as usize);
        (metadata.altitudes, metadata.azimuths) = (altitudes, azimuths);
        metadata.columns_per_packet = per_packet as usize;
        metadata.beam_origin = json.beam_origin();
        metadata.take_transform(&json);
        metadata.take_identity(&json);
        Some(metadata)
    }

    fn take_transform(&mut self, json: &Json) {
        let matrix = json.matrix("lidar_to_sensor_transform");
        if let Some([a, b, c, _]) = matrix.as_deref().map(|m| m.as_chunks::<4>().0) {
            self.rotation = [a, b, c].map(|[x, y, z, _]| [*x, *y, *z]);
            self.translation = [a, b, c].map(|[.., millimetres]| 0.001 * millimetres);
        }
    }

    /// Reads the packet layout, the serial number, the initialization number and the port.
    fn take_identity(&mut self, json: &Json) {
        self.profile = json.text("udp_profile_lidar").and_then(PacketProfile::named);
        // Before firmware 3.2 the profile determined the header.
        let usual_header = self.profile.map(|profile| match profile {
            PacketProfile::FusaLowDataDual => PacketHeader::Fusa,
            _ => PacketHeader::Standard,
        });
        self.header = json.text("header_type").and_then(PacketHeader::named).or(usual_header);
        self.serial = json.whole("prod_sn").filter(|serial| *serial != 0);
        self.initialization = json.whole("initialization_id").and_then(|id| u32::try_from(id).ok());
        self.lidar_port = json.whole("udp_port_lidar").and_then(|port| u16::try_from(port).ok());
    }

    /// The layout of a packet: that of the profile in the metadata, or of another one with the same number of
    /// beams and the same length.
    pub fn layout_of(&self, packet: &[u8]) -> Option<PacketLayout> {
        let candidates = self.profile.into_iter().chain(PacketProfile::ALL);
        candidates.map(|profile| self.layout(profile, packet)).find(|l| l.packet_bytes() == packet.len())
    }

    /// Whether packets match these metadata: same length, and column numbers below the columns per
    /// revolution.
    pub fn describe(&self, packet: &[u8], largest_column: u16) -> bool {
        let is_as_long = match self.profile {
            Some(profile) => self.layout(profile, packet).packet_bytes() == packet.len(),
            None => self.layout_of(packet).is_some(),
        };
        is_as_long && usize::from(largest_column) < self.columns_per_frame
    }

    /// Whether a packet decodes to the same points with these metadata and with `other`.
    pub fn agrees(&self, other: &Self, packet: &[u8]) -> bool {
        let nameless = |metadata: &Self| Self {
            serial: None,
            initialization: None,
            lidar_port: None,
            profile: None,
            header: None,
            ..metadata.clone()
        };
        self.layout_of(packet) == other.layout_of(packet) && nameless(self) == nameless(other)
    }

    /// Bytes of a packet with its profile; none if the metadata do not name a profile.
    pub fn packet_bytes(&self) -> Option<usize> {
        self.profile.map(|profile| self.layout(profile, &[]).packet_bytes())
    }

    fn layout(&self, profile: PacketProfile, packet: &[u8]) -> PacketLayout {
        let header = self.header.unwrap_or_else(|| PacketHeader::of(packet));
        PacketLayout { profile, header, channels: self.altitudes.len(), columns: self.columns_per_packet }
    }

    /// Transforms a point from the lidar's frame to the sensor's frame, metres.
    pub fn sensor_from_lidar(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let turned = self.rotation.map(|[a, b, c]| a * x + b * y + c * z);
        let ([x, y, z], [a, b, c]) = (turned, self.translation);
        [x + a, y + b, z + c]
    }
}

/// The metadata of a sensor as JSON.
struct Json(Value);

impl Json {
    /// Finds a value, first among the active settings. The requested settings have the same keys but may not
    /// be active.
    fn find(&self, key: &str) -> Option<&Value> {
        let in_force = find(&self.0, "lidar_data_format", 0).and_then(|section| find(section, key, 0));
        in_force.or_else(|| find(&self.0, key, 0))
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.find(key).and_then(Value::as_f64)
    }

    fn text(&self, key: &str) -> Option<&str> {
        self.find(key).and_then(Value::as_str)
    }

    /// An integer, which may be written as text.
    fn whole(&self, key: &str) -> Option<u64> {
        let value = self.find(key)?;
        value.as_u64().or_else(|| value.as_str()?.trim().parse().ok())
    }

    fn numbers(&self, key: &str) -> Option<Vec<f64>> {
        self.find(key)?.as_array()?.iter().map(Value::as_f64).collect()
    }

    fn matrix(&self, key: &str) -> Option<Vec<f64>> {
        self.numbers(key).filter(|m| m.len() == 16 && m.iter().all(|v| v.is_finite()))
    }

    /// Origin of the beams, ahead and above, metres: from the transform of the beams, else from the distance
    /// to the axis alone, else the default of the model.
    fn beam_origin(&self) -> [f64; 2] {
        let is_near = |mm: &f64| mm.abs() < 1000.0;
        let matrix = self.matrix("beam_to_lidar_transform");
        let of_transform = matrix.as_deref().map(|m| m.as_chunks::<4>().0).and_then(|rows| match rows {
            [[.., ahead], _, [.., above], _] if is_near(ahead) && is_near(above) => {
                Some([0.001 * ahead, 0.001 * above])
            }
            _ => None,
        });
        let declared = || self.number("lidar_origin_to_beam_origin_mm").filter(is_near);
        of_transform.unwrap_or_else(|| {
            let millimetres =
                declared().unwrap_or_else(|| usual_origin(self.text("prod_line").unwrap_or("")));
            [0.001 * millimetres, 0.0]
        })
    }
}

/// Distance of the beams' origin from the axis for sensors whose metadata do not have it, millimetres
/// (Ouster's SDK, `default_lidar_origin_to_beam_origin`). Sensors of the first generation name no model.
fn usual_origin(model: &str) -> f64 {
    match model.get(..5) {
        Some("OS-0-") => 27.67,
        Some("OS-1-") => 15.806,
        Some("OS-2-") => 13.762,
        _ => 12.163,
    }
}

/// The first value with a key, in sections nested up to four levels.
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
