//! Message definitions, which containers include so that other tools can decode the messages that we write.

use std::fmt::Write;

/// Language of message definitions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// ROS 1: `time` is a primitive and headers are numbered.
    Ros1,
    /// ROS 2.
    Ros2,
}

/// MD5 sum of a type that can be written; ROS 1 compares types by it.
pub fn md5sum(type_name: &str) -> Option<&'static str> {
    Some(match type_name {
        "sensor_msgs/LaserScan" => "90c7ef2dc6895d81024acba2ac42f369",
        "sensor_msgs/MultiEchoLaserScan" => "6fefb0c6da89d7c8abe4b339f5c2f8fb",
        "sensor_msgs/PointCloud2" => "1158d486dd51d683ce2f1be655c3c181",
        "sensor_msgs/Imu" => "6a62c6daae103f4ff57a132d6f95cec2",
        "nav_msgs/Odometry" => "cd5e73d190d741a2f92e81eda573aca7",
        "sensor_msgs/NavSatFix" => "2d3a8cd499b9b4a0249fb98fd05cfa48",
        "tf2_msgs/TFMessage" => "94810edda583a504dfda3829e70d7eec",
        "geometry_msgs/PoseStamped" => "d3812c3cbc69362b77dc0b19b345f8f5",
        "geometry_msgs/TransformStamped" => "b5764a33bfeb3588febc2682852579b0",
        "cartographer_ros_msgs/LandmarkList" => "322e3fb6b49d8fcd97544b4896b0ae66",
        _ => return None,
    })
}

/// The full definition: the fields of the type, then those of every type that it contains.
pub fn definition(type_name: &str, dialect: Dialect) -> Option<String> {
    let mut text = fields(type_name, dialect)?.to_owned();
    let mut done = vec![type_name];
    let mut open = parts(text.as_str()).collect::<Vec<_>>();
    open.reverse();
    while let Some(part) = open.pop() {
        let Some((name, part_fields)) = FIELDS.iter().find(|(name, _)| *name == part) else { continue };
        if done.contains(name) {
            continue;
        }
        done.push(name);
        let part_fields = fields(name, dialect).unwrap_or(part_fields);
        let _ = write!(text, "\n{}\nMSG: {name}\n{part_fields}", "=".repeat(80));
        let mut inner: Vec<String> = parts(part_fields).collect();
        inner.reverse();
        open.extend(inner);
    }
    Some(text)
}

/// Names of the composite types among the fields.
fn parts(fields: &str) -> impl Iterator<Item = String> {
    fields
        .lines()
        .filter_map(|line| line.split([' ', '[']).next())
        .filter(|part| part.contains('/'))
        .map(str::to_owned)
}

fn fields(type_name: &str, dialect: Dialect) -> Option<&'static str> {
    if type_name == "std_msgs/Header" && dialect == Dialect::Ros1 {
        return Some("uint32 seq\ntime stamp\nstring frame_id\n");
    }
    FIELDS.iter().find(|(name, _)| *name == type_name).map(|(_, fields)| *fields)
}

/// Fields of every type, in the order in which they are serialised.
const FIELDS: &[(&str, &str)] = &[
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    (
        "sensor_msgs/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
         float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\n\
         float32[] ranges\nfloat32[] intensities\n",
    ),
    ("sensor_msgs/LaserEcho", "float32[] echoes\n"),
    (
        "sensor_msgs/MultiEchoLaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
         float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\n\
         sensor_msgs/LaserEcho[] ranges\nsensor_msgs/LaserEcho[] intensities\n",
    ),
    (
        "sensor_msgs/PointField",
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n\
         uint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    ),
    (
        "sensor_msgs/PointCloud2",
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n\
         bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    ),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"),
    ("geometry_msgs/TwistWithCovariance", "geometry_msgs/Twist twist\nfloat64[36] covariance\n"),
    ("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n"),
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "sensor_msgs/Imu",
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\n\
         float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity\n\
         float64[9] angular_velocity_covariance\ngeometry_msgs/Vector3 linear_acceleration\n\
         float64[9] linear_acceleration_covariance\n",
    ),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist\n",
    ),
    (
        "sensor_msgs/NavSatStatus",
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n\
         uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\n\
         uint16 SERVICE_GALILEO=8\nint8 status\nuint16 service\n",
    ),
    (
        "sensor_msgs/NavSatFix",
        "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n\
         uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\n\
         std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n\
         float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n",
    ),
    (
        "cartographer_ros_msgs/LandmarkEntry",
        "string id\ngeometry_msgs/Pose tracking_from_landmark_transform\nfloat64 translation_weight\n\
         float64 rotation_weight\n",
    ),
    (
        "cartographer_ros_msgs/LandmarkList",
        "std_msgs/Header header\ncartographer_ros_msgs/LandmarkEntry[] landmarks\n",
    ),
];
