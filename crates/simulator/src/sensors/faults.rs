//! Faults as real recordings have them, injected on purpose.

use std::fmt;
use std::str::FromStr;

use portolan_geometry::{Duration, Rigid2, Time, normalize_angle};
use portolan_recording::{Header, Imu, Message, Odometry, PointCloud2, RecordedMessage};

use crate::SimulatorError;

/// Sensor that has a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FaultTarget {
    /// All lidars.
    Scan,
    /// The wheels.
    Odometry,
    /// The IMU.
    Imu,
}

/// One fault. Messages are counted per topic from 1; times are seconds since the start. In text the
/// parts are joined by colons, as shown for each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// `duplicate:SENSOR:N`: every N-th message has the stamp of the one before.
    DuplicateStamp {
        /// The sensor.
        target: FaultTarget,
        /// N, at least 2.
        every: u64,
    },
    /// `backward:SENSOR:N:SECONDS`: the stamp of every N-th message is too early by this time.
    BackwardStamp {
        /// The sensor.
        target: FaultTarget,
        /// N, at least 2.
        every: u64,
        /// Seconds, more than 0.
        seconds: f64,
    },
    /// `gap:SENSOR:FROM:TO`: no messages during this time.
    Gap {
        /// The sensor.
        target: FaultTarget,
        /// Seconds since the start.
        from: f64,
        /// Seconds since the start, not included.
        to: f64,
    },
    /// `nan:N`: every N-th scan has only NaN.
    NanScan {
        /// N, at least 1.
        every: u64,
    },
    /// `empty:N`: every N-th scan has no ranges at all.
    EmptyScan {
        /// N, at least 1.
        every: u64,
    },
    /// `jump:SECONDS:X:Y:YAW`: from this time on odometry continues from a pose that is off by this much,
    /// in metres and radians in the frame of the robot.
    OdometryJump {
        /// Seconds since the start.
        at: f64,
        /// Metres ahead.
        x: f64,
        /// Metres to the left.
        y: f64,
        /// Radians to the left.
        yaw: f64,
    },
    /// `no-gravity`: the IMU removes gravity from its accelerations.
    ImuWithoutGravity,
    /// `clock:SENSOR:SECONDS`: the stamps are late by this time (negative: early).
    ClockOffset {
        /// The sensor.
        target: FaultTarget,
        /// Added to stamps, seconds.
        seconds: f64,
    },
    /// `dies:SECONDS`: from this time on the last lidar sends no messages.
    Death {
        /// Seconds since the start.
        at: f64,
    },
    /// `saturate:GYROSCOPE:ACCELEROMETER`: the values of the IMU are clamped to these.
    Saturation {
        /// rad/s.
        angular_velocity: f64,
        /// m/s².
        acceleration: f64,
    },
    /// `swap-axes`: the IMU is rotated by 90° about its x axis, which no message reports.
    SwappedAxes,
    /// `no-tf:SENSOR`: the transform of its frame is not in the recording (`scan` and `imu`).
    MissingTransform {
        /// The sensor.
        target: FaultTarget,
    },
}

impl FaultTarget {
    fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Odometry => "odom",
            Self::Imu => "imu",
        }
    }
}

impl fmt::Display for FaultTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DuplicateStamp { target, every } => write!(f, "duplicate:{target}:{every}"),
            Self::BackwardStamp { target, every, seconds } => {
                write!(f, "backward:{target}:{every}:{seconds}")
            }
            Self::Gap { target, from, to } => write!(f, "gap:{target}:{from}:{to}"),
            Self::NanScan { every } => write!(f, "nan:{every}"),
            Self::EmptyScan { every } => write!(f, "empty:{every}"),
            Self::OdometryJump { at, x, y, yaw } => write!(f, "jump:{at}:{x}:{y}:{yaw}"),
            Self::ImuWithoutGravity => write!(f, "no-gravity"),
            Self::ClockOffset { target, seconds } => write!(f, "clock:{target}:{seconds}"),
            Self::Death { at } => write!(f, "dies:{at}"),
            Self::Saturation { angular_velocity, acceleration } => {
                write!(f, "saturate:{angular_velocity}:{acceleration}")
            }
            Self::SwappedAxes => write!(f, "swap-axes"),
            Self::MissingTransform { target } => write!(f, "no-tf:{target}"),
        }
    }
}

