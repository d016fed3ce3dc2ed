//! Decodes messages of every supported type from bytes.

use std::sync::Arc;

use crate::wire_reader::{DecodeError, WireReader};
use crate::{Encoding, MessageKind, is_static_tf_topic};
use crate::{
    FieldType, Header, Imu, LandmarkEntry, LandmarkList, LaserScan, Message, NavSatFix, Odometry, PacketKind,
    PointCloud2, PointField, Pose, PoseStamped, SensorPackets, TfMessage, TransformStamped,
};

/// Decodes messages. The names of frames are shared between messages, so that they are not allocated for
/// every message.
#[derive(Default)]
pub struct Decoder {
    frames: Vec<Arc<str>>,
}

/// Maximum number of frame names that are shared; a recording has few frames. Further names are not shared.
const MAX_SHARED_FRAMES: usize = 64;

type Decoded<T> = Result<T, DecodeError>;

impl Decoder {
    /// Decodes one message. Leading slashes of frame names are removed.
    pub fn decode(
        &mut self,
        kind: MessageKind,
        encoding: Encoding,
        topic: &str,
        bytes: &[u8],
    ) -> Decoded<Message> {
        let mut reader = WireReader::new(encoding, bytes)?;
        let r = &mut reader;
        let message = match kind {
            MessageKind::LaserScan => Message::LaserScan(self.laser_scan(r, WireReader::f32_sequence)?),
            MessageKind::MultiEchoLaserScan => {
                let echoes = |r: &mut WireReader<'_>| sequence(r, 4, WireReader::f32_sequence);
                Message::MultiEchoLaserScan(self.laser_scan(r, echoes)?)
            }
            MessageKind::PointCloud2 => Message::PointCloud2(self.point_cloud(r)?),
            MessageKind::PointCloud1 => Message::PointCloud2(self.point_cloud_1(r)?),
            MessageKind::Imu => Message::Imu(self.imu(r)?),
            MessageKind::Odometry => Message::Odometry(self.odometry(r)?),
            MessageKind::NavSatFix => Message::NavSatFix(self.nav_sat_fix(r)?),
            MessageKind::Tf => Message::Tf(self.tf(r, is_static_tf_topic(topic))?),
            MessageKind::PoseStamped => {
                Message::PoseStamped(PoseStamped { header: self.header(r)?, pose: pose(r)? })
            }
            MessageKind::LandmarkList => Message::LandmarkList(self.landmark_list(r)?),
            MessageKind::LivoxPoints => Message::PointCloud2(self.livox_points(r)?),
            MessageKind::VelodyneScan => Message::SensorPackets(self.velodyne_scan(r)?),
            MessageKind::OusterPacket => {
                let packets = vec![(None, r.byte_sequence()?)];
                Message::SensorPackets(SensorPackets { kind: PacketKind::Ouster, header: None, packets })
            }
            MessageKind::Text if topic.ends_with("metadata") => {
                let packets = vec![(None, r.string()?.into_owned().into_bytes())];
                Message::SensorPackets(SensorPackets {
                    kind: PacketKind::OusterMetadata,
                    header: None,
                    packets,
                })
            }
            MessageKind::Text => {
                return Ok(Message::Other { type_name: "std_msgs/String".into(), bytes: bytes.len() });
            }
        };
        reader.finish()?;
        Ok(message)
    }

    fn frame(&mut self, r: &mut WireReader<'_>) -> Decoded<Arc<str>> {
        let name = r.string()?;
        let name = name.trim_start_matches('/');
        if let Some(known) = self.frames.iter().find(|known| &***known == name) {
            return Ok(known.clone());
        }
        let name: Arc<str> = name.into();
        if self.frames.len() < MAX_SHARED_FRAMES {
            self.frames.push(name.clone());
        }
        Ok(name)
    }

    fn header(&mut self, r: &mut WireReader<'_>) -> Decoded<Header> {
        if !r.is_cdr() {
            let _sequence_number = r.u32()?;
        }
        Ok(Header { stamp: r.time()?, frame_id: self.frame(r)? })
    }

