//! By how much odometry and a planar scanner are stamped apart, measured before mapping begins.

use portolan_geometry::Duration;
use portolan_ingest::{PlannedOdometry, SensorPlan};
use portolan_recording::{Message, Recording, RecordingError, StampPattern, TopicInfo};

use crate::finding::Findings;
use crate::odometry::OdometryChecks;
use crate::rotation::sure_offset;
use crate::scan_turns::ScanTurns;

/// So much of the recording is looked at.
const LOOK: Duration = Duration::from_ticks(600 * 10_000_000);

/// An offset between the stamps of two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorDelay {
    /// By how many seconds scans are stamped too late against odometry.
    pub seconds: f64,
    /// Standard deviation of that, seconds.
    pub sigma: f64,
}

/// Measures it as `check` does, from how the first scanner and odometry turned in the first ten minutes. None
/// where the plan has no topic of odometry, and where nothing is surely wrong.
///
/// # Errors
/// The recording cannot be read.
pub fn odometry_delay(
    recording: &dyn Recording,
    plan: &SensorPlan,
) -> Result<Option<SensorDelay>, RecordingError> {
    let (Some(PlannedOdometry::Topic(odometry)), Some(scanner)) = (&plan.odometry, plan.range.first()) else {
        return Ok(None);
    };
    let topics = [odometry.topic.clone(), scanner.source.topic.clone()];
    let mut reader = recording.read(&|topic: &TopicInfo| topics.contains(&topic.topic))?;
    let (mut wheels, mut scans) = (OdometryChecks::default(), ScanTurns::default());
    let (mut first, mut stamps) = (None, Vec::new());
    while let Some(message) = reader.next_message()? {
        if message.log_time - *first.get_or_insert(message.log_time) > LOOK {
            break;
        }
        match &message.message {
            Message::Odometry(pose) => wheels.add(&message.topic, pose, &mut Findings::default()),
            Message::LaserScan(scan) => {
                stamps.push(scan.header.stamp);
                scans.add(scan.header.stamp, scan);
            }
            _ => {}
        }
    }
    // Stamps that are not believed tell no offset either.
    if StampPattern::of(&stamps).is_some_and(|pattern| pattern.is_disturbed()) {
        return Ok(None);
    }
    let offset = sure_offset(&wheels.turns, &scans.turns, false);
    let known = (scanner.source.clock_shift - odometry.clock_shift).seconds();
    Ok(offset.map(|(lag, sigma)| SensorDelay { seconds: lag + known, sigma }))
}
