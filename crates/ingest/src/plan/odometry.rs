//! Chooses the odometry: a topic, or moving transforms of an odometry frame.

use std::cmp::Reverse;

use portolan_geometry::Duration;
use portolan_sensor::{SensorId, SensorKind};

use super::request::Request;
use super::robot::{reason_apart, shared_parts};
use super::{Chosen, PlanError, PlannedOdometry, PlannedSensor, SensorPlan, TF};
use crate::survey::Inventory;

/// Plans odometry.
pub(super) fn choose(
    inventory: &Inventory,
    request: &Request,
    plan: &mut SensorPlan,
) -> Result<(), PlanError> {
    if let Some(chosen) = &request.odometry {
        let child = child_frame(chosen, plan);
        if !inventory.tree.connected(&plan.tracking_frame, &child) {
            let detail = format!(
                "{}: no transforms connect \"{child}\" with \"{}\"; give them with --urdf, or choose another --tracking-frame",
                chosen.topic(),
                plan.tracking_frame
            );
            return Err(PlanError::Frame { detail });
        }
        take(chosen, &child, plan);
        return Ok(());
    }
    if request.find_odometry && !find_topic(inventory, plan) {
        find_transforms(inventory, plan);
    }
    Ok(())
}

/// An empty child frame is taken to be the tracking frame.
fn child_frame(chosen: &Chosen, plan: &mut SensorPlan) -> String {
    let child = chosen.survey.child_frame.as_deref().unwrap_or("");
    if !child.is_empty() {
        return child.to_owned();
    }
    let tracking = plan.tracking_frame.clone();
    plan.note(
        format!("{} names no child frame; it is taken to be \"{tracking}\"", chosen.topic()),
        "--tracking-frame",
    );
    tracking
}

fn take(chosen: &Chosen, child: &str, plan: &mut SensorPlan) {
    let source = chosen.planned(SensorKind::Odometry, child);
    plan.odometry = Some(PlannedOdometry { source, transforms_from: None });
    plan.odometry_interval = chosen.survey.interval;
}

/// Chooses among several topics: `odom` by name first, then the one named like the range sensor, then the one
/// with most messages.
fn find_topic(inventory: &Inventory, plan: &mut SensorPlan) -> bool {
    let mut candidates: Vec<Chosen> = inventory
        .topics
        .iter()
        .filter(|t| &*t.info.type_name == "nav_msgs/Odometry" && t.seen > 0)
        .map(Chosen::named_after_topic)
        .collect();
    let rank = |topic: &str| match topic.trim_start_matches('/') {
        "odom" => 0,
        name if name.ends_with("/odom") => 1,
        _ => 2,
    };
    let with_range =
        |topic: &str| plan.range.first().map_or(0, |range| shared_parts(&range.source.topic, topic));
    let count = |c: &Chosen| c.survey.info.count.unwrap_or(c.survey.seen);
    candidates.sort_by_key(|c| (rank(c.topic()), Reverse(with_range(c.topic())), Reverse(count(c))));
    for chosen in candidates {
        let topic = chosen.topic().to_owned();
        if let Some(used) = &plan.odometry {
            let used = used.name();
            plan.note(format!("{used} is used as odometry, not {topic}"), format!("--odom {topic}"));
            continue;
        }
        let parent = chosen.frame().to_owned();
        if matches!(parent.as_str(), "map" | "world" | "earth") {
            plan.note(
                format!("{topic} is not used: poses in \"{parent}\" are results of mapping, not odometry"),
                format!("--odom {topic}"),
            );
            continue;
        }
        let child = child_frame(&chosen, plan);
        match reason_apart(&inventory.tree, &child, &plan.tracking_frame) {
            None => take(&chosen, &child, plan),
            Some(why) => {
                let is_connected = inventory.tree.connected(&plan.tracking_frame, &child);
                let change = if is_connected {
                    format!("--odom {topic}")
                } else {
                    "--urdf <robot description>".to_owned()
                };
                plan.warn(format!("odometry {topic} is not used: {why}"), change);
            }
        }
    }
    plan.odometry.is_some()
}

/// Looks for a frame with `odom` in its name and a moving child to which the tracking frame is fixed.
fn find_transforms(inventory: &Inventory, plan: &mut SensorPlan) {
    let moving = inventory.tree.moving_frames();
    let odometry = moving.iter().find(|(parent, child)| {
        parent.to_lowercase().contains("odom")
            && inventory.tree.lookup_static(child, &plan.tracking_frame).is_some()
    });
    if let Some((parent, child)) = odometry {
        let source = PlannedSensor {
            sensor: SensorId::new(SensorKind::Odometry, "odom"),
            topic: TF.into(),
            frame: (*child).into(),
            clock_shift: Duration::ZERO,
            usual_lag: None,
            jitter: None,
        };
        plan.odometry = Some(PlannedOdometry { source, transforms_from: Some((*parent).into()) });
        plan.odometry_interval = inventory.tree.moving_interval(child);
        plan.note(
            format!("the transforms from \"{parent}\" to \"{child}\" are used as odometry"),
            "--no-odometry",
        );
    }
}