    /// `readings` reads the readings of all beams; it is called for the ranges, then for the intensities.
    fn laser_scan<'a, R>(
        &mut self,
        r: &mut WireReader<'a>,
        readings: impl Fn(&mut WireReader<'a>) -> Decoded<Vec<R>>,
    ) -> Decoded<LaserScan<R>> {
        Ok(LaserScan {
            header: self.header(r)?,
            angle_min: r.f32()?,
            angle_max: r.f32()?,
            angle_increment: r.f32()?,
            time_increment: r.f32()?,
            scan_time: r.f32()?,
            range_min: r.f32()?,
            range_max: r.f32()?,
            ranges: readings(r)?,
            intensities: readings(r)?,
        })
    }

    fn point_cloud(&mut self, r: &mut WireReader<'_>) -> Decoded<PointCloud2> {
        Ok(PointCloud2 {
            header: self.header(r)?,
            height: r.u32()?,
            width: r.u32()?,
            fields: sequence(r, 13, point_field)?,
            is_bigendian: r.bool()?,
            point_step: r.u32()?,
            row_step: r.u32()?,
            data: r.byte_sequence()?,
            is_dense: r.bool()?,
        })
    }

    fn imu(&mut self, r: &mut WireReader<'_>) -> Decoded<Imu> {
        Ok(Imu {
            header: self.header(r)?,
            orientation_xyzw: r.f64_array()?,
            orientation_covariance: r.f64_array()?,
            angular_velocity: r.f64_array()?,
            angular_velocity_covariance: r.f64_array()?,
            linear_acceleration: r.f64_array()?,
            linear_acceleration_covariance: r.f64_array()?,
        })
    }

    fn odometry(&mut self, r: &mut WireReader<'_>) -> Decoded<Odometry> {
        Ok(Odometry {
            header: self.header(r)?,
            child_frame_id: self.frame(r)?,
            pose: pose(r)?,
            pose_covariance: r.f64_array::<36>()?.to_vec(),
            linear_velocity: r.f64_array()?,
            angular_velocity: r.f64_array()?,
            twist_covariance: r.f64_array::<36>()?.to_vec(),
        })
    }

    fn nav_sat_fix(&mut self, r: &mut WireReader<'_>) -> Decoded<NavSatFix> {
        Ok(NavSatFix {
            header: self.header(r)?,
            status: r.i8()?,
            service: r.u16()?,
            latitude_degrees: r.f64()?,
            longitude_degrees: r.f64()?,
            altitude: r.f64()?,
            position_covariance: r.f64_array()?,
            position_covariance_type: r.u8()?,
        })
    }

    fn tf(&mut self, r: &mut WireReader<'_>, is_static: bool) -> Decoded<TfMessage> {
        let transforms = sequence(r, 72, |r| {
            Ok(TransformStamped {
                header: self.header(r)?,
                child_frame_id: self.frame(r)?,
                transform: pose(r)?,
            })
        })?;
        Ok(TfMessage { is_static, transforms })
    }

    /// Decodes Livox's own message to a cloud: x, y, z, intensity, and nanoseconds after the stamp.
    fn livox_points(&mut self, r: &mut WireReader<'_>) -> Decoded<PointCloud2> {
        let header = self.header(r)?;
        let _base_time = r.u64()?;
        let _number = r.u32()?;
        // Number of the lidar, and three reserved bytes.
        let _lidar = r.byte_array(4)?;
        let count = r.sequence_length(19)?;
        let mut data = Vec::with_capacity(20 * count);
        for _ in 0..count {
            let offset_time = r.u32()?;
            for value in [r.f32()?, r.f32()?, r.f32()?] {
                data.extend_from_slice(&value.to_le_bytes());
            }
            let (reflectivity, _tag, _line) = (r.u8()?, r.u8()?, r.u8()?);
            data.extend_from_slice(&f32::from(reflectivity).to_le_bytes());
            data.extend_from_slice(&offset_time.to_le_bytes());
        }
        let time = PointField { field_type: Some(FieldType::Uint32), ..float_field("offset_time", 16) };
        let names = ["x", "y", "z", "intensity"];
        let fields = names.iter().zip(0..).map(|(name, i)| float_field(name, 4 * i)).chain([time]).collect();
        let (width, row_step) = (count as u32, data.len() as u32);
        let (height, point_step, is_bigendian, is_dense) = (1, 20, false, true);
        Ok(PointCloud2 { header, height, width, fields, is_bigendian, point_step, row_step, data, is_dense })
    }

