//! Encodes messages of every supported type to bytes.

use crate::wire_writer::{EncodeError, WireWriter};
use crate::{
    Header, Imu, LandmarkEntry, LandmarkList, LaserScan, Message, NavSatFix, Odometry, PointCloud2,
    PointField, Pose, TransformStamped,
};

type Encoded = Result<(), EncodeError>;

/// Serialises a message for ROS 2 (`is_cdr`) or ROS 1 into `buffer`, which is reused.
pub fn encode(message: &Message, is_cdr: bool, buffer: Vec<u8>) -> Result<Vec<u8>, EncodeError> {
    let mut writer = WireWriter::new(is_cdr, buffer);
    let w = &mut writer;
    match message {
        Message::LaserScan(m) => laser_scan(w, m, |w, ranges| w.f32_sequence(ranges)),
        Message::MultiEchoLaserScan(m) => laser_scan(w, m, echoes),
        Message::PointCloud2(m) => point_cloud(w, m),
        Message::Imu(m) => imu(w, m),
        Message::Odometry(m) => odometry(w, m),
        Message::NavSatFix(m) => nav_sat_fix(w, m),
        Message::Tf(m) => sequence(w, &m.transforms, transform_stamped),
        Message::PoseStamped(m) => header(w, &m.header).map(|()| pose(w, &m.pose)),
        Message::TransformStamped(m) => transform_stamped(w, m),
        Message::LandmarkList(m) => landmark_list(w, m),
        Message::SensorPackets(_) => Err(EncodeError("raw packets are only read")),
        Message::Other { .. } => {
            Err(EncodeError("its type is not understood, so its content is not at hand"))
        }
    }?;
    Ok(writer.into_bytes())
}

fn header(w: &mut WireWriter, header: &Header) -> Encoded {
    if !w.is_cdr() {
        w.u32(0); // sequence number; readers must not rely on it
    }
    w.time(header.stamp)?;
    w.string(&header.frame_id)
}

/// `readings` writes the ranges or the intensities of all beams.
fn laser_scan<R>(
    w: &mut WireWriter,
    m: &LaserScan<R>,
    readings: impl Fn(&mut WireWriter, &[R]) -> Encoded,
) -> Encoded {
    header(w, &m.header)?;
    for value in
        [m.angle_min, m.angle_max, m.angle_increment, m.time_increment, m.scan_time, m.range_min, m.range_max]
    {
        w.f32(value);
    }
    readings(w, &m.ranges)?;
    readings(w, &m.intensities)
}

fn echoes(w: &mut WireWriter, readings: &[Vec<f32>]) -> Encoded {
    sequence(w, readings, |w, echoes: &Vec<f32>| w.f32_sequence(echoes))
}

fn point_cloud(w: &mut WireWriter, m: &PointCloud2) -> Encoded {
    header(w, &m.header)?;
    w.u32(m.height);
    w.u32(m.width);
    sequence(w, &m.fields, point_field)?;
    w.bool(m.is_bigendian);
    w.u32(m.point_step);
    w.u32(m.row_step);
    w.byte_sequence(&m.data)?;
    w.bool(m.is_dense);
    Ok(())
}

fn imu(w: &mut WireWriter, m: &Imu) -> Encoded {
    header(w, &m.header)?;
    w.f64_array(&m.orientation_xyzw);
    w.f64_array(&m.orientation_covariance);
    w.f64_array(&m.angular_velocity);
    w.f64_array(&m.angular_velocity_covariance);
    w.f64_array(&m.linear_acceleration);
    w.f64_array(&m.linear_acceleration_covariance);
    Ok(())
}

fn odometry(w: &mut WireWriter, m: &Odometry) -> Encoded {
    header(w, &m.header)?;
    w.string(&m.child_frame_id)?;
    pose(w, &m.pose);
    w.f64_array_of::<36>(&m.pose_covariance)?;
    w.f64_array(&m.linear_velocity);
    w.f64_array(&m.angular_velocity);
    w.f64_array_of::<36>(&m.twist_covariance)
}

fn nav_sat_fix(w: &mut WireWriter, m: &NavSatFix) -> Encoded {
    header(w, &m.header)?;
    w.i8(m.status);
    w.u16(m.service);
    w.f64(m.latitude_degrees);
    w.f64(m.longitude_degrees);
    w.f64(m.altitude);
    w.f64_array(&m.position_covariance);
    w.u8(m.position_covariance_type);
    Ok(())
}

fn transform_stamped(w: &mut WireWriter, m: &TransformStamped) -> Encoded {
    header(w, &m.header)?;
    w.string(&m.child_frame_id)?;
    pose(w, &m.transform);
    Ok(())
}

fn landmark_list(w: &mut WireWriter, m: &LandmarkList) -> Encoded {
    header(w, &m.header)?;
    sequence(w, &m.landmarks, landmark_entry)
}

fn landmark_entry(w: &mut WireWriter, m: &LandmarkEntry) -> Encoded {
    w.string(&m.id)?;
    pose(w, &m.tracking_from_landmark);
    w.f64(m.translation_weight);
    w.f64(m.rotation_weight);
    Ok(())
}

fn point_field(w: &mut WireWriter, m: &PointField) -> Encoded {
    w.string(&m.name)?;
    w.u32(m.offset);
    w.u8(m.field_type.map_or(0, |field_type| field_type as u8));
    w.u32(m.count);
    Ok(())
}

fn pose(w: &mut WireWriter, pose: &Pose) {
    w.f64_array(&pose.position);
    w.f64_array(&pose.orientation_xyzw);
}

fn sequence<T>(
    w: &mut WireWriter,
    elements: &[T],
    mut element: impl FnMut(&mut WireWriter, &T) -> Encoded,
) -> Encoded {
    w.length(elements.len())?;
    elements.iter().try_for_each(|e| element(w, e))
}