impl FromStr for Fault {
    type Err = SimulatorError;
    fn from_str(text: &str) -> Result<Self, SimulatorError> {
        let parts: Vec<&str> = text.split(':').collect();
        parse(&parts)
            .filter(Fault::is_sensible)
            .ok_or_else(|| SimulatorError::BadFault { text: text.to_owned() })
    }
}

fn parse(parts: &[&str]) -> Option<Fault> {
    let target = |i: usize| {
        let name = parts.get(i)?;
        [FaultTarget::Scan, FaultTarget::Odometry, FaultTarget::Imu].into_iter().find(|t| t.name() == *name)
    };
    let number = |i: usize| parts.get(i)?.parse::<f64>().ok();
    let every = |i: usize| parts.get(i)?.parse::<u64>().ok();
    let (fault, length) = match *parts.first()? {
        "duplicate" => (Fault::DuplicateStamp { target: target(1)?, every: every(2)? }, 3),
        "backward" => (Fault::BackwardStamp { target: target(1)?, every: every(2)?, seconds: number(3)? }, 4),
        "gap" => (Fault::Gap { target: target(1)?, from: number(2)?, to: number(3)? }, 4),
        "nan" => (Fault::NanScan { every: every(1)? }, 2),
        "empty" => (Fault::EmptyScan { every: every(1)? }, 2),
        "jump" => (Fault::OdometryJump { at: number(1)?, x: number(2)?, y: number(3)?, yaw: number(4)? }, 5),
        "no-gravity" => (Fault::ImuWithoutGravity, 1),
        "clock" => (Fault::ClockOffset { target: target(1)?, seconds: number(2)? }, 3),
        "dies" => (Fault::Death { at: number(1)? }, 2),
        "saturate" => (Fault::Saturation { angular_velocity: number(1)?, acceleration: number(2)? }, 3),
        "swap-axes" => (Fault::SwappedAxes, 1),
        "no-tf" => (Fault::MissingTransform { target: target(1)? }, 2),
        _ => return None,
    };
    (parts.len() == length).then_some(fault)
}

impl Fault {
    /// Whether its numbers are valid.
    pub(crate) fn is_sensible(&self) -> bool {
        match *self {
            Self::DuplicateStamp { every, .. } => every >= 2,
            Self::BackwardStamp { every, seconds, .. } => every >= 2 && seconds > 0.0 && seconds < 1e10,
            Self::Gap { from, to, .. } => from.is_finite() && to.is_finite() && from < to,
            Self::NanScan { every } | Self::EmptyScan { every } => every >= 1,
            Self::OdometryJump { at, x, y, yaw } => [at, x, y, yaw].iter().all(|v| v.is_finite()),
            Self::ClockOffset { seconds, .. } => seconds.is_finite() && seconds.abs() < 1e6,
            Self::MissingTransform { target } => target != FaultTarget::Odometry,
            Self::ImuWithoutGravity | Self::SwappedAxes => true,
            Self::Death { at } => at.is_finite(),
            Self::Saturation { angular_velocity, acceleration } => {
                angular_velocity > 0.0 && acceleration > 0.0
            }
        }
    }

    /// The sensor that has it.
    fn target(&self) -> FaultTarget {
        match *self {
            Self::DuplicateStamp { target, .. }
            | Self::BackwardStamp { target, .. }
            | Self::Gap { target, .. }
            | Self::ClockOffset { target, .. }
            | Self::MissingTransform { target } => target,
            Self::NanScan { .. } | Self::EmptyScan { .. } | Self::Death { .. } => FaultTarget::Scan,
            Self::OdometryJump { .. } => FaultTarget::Odometry,
            Self::ImuWithoutGravity | Self::Saturation { .. } | Self::SwappedAxes => FaultTarget::Imu,
        }
    }
}