    /// Decodes a cloud whose channels each hold one value per point. Channels that do not have a value for
    /// every point are dropped.
    fn point_cloud_1(&mut self, r: &mut WireReader<'_>) -> Decoded<PointCloud2> {
        let header = self.header(r)?;
        let points: Vec<[f32; 3]> = sequence(r, 12, |r| Ok([r.f32()?, r.f32()?, r.f32()?]))?;
        let mut channels: Vec<(String, Vec<f32>)> =
            sequence(r, 8, |r| Ok((r.string()?.into_owned(), r.f32_sequence()?)))?;
        channels.retain(|(_, values)| values.len() == points.len());
        let mut data = Vec::new();
        for (i, point) in points.iter().enumerate() {
            let of_channels = channels.iter().filter_map(|(_, values)| values.get(i));
            point.iter().chain(of_channels).for_each(|value| data.extend_from_slice(&value.to_le_bytes()));
        }
        let names =
            ["x", "y", "z"].map(str::to_owned).into_iter().chain(channels.into_iter().map(|(name, _)| name));
        let fields: Vec<PointField> = names.zip(0..).map(|(name, i)| float_field(&name, 4 * i)).collect();
        let (width, row_step) = (points.len() as u32, data.len() as u32);
        let (height, point_step, is_bigendian, is_dense) = (1, 4 * fields.len() as u32, false, true);
        Ok(PointCloud2 { header, height, width, fields, is_bigendian, point_step, row_step, data, is_dense })
    }

    fn velodyne_scan(&mut self, r: &mut WireReader<'_>) -> Decoded<SensorPackets> {
        let header = Some(self.header(r)?);
        // A stamp and the bytes of a data packet.
        let packets = sequence(r, 8 + 1206, |r| Ok((Some(r.time()?), r.byte_array(1206)?)))?;
        Ok(SensorPackets { kind: PacketKind::Velodyne, header, packets })
    }

    fn landmark_list(&mut self, r: &mut WireReader<'_>) -> Decoded<LandmarkList> {
        Ok(LandmarkList { header: self.header(r)?, landmarks: sequence(r, 76, landmark_entry)? })
    }
}

/// A field of type `f32` in each point of a cloud.
fn float_field(name: &str, offset: u32) -> PointField {
    PointField { name: name.to_owned(), offset, field_type: Some(FieldType::Float32), count: 1 }
}

/// A sequence of composite elements that take at least `element_bytes` each.
fn sequence<'a, T>(
    r: &mut WireReader<'a>,
    element_bytes: usize,
    mut element: impl FnMut(&mut WireReader<'a>) -> Decoded<T>,
) -> Decoded<Vec<T>> {
    let length = r.sequence_length(element_bytes)?;
    (0..length).map(|_| element(r)).collect()
}

fn pose(r: &mut WireReader<'_>) -> Decoded<Pose> {
    Ok(Pose { position: r.f64_array()?, orientation_xyzw: r.f64_array()? })
}

fn point_field(r: &mut WireReader<'_>) -> Decoded<PointField> {
    Ok(PointField {
        name: r.string()?.into_owned(),
        offset: r.u32()?,
        field_type: match r.u8()? {
            1 => Some(FieldType::Int8),
            2 => Some(FieldType::Uint8),
            3 => Some(FieldType::Int16),
            4 => Some(FieldType::Uint16),
            5 => Some(FieldType::Int32),
            6 => Some(FieldType::Uint32),
            7 => Some(FieldType::Float32),
            8 => Some(FieldType::Float64),
            _ => None,
        },
        count: r.u32()?,
    })
}

fn landmark_entry(r: &mut WireReader<'_>) -> Decoded<LandmarkEntry> {
    Ok(LandmarkEntry {
        id: r.string()?.into_owned(),
        tracking_from_landmark: pose(r)?,
        translation_weight: r.f64()?,
        rotation_weight: r.f64()?,
    })
}
