//! Checks the odometry of one topic (check 2 of `spec/tools.md` §2.6): invalid poses, jumps, frames of maps
//! and missing motion.

use portolan_geometry::{Rigid3, Time, yaw};
use portolan_ingest::pose_of;
use portolan_issue::Severity;
use portolan_recording::Odometry;

use crate::finding::{Findings, Kind};

const INVALID: Kind = Kind {
    name: "invalid pose",
    severity: Severity::Error,
    effect: "poses that are not valid are left out; quaternions of a wrong length are normalised",
    to_do: "mend the source of odometry: quaternions must have length 1 and nothing may be NaN",
};
const JUMP: Kind = Kind {
    name: "odometry jump",
    severity: Severity::Error,
    effect: "the map breaks where odometry jumps, unless scans pull it back",
    to_do: "odometry must be continuous; use raw odometry instead of the output of a localisation",
};
const MAP_FRAME: Kind = Kind {
    name: "odometry in map",
    severity: Severity::Warning,
    effect: "poses in a map jump when that map is corrected; they are not used unless asked for",
    to_do: "use raw odometry",
};
const NO_MOTION: Kind = Kind {
    name: "no motion",
    severity: Severity::Info,
    effect: "odometry that never moves pulls the map towards standing still if the robot does move",
    to_do: "leave it out with --no-odometry if the robot did move",
};

/// Speed above which a motion is a jump, m/s: wheeled and legged robots are slower.
const MAX_SPEED: f64 = 40.0;
/// Angular velocity above which a motion is a jump, rad/s.
const MAX_TURN: f64 = 20.0;

/// Odometry of one topic.
#[derive(Debug, Default)]
pub(crate) struct OdometryChecks {
    last: Option<(Time, Rigid3)>,
    path: f64,
    turned: f64,
    /// Rotations between messages: start and end time, radians.
    pub turns: Vec<(Time, Time, f64)>,
}

/// Maximum number of rotations that are kept to compare with other sensors.
const MAX_TURNS: usize = 500_000;

impl OdometryChecks {
    pub fn add(&mut self, topic: &str, message: &Odometry, findings: &mut Findings) {
        let (frame, stamp) = (&message.header.frame_id, message.header.stamp);
        if matches!(&**frame, "map" | "world" | "earth") {
            findings.add(&MAP_FRAME, topic, || format!("poses are in frame_id \"{frame}\""));
        }
        let pose = match pose_of(&message.pose) {
            Some((pose, normalised)) => {
                if normalised {
                    findings.add(&INVALID, topic, || invalid_text(message));
                }
                pose
            }
            None => return findings.add(&INVALID, topic, || invalid_text(message)),
        };
        let Some((last_time, last)) = self.last.replace((stamp, pose)) else { return };
        let seconds = stamp.seconds_since(last_time);
        if seconds <= 0.0 {
            return;
        }
        let motion = last.inverse() * pose;
        let (distance, turn) = (motion.translation.vector.norm(), yaw(&motion.rotation));
        if distance > MAX_SPEED * seconds + 0.5 || turn.abs() > MAX_TURN * seconds + 0.5 {
            findings.add(&JUMP, topic, || {
                format!(
                    "the pose jumps by {distance:.2} m and {:.0}° within {seconds:.3} s at {stamp}",
                    turn.to_degrees()
                )
            });
            return;
        }
        self.path += distance;
        self.turned += turn.abs();
        if self.turns.len() < MAX_TURNS {
            self.turns.push((last_time, stamp, turn));
        }
    }

    /// Adds findings about the whole topic.
    pub fn finish(&self, topic: &str, findings: &mut Findings) {
        if self.turns.len() > 10 && self.path < 0.01 && self.turned < 0.01 {
            findings.add(&NO_MOTION, topic, || "odometry does not move at all".to_owned());
        }
    }
}

fn invalid_text(message: &Odometry) -> String {
    let pose = &message.pose;
    format!(
        "frame_id {} time {}: Odometry pose is invalid. pose {:?} {:?}",
        message.header.frame_id,
        message.header.stamp.unix_nanoseconds(),
        pose.position,
        pose.orientation_xyzw
    )
}