/// Rejects faults whose numbers are not valid, and those of sensors that are not recorded.
pub(crate) fn check_faults(faults: &[Fault], recorded: &[FaultTarget]) -> Result<(), SimulatorError> {
    for fault in faults {
        let text = fault.to_string();
        if !fault.is_sensible() {
            return Err(SimulatorError::BadFault { text });
        }
        let target = fault.target();
        if !recorded.contains(&target) {
            let sensor = match target {
                FaultTarget::Scan => "lidar",
                FaultTarget::Odometry => "odometry",
                FaultTarget::Imu => "IMU",
            };
            return Err(SimulatorError::FaultWithoutSensor { text, sensor });
        }
    }
    Ok(())
}

/// Puts faults into the messages of one topic, which must be given in order.
#[derive(Clone, Debug)]
pub(crate) struct FaultFilter {
    faults: Vec<Fault>,
    target: FaultTarget,
    count: u64,
    last_stamp: Option<Time>,
    /// Transform by which odometry is multiplied from the left after jumps.
    jump: Rigid2,
    /// Number of jumps that have happened.
    jumps_done: usize,
    gravity: f64,
}

impl FaultFilter {
    /// The faults that concern one sensor; `gravity` is the specific force that its IMU measures at rest,
    /// m/s².
    pub fn new(faults: &[Fault], target: FaultTarget, gravity: f64) -> Self {
        let faults: Vec<Fault> = faults.iter().filter(|fault| fault.target() == target).copied().collect();
        let jump = Rigid2::identity();
        Self { faults, target, count: 0, last_stamp: None, jump, jumps_done: 0, gravity }
    }

    /// Whether a measurement at `seconds` since the start falls into a gap.
    pub fn is_gap(&self, seconds: f64) -> bool {
        self.faults.iter().any(|fault| match fault {
            Fault::Gap { target, from, to } => *target == self.target && (*from..*to).contains(&seconds),
            Fault::Death { at } => seconds >= *at,
            _ => false,
        })
    }

    /// The message with its faults, or none in a gap. Measured at `seconds` since the start.
    pub fn apply(&mut self, mut recorded: RecordedMessage, seconds: f64) -> Option<RecordedMessage> {
        if self.faults.is_empty() {
            return Some(recorded);
        }
        if self.is_gap(seconds) {
            return None;
        }
        self.count += 1;
        let before = self.last_stamp;
        self.spoil_content(&mut recorded.message, seconds);
        if let Some(header) = header_mut(&mut recorded.message) {
            self.spoil_stamp(header, before);
            self.last_stamp = Some(header.stamp);
        }
        Some(recorded)
    }

    fn spoil_stamp(&self, header: &mut Header, before: Option<Time>) {
        for fault in &self.faults {
            match *fault {
                Fault::ClockOffset { seconds, .. } => header.stamp += Duration::from_seconds(seconds),
                Fault::BackwardStamp { every, seconds, .. } if self.count.is_multiple_of(every) => {
                    header.stamp -= Duration::from_seconds(seconds);
                }
                Fault::DuplicateStamp { every, .. } if self.count.is_multiple_of(every) => {
                    header.stamp = before.unwrap_or(header.stamp);
                }
                _ => {}
            }
        }
    }

    fn spoil_content(&mut self, message: &mut Message, seconds: f64) {
        match message {
            Message::LaserScan(scan) => {
                for fault in &self.faults {
                    match *fault {
                        Fault::NanScan { every } if self.count.is_multiple_of(every) => {
                            scan.ranges.fill(f32::NAN);
                        }
                        Fault::EmptyScan { every } if self.count.is_multiple_of(every) => {
                            scan.ranges.clear();
                            scan.intensities.clear();
                        }
                        _ => {}
                    }
                }
            }
            Message::PointCloud2(cloud) => {
                for fault in &self.faults {
                    match *fault {
                        Fault::NanScan { every } if self.count.is_multiple_of(every) => spoil_points(cloud),
                        Fault::EmptyScan { every } if self.count.is_multiple_of(every) => {
                            cloud.data.clear();
                            (cloud.width, cloud.row_step) = (0, 0);
                        }
                        _ => {}
                    }
                }
            }
            Message::Odometry(odometry) => self.jump(odometry, seconds),
            Message::Imu(imu) => self.spoil_imu(imu),
            _ => {}
        }
    }

