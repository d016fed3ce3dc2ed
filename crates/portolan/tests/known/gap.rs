//! Recordings in which scans are missing for a while, or see nothing of the place.

use portolan::geometry::nalgebra::Quaternion as Numbers;
use portolan::geometry::{Quaternion, Rigid3, Time, Vector3};
use portolan::recording::{Message, Pose, RecordedMessage, RecordingError, RecordingWriter};

/// What becomes of scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scans {
    LeftOut,
    /// Something covers the scanner, 0.1 to 0.3 m away.
    Covered,
    /// No beam returns.
    Blind,
}

/// Leaves out, covers or blinds scans between two times, while the wheels stall if that is wanted.
pub struct Gap {
    pub inner: Box<dyn RecordingWriter>,
    pub between: [Time; 2],
    pub scans: Scans,
    /// The last pose of odometry before the gap and in it, if its wheels stall.
    pub stalled: Option<[Rigid3; 2]>,
}

fn rigid(pose: &Pose) -> Rigid3 {
    let [x, y, z, w] = pose.orientation_xyzw;
    let rotation = Quaternion::from_quaternion(Numbers::new(w, x, y, z));
    Rigid3::from_parts(Vector3::from(pose.position).into(), rotation)
}

impl RecordingWriter for Gap {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let mut message = message.clone();
        let is_after = |time: Time| message.log_time >= time;
        let [begun, ended] = self.between.map(is_after);
        match (&mut message.message, &mut self.stalled) {
            (Message::LaserScan(_), _) if begun && !ended && self.scans == Scans::LeftOut => return Ok(()),
            (Message::LaserScan(scan), _) if begun && !ended && self.scans == Scans::Blind => {
                scan.ranges.fill(f32::INFINITY);
            }
            (Message::LaserScan(scan), _) if begun && !ended => {
                // No two scans are covered alike.
                let seed = scan.ranges.first().map_or(0.0, |range| f64::from(*range)) * 1e4;
                for (i, range) in scan.ranges.iter_mut().enumerate() {
                    *range = 0.2 + 0.1 * (seed + 37.0 * i as f64).sin() as f32;
                }
            }
            (Message::Odometry(odometry), Some([before, within])) => {
                let pose = rigid(&odometry.pose);
                if !begun {
                    *before = pose;
                }
                if !ended {
                    *within = pose;
                }
                let shown = *before * within.inverse() * pose;
                odometry.pose.position = shown.translation.vector.into();
                odometry.pose.orientation_xyzw = shown.rotation.coords.into();
            }
            _ => {}
        }
        self.inner.write(&message)
    }

    fn finish(self: Box<Self>) -> Result<(), RecordingError> {
        self.inner.finish()
    }
}
