//! Corrects the clocks of sensors that disagree.

use std::sync::Arc;

use portolan_geometry::Duration;
use portolan_issue::Severity;

use super::{Notice, PlanError, PlannedSensor, SensorPlan};

/// All sensors.
fn sources(plan: &mut SensorPlan) -> Vec<&mut PlannedSensor> {
    let mut sources: Vec<&mut PlannedSensor> = plan.range.iter_mut().map(|r| &mut r.source).collect();
    sources.extend(plan.imu.as_mut().map(|i| &mut i.source));
    sources.extend(plan.odometry.as_mut().map(|odometry| &mut odometry.source));
    let others = [&mut plan.nav_sat, &mut plan.fixed_frame_pose, &mut plan.landmarks];
    sources.extend(others.into_iter().flatten());
    sources
}

/// Converts the stamps of all sensors to the clock of the first range sensor where the times of recording
/// show theirs to be off by more than 10 s.
pub(super) fn join(plan: &mut SensorPlan) {
    const OTHER_CLOCK_SECONDS: f64 = 10.0;
    let Some(reference) = plan.range.first().and_then(|r| r.source.usual_lag) else { return };
    let mut notices = Vec::new();
    for source in sources(plan) {
        let Some(lag) = source.usual_lag else { continue };
        let difference = (lag - reference).seconds();
        if difference.abs() > OTHER_CLOCK_SECONDS {
            source.clock_shift = lag - reference;
            source.usual_lag = Some(reference);
            notices.push(Notice {
                severity: Severity::Info,
                text: format!(
                    "the clock of {} is {difference:.3} s behind the others; its stamps are shifted by this",
                    source.topic
                ),
                change: String::new(),
            });
        }
    }
    plan.notices.extend(notices);
}

/// Adds the time offsets given by the user to the stamps.
///
/// # Errors
/// No sensor is read from such a topic.
pub(super) fn shift(offsets: &[(String, Duration)], plan: &mut SensorPlan) -> Result<(), PlanError> {
    for (topic, offset) in offsets {
        let name = topic.trim_start_matches('/');
        let mut sources = sources(plan);
        let used: Vec<Arc<str>> = sources.iter().map(|s| s.topic.clone()).collect();
        let Some(source) = sources.iter_mut().find(|s| s.topic.trim_start_matches('/') == name) else {
            return Err(PlanError::NoTopic {
                asked: "--time-offset".to_owned(),
                topic: topic.clone(),
                available: used.join(", "),
            });
        };
        source.clock_shift = source.clock_shift + *offset;
        source.usual_lag = source.usual_lag.map(|lag| lag - *offset);
        let text = format!("stamps of {} are shifted by {} s", source.topic, offset.seconds());
        plan.note(text, "--time-offset");
    }
    Ok(())
}