    fn spoil_imu(&self, imu: &mut Imu) {
        for fault in &self.faults {
            match *fault {
                Fault::ImuWithoutGravity => imu.linear_acceleration[2] -= self.gravity,
                Fault::SwappedAxes => {
                    for [_, y, z] in [&mut imu.linear_acceleration, &mut imu.angular_velocity] {
                        (*y, *z) = (*z, -*y);
                    }
                }
                _ => {}
            }
        }
        // Last, since the sensor itself cannot measure larger values.
        for fault in &self.faults {
            if let Fault::Saturation { angular_velocity, acceleration } = *fault {
                imu.angular_velocity =
                    imu.angular_velocity.map(|v| v.clamp(-angular_velocity, angular_velocity));
                imu.linear_acceleration =
                    imu.linear_acceleration.map(|v| v.clamp(-acceleration, acceleration));
            }
        }
    }

    /// Multiplies the pose from the left so that it jumps in its own frame when a jump is due.
    fn jump(&mut self, odometry: &mut Odometry, seconds: f64) {
        let [_, _, z, w] = odometry.pose.orientation_xyzw;
        let [x, y, _] = odometry.pose.position;
        let pose = Rigid2::new(x, y, 2.0 * libm::atan2(z, w));
        let due: Vec<Rigid2> = self
            .faults
            .iter()
            .filter_map(|fault| match *fault {
                Fault::OdometryJump { at, x, y, yaw } if seconds >= at => Some(Rigid2::new(x, y, yaw)),
                _ => None,
            })
            .collect();
        for offset in due.iter().skip(self.jumps_done) {
            self.jump = self.jump * pose * *offset * pose.inverse();
        }
        self.jumps_done = self.jumps_done.max(due.len());
        if self.jumps_done > 0 {
            let spoiled = self.jump * pose;
            let (sine, cosine) = libm::sincos(0.5 * normalize_angle(spoiled.angle));
            odometry.pose.position = [spoiled.translation.x, spoiled.translation.y, 0.0];
            odometry.pose.orientation_xyzw = [0.0, 0.0, sine, cosine];
        }
    }
}

/// Writes NaN into x, y and z, the first three fields of simulated clouds.
fn spoil_points(cloud: &mut PointCloud2) {
    for point in cloud.data.chunks_exact_mut((cloud.point_step as usize).max(12)) {
        for value in point.chunks_exact_mut(4).take(3) {
            value.copy_from_slice(&f32::NAN.to_le_bytes());
        }
    }
}

fn header_mut(message: &mut Message) -> Option<&mut Header> {
    match message {
        Message::LaserScan(m) => Some(&mut m.header),
        Message::PointCloud2(m) => Some(&mut m.header),
        Message::Imu(m) => Some(&mut m.header),
        Message::Odometry(m) => Some(&mut m.header),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_text_is_a_fault_or_an_error(text in "[a-z-]{0,10}(:[-a-z0-9.]{0,6}){0,5}") {
            if let Ok(fault) = text.parse::<Fault>() {
                prop_assert_eq!(fault.to_string().parse::<Fault>().ok(), Some(fault));
            }
        }
    }

    #[test]
    fn faults_are_read_as_they_are_written() {
        for text in [
            "duplicate:scan:50",
            "backward:odom:20:0.25",
            "gap:imu:10:15.5",
            "nan:7",
            "empty:9",
            "jump:30:1:-0.5:0.3",
            "no-gravity",
            "clock:imu:-0.05",
            "no-tf:scan",
            "dies:45.5",
            "saturate:4:30",
            "swap-axes",
        ] {
            assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
        }
        for text in
            ["", "gap:scan:5:4", "nan:0", "duplicate:scan:1", "no-tf:odom", "nan:3:4", "clock:wheel:1"]
        {
            let error = text.parse::<Fault>().unwrap_err().to_string();
            assert!(error.contains("duplicate:SENSOR:N"), "{error}");
        }
    }
}
