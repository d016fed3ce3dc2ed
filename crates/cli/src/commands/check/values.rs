//! Values of single messages: ranges, accelerations, poses.

use portolan_geometry::pose_from_xyz_quaternion;
use portolan_recording::{Imu, LaserScan, Message, Odometry};

use super::finding::{Findings, Kind, Severity};

const BAD_SCAN: Kind = Kind {
    name: "bad scan",
    severity: Severity::Error,
    effect: "the scan cannot be used",
    advice: "mend the driver",
};
const EMPTY: Kind = Kind {
    name: "empty",
    severity: Severity::Warning,
    effect: "nothing can be matched at that moment",
    advice: "check range_min and range_max, and whether something covers the sensor",
};
const ACCELERATION: Kind = Kind {
    name: "acceleration",
    severity: Severity::Warning,
    effect: "the direction of gravity, which everything in space hangs on, is wrong",
    advice: "the acceleration must include gravity and be in m/s^2; leave the IMU out with --no-imu in the plane",
};
const ODOMETRY: Kind = Kind {
    name: "odometry",
    severity: Severity::Error,
    effect: "the message cannot be used",
    advice: "mend the driver, or leave odometry out with --no-odometry",
};

/// Checks the values of a message.
pub fn check(topic: &str, message: &Message, findings: &mut Findings) {
    match message {
        Message::LaserScan(scan) => check_scan(topic, scan, findings),
        Message::PointCloud2(cloud) if cloud.data.is_empty() => {
            findings.add(&EMPTY, topic, || format!("{topic} has clouds without a point"));
        }
        Message::Imu(imu) => check_imu(topic, imu, findings),
        Message::Odometry(odometry) => check_odometry(topic, odometry, findings),
        _ => {}
    }
}

fn check_scan(topic: &str, scan: &LaserScan, findings: &mut Findings) {
    let at = || scan.header.stamp.unix_decimal();
    let sensible =
        scan.angle_min.is_finite() && scan.angle_increment.is_finite() && scan.time_increment >= 0.0;
    if !sensible || (scan.angle_increment == 0.0 && scan.ranges.len() > 1) {
        findings.add(&BAD_SCAN, topic, || {
            format!("{topic} has a scan whose angles or times make no sense at {}", at())
        });
    }
    let is_return = |range: &f32| range.is_finite() && *range > scan.range_min && *range <= scan.range_max;
    if !scan.ranges.iter().any(is_return) {
        findings.add(&EMPTY, topic, || format!("{topic} has a scan without any return at {}", at()));
    }
}

fn check_imu(topic: &str, imu: &Imu, findings: &mut Findings) {
    let acceleration = imu.linear_acceleration.iter().map(|a| a * a).sum::<f64>().sqrt();
    let is_plausible =
        (3.0..=30.0).contains(&acceleration) && imu.angular_velocity.iter().all(|w| w.is_finite());
    if !is_plausible {
        findings.add(&ACCELERATION, topic, || {
            format!(
                "{topic} measures {acceleration:.3} m/s^2 at {}; 3 to 30 m/s^2 are plausible",
                imu.header.stamp.unix_decimal()
            )
        });
    }
}

fn check_odometry(topic: &str, odometry: &Odometry, findings: &mut Findings) {
    if pose_from_xyz_quaternion(odometry.pose.position, odometry.pose.orientation_xyzw).is_none() {
        findings.add(&ODOMETRY, topic, || {
            format!("{topic} has a pose that is none at {}", odometry.header.stamp.unix_decimal())
        });
    }
}
