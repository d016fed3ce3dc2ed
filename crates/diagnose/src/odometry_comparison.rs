//! Whether odometry tells the motion that a planar scanner sees, and by how much the two are stamped apart, measured before
//! mapping begins.

use portolan_geometry::{Duration, Rigid2, Rigid3, Time, TransformBuffer, Vector3};
use portolan_ingest::{Inventory, PlannedOdometry, SensorPlan, pose_of};
use portolan_recording::{Message, Recording, RecordingError, StampPattern, TopicInfo};

use crate::finding::Findings;
use crate::odometry::OdometryChecks;
use crate::odometry_fault::OdometryFault;
use crate::rotation::sure_offset;
use crate::scan_motion::ScanMotions;
use crate::scan_turns::ScanTurns;

/// So much of the recording is looked at.
const LOOK: Duration = Duration::from_ticks(600 * 10_000_000);

/// Scanners whose axis is this upright (cosine) are level.
const LEVEL: f64 = 0.9;

/// An offset between the stamps of two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorDelay {
    /// By how many seconds scans are stamped too late against odometry.
    pub seconds: f64,
    /// Standard deviation of that, seconds.
    pub sigma: f64,
}

/// What scans tell of odometry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OdometryComparison {
    /// How its clock differs; none where nothing is surely wrong.
    pub delay: Option<SensorDelay>,
    /// How its motions differ, where they surely do.
    pub fault: Option<OdometryFault>,
}

/// Compares odometry with the first scanner of the plan in the first ten minutes, as `check` does. Nothing is told where the
/// plan has no topic of odometry.
///
/// # Errors
/// The recording cannot be read.
pub fn compare_odometry(
    recording: &dyn Recording,
    inventory: &Inventory,
    plan: &SensorPlan,
) -> Result<OdometryComparison, RecordingError> {
    let (Some(PlannedOdometry::Topic(odometry)), Some(scanner)) = (&plan.odometry, plan.range.first()) else {
        return Ok(OdometryComparison::default());
    };
    let odometry_from_scanner = inventory.tree.lookup_static(&odometry.frame, &scanner.source.frame);
    let odometry_from_scanner = odometry_from_scanner.unwrap_or_else(Rigid3::identity);
    let up = (odometry_from_scanner.rotation * Vector3::z()).z;
    let topics = [odometry.topic.clone(), scanner.source.topic.clone()];
    let mut reader = recording.read(&|topic: &TopicInfo| topics.contains(&topic.topic))?;
    let mut both = Both::default();
    let mut first = None;
    while let Some(message) = reader.next_message()? {
        if message.log_time - *first.get_or_insert(message.log_time) > LOOK {
            break;
        }
        both.add(&message.topic, &message.message);
    }
    if up < 0.0 {
        both.turn_over();
    }
    // Stamps that are not believed tell nothing of the other sensor.
    if StampPattern::of(&both.stamps).is_some_and(|pattern| pattern.is_disturbed()) {
        return Ok(OdometryComparison::default());
    }
    let offset = sure_offset(&both.wheels.turns, &both.turns.turns, false);
    let known = (scanner.source.clock_shift - odometry.clock_shift).seconds();
    let delay = offset.map(|(lag, sigma)| SensorDelay { seconds: lag + known, sigma });
    let lag = offset.map_or(0.0, |(lag, _)| lag);
    // A scanner that leans tells other motions than those in the plane.
    let is_level = up.abs() > LEVEL;
    let find = || {
        OdometryFault::find(
            (&both.wheels.turns, &both.turns.turns),
            (&both.poses, &both.motions.motions),
            (&odometry_from_scanner, lag),
        )
    };
    let fault = is_level.then(find).flatten();
    Ok(OdometryComparison { delay, fault })
}

/// What both sensors tell, while they are read.
#[derive(Default)]
struct Both {
    wheels: OdometryChecks,
    poses: TransformBuffer,
    turns: ScanTurns,
    motions: ScanMotions,
    stamps: Vec<Time>,
}

impl Both {
    /// Motions of a scanner that is mounted upside down as seen from above.
    fn turn_over(&mut self) {
        for (_, _, turn) in &mut self.turns.turns {
            *turn = -*turn;
        }
        for (_, _, motion) in &mut self.motions.motions {
            *motion = Rigid2::new(motion.translation.x, -motion.translation.y, -motion.angle);
        }
    }

    fn add(&mut self, topic: &str, message: &Message) {
        match message {
            Message::Odometry(odometry) => {
                self.wheels.add(topic, odometry, &mut Findings::default());
                let stamp = odometry.header.stamp;
                // What goes back in time would have to be put in its place among all.
                if self.poses.latest_time().is_none_or(|latest| latest < stamp)
                    && let Some((pose, _)) = pose_of(&odometry.pose)
                {
                    self.poses.push(stamp, pose);
                }
            }
            Message::LaserScan(scan) => {
                self.stamps.push(scan.header.stamp);
                self.turns.add(scan.header.stamp, scan);
                self.motions.add(scan.header.stamp, scan);
            }
            _ => {}
        }
    }
}
