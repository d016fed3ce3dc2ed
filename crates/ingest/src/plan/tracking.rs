//! Chooses the IMU and the frame whose motion is estimated.

use std::cmp::Reverse;

use portolan_geometry::{Dimension, Quaternion, STANDARD_GRAVITY, Vector3};
use portolan_issue::Severity;
use portolan_sensor::SensorKind;

use super::request::Request;
use super::robot::{are_on_one_robot, base_frames, reason_apart, shared_parts, upright_frame};
use super::{Chosen, ImuScale, PlanError, PlannedImu, SensorPlan};
use crate::options::IngestOptions;
use crate::statistics::ImuStatistics;
use crate::survey::Inventory;
use crate::tf::frame_name;

/// Range of the median acceleration of an IMU that measures gravity, m/s².
const PLAUSIBLE_GRAVITY: std::ops::Range<f64> = 8.0..12.0;
/// Fraction of fast samples above which angular velocities must be in degrees per second: no platform turns
/// fast for longer.
const MOST_FAST: f64 = 0.1;
/// Minimum rate of a usable IMU, samples per second.
const MIN_RATE: f64 = 10.0;
/// Distance within which the IMU counts as at the tracking frame, metres.
const SAME_PLACE: f64 = 1e-5;
/// Tilt against the robot above which an IMU is not used, degrees.
const MAX_LEAN_DEGREES: f64 = 45.0;

/// An IMU that may be used.
pub(super) struct ImuChoice<'a> {
    chosen: Chosen<'a>,
    scale: ImuScale,
    asked_for: bool,
}

impl ImuChoice<'_> {
    fn frame(&self) -> &str {
        self.chosen.frame()
    }
}

/// Chooses the IMU: the requested one, or the best of the plausible ones.
pub(super) fn choose_imu<'a>(
    inventory: &'a Inventory,
    request: &Request<'a>,
    range: &[Chosen],
    plan: &mut SensorPlan,
) -> Result<Option<ImuChoice<'a>>, PlanError> {
    if let Some(chosen) = &request.imu {
        let statistics = chosen.survey.imu.clone().unwrap_or_default();
        let scale = scale(&statistics);
        return Ok(Some(ImuChoice { chosen: chosen.clone(), scale, asked_for: true }));
    }
    if !request.find_imu {
        return Ok(None);
    }
    let mut candidates: Vec<Chosen> = inventory
        .topics
        .iter()
        .filter(|t| &*t.info.type_name == "sensor_msgs/Imu" && t.seen > 0)
        .map(Chosen::named_after_topic)
        .collect();
    let with_range = |topic: &str| range.first().map_or(0, |range| shared_parts(range.topic(), topic));
    let count = |c: &Chosen| c.survey.info.count.unwrap_or(c.survey.seen);
    candidates.sort_by_key(|c| (rank(c.topic()), Reverse(with_range(c.topic())), Reverse(count(c))));
    let mut choice: Option<ImuChoice> = None;
    for chosen in candidates {
        if let Some(used) = &choice {
            plan.note(
                format!("{} is used as IMU, not {}", used.chosen.topic(), chosen.topic()),
                format!("--imu {}", chosen.topic()),
            );
            continue;
        }
        let leans = || leaning(&chosen, inventory, range, plan.dimension);
        match reason_against(&chosen, inventory, range).or_else(leans) {
            Some(why) => {
                let connected = is_connected(&chosen, inventory, range);
                plan.push_notice(
                    if connected { Severity::Info } else { Severity::Warning },
                    format!("the IMU {} is not used: {why}", chosen.topic()),
                    format!("--imu {}", chosen.topic()),
                );
            }
            None => {
                let scale = scale(&chosen.survey.imu.clone().unwrap_or_default());
                choice = Some(ImuChoice { chosen, scale, asked_for: false });
            }
        }
    }
    if choice.is_none() && plan.dimension == Dimension::ThreeD {
        plan.note("mapping in 3D without an IMU: level is what it was at the start", "--imu <topic>");
    }
    Ok(choice)
}

/// Order by name: `imu` before `imu/data` before all others.
fn rank(topic: &str) -> u32 {
    match topic.trim_start_matches('/') {
        "imu" => 0,
        name if name.ends_with("imu/data") => 1,
        name if name.ends_with("imu") => 2,
        _ => 3,
    }
}

fn scale(statistics: &ImuStatistics) -> ImuScale {
    let in_g = (0.8..1.2).contains(&statistics.median_acceleration);
    let in_degrees = statistics.fast_share > MOST_FAST;
    ImuScale {
        acceleration: if in_g { STANDARD_GRAVITY } else { 1.0 },
        angular_velocity: if in_degrees { 1f64.to_radians() } else { 1.0 },
    }
}

/// Reason not to use an IMU that the user did not ask for.
fn reason_against(chosen: &Chosen, inventory: &Inventory, range: &[Chosen]) -> Option<String> {
    let statistics = chosen.survey.imu.clone().unwrap_or_default();
    let acceleration = statistics.median_acceleration * scale(&statistics).acceleration;
    if statistics.is_partial {
        return Some("its messages say that acceleration or angular velocity is missing".to_owned());
    }
    if !PLAUSIBLE_GRAVITY.contains(&acceleration) {
        return Some(format!(
            "it measures {acceleration:.2} m/s² most of the time, which does not include gravity"
        ));
    }
    if statistics.messages < 2 || statistics.rate < MIN_RATE {
        return Some(format!("it has only {:.1} samples a second", statistics.rate));
    }
    if is_connected(chosen, inventory, range) {
        return None;
    }
    let why = range.first().and_then(|range| reason_apart(&inventory.tree, chosen.frame(), range.frame()))?;
    Some(format!("{why} (give them with --urdf)"))
}

/// Whether the pose of the IMU relative to a range sensor is known.
fn is_connected(chosen: &Chosen, inventory: &Inventory, range: &[Chosen]) -> bool {
    let frame = chosen.frame();
    range.iter().any(|r| frame.is_empty() || are_on_one_robot(&inventory.tree, frame, r.frame()))
}

/// Reason why an IMU cannot determine level: its measured up direction is tilted far against the upright
/// frame. Its axes are swapped, or its mounting is not in the transforms. Scans levelled by it would be
/// distorted, and in 3D it would measure rotation about the wrong axes.
fn leaning(chosen: &Chosen, inventory: &Inventory, range: &[Chosen], dimension: Dimension) -> Option<String> {
    let up = Vector3::from(chosen.survey.imu.as_ref()?.mean_acceleration).try_normalize(1e-9)?;
    let tree = &inventory.tree;
    let upright = upright_frame(tree, chosen.frame(), range.iter().map(Chosen::frame), dimension)?;
    let up = tree.lookup_static(upright, chosen.frame())?.rotation * up;
    // Planar scanners and their robots may be upside down: that only changes the sign of rotation about z.
    let upward = if dimension == Dimension::TwoD { up.z.abs() } else { up.z };
    let degrees = upward.clamp(-1.0, 1.0).acos().to_degrees();
    let [x, y, z] = up.into();
    (degrees > MAX_LEAN_DEGREES).then(|| {
        format!(
            "gravity shows it leaning {degrees:.0}° in \"{upright}\" (up is {x:.2} {y:.2} {z:.2}): its axes are \
             swapped, or its mounting is not in the transforms"
        )
    })
}

/// Chooses the tracking frame: the requested one; that of the IMU, or the frame of the robot at the same
/// position; a frame of the robot that is connected with the range sensor; or that of the range sensor.
pub(super) fn choose_frame(
    inventory: &Inventory,
    options: &IngestOptions,
    request: &Request,
    range: &[Chosen],
    imu: Option<&ImuChoice>,
    plan: &mut SensorPlan,
) -> Result<String, PlanError> {
    let tree = &inventory.tree;
    let primary = range.first().map_or("", |c| c.frame());
    if let Some(frame) = options.tracking_frame.as_deref().map(frame_name) {
        return if tree.has_frame(frame) || frame == primary || imu.is_some_and(|i| i.frame() == frame) {
            Ok(frame.to_owned())
        } else {
            let known: Vec<&str> = tree.frames().take(30).collect();
            let known = if known.is_empty() { primary.to_owned() } else { known.join(", ") };
            let detail = format!(
                "tracking frame \"{frame}\" is not among the frames of the recording ({known}); choose one of them, or give its place with --urdf"
            );
            Err(PlanError::Frame { detail })
        };
    }
    let odometry_child = odometry_child(inventory, request);
    let bases = || base_frames(tree).chain(odometry_child.as_deref());
    if let Some(frame) = imu.map(|i| i.frame().to_owned()).filter(|f| !f.is_empty()) {
        let same_place = |base: &&str| {
            tree.has_frame(base)
                && tree.lookup_static(base, &frame).is_some_and(|t| t.translation.vector.norm() < SAME_PLACE)
        };
        return Ok(bases().find(same_place).map_or(frame.clone(), str::to_owned));
    }
    let fits =
        |base: &&str| !primary.is_empty() && tree.has_frame(base) && are_on_one_robot(tree, base, primary);
    if let Some(base) = bases().find(fits) {
        return Ok(base.to_owned());
    }
    if primary.is_empty() {
        return Ok(odometry_child.unwrap_or_else(|| "base_link".to_owned()));
    }
    if let Some(frame) = tree.frames().find(|f| *f != primary && are_on_one_robot(tree, f, primary)) {
        plan.note(
            format!(
                "no frame of the recording has the usual name of a robot frame (base_link, …); the motion of \"{primary}\" is mapped"
            ),
            format!("--tracking-frame {frame}"),
        );
        return Ok(primary.to_owned());
    }
    plan.warn(
        format!("no transforms say where \"{primary}\" is on the robot; its own motion is mapped"),
        "--urdf <robot description> or --tracking-frame",
    );
    Ok(primary.to_owned())
}

fn odometry_child(inventory: &Inventory, request: &Request) -> Option<String> {
    let asked_for = request.odometry.as_ref().map(|c| c.survey);
    let any = || inventory.topics.iter().filter(|_| request.find_odometry).find(|t| t.child_frame.is_some());
    let child = asked_for.or_else(any)?.child_frame.as_deref()?;
    (!child.is_empty()).then(|| child.to_owned())
}

/// Plans the IMU.
pub(super) fn connect_imu(
    inventory: &Inventory,
    imu: Option<ImuChoice>,
    plan: &mut SensorPlan,
) -> Result<(), PlanError> {
    let Some(ImuChoice { chosen, scale, asked_for }) = imu else { return Ok(()) };
    let topic = chosen.topic().to_owned();
    let tracking = plan.tracking_frame.clone();
    let frame = if chosen.frame().is_empty() {
        plan.note(format!("{topic} names no frame; it is taken to be at \"{tracking}\""), "--tracking-frame");
        tracking.clone()
    } else {
        chosen.frame().to_owned()
    };
    let is_connected = inventory.tree.connected(&tracking, &frame);
    let why = reason_apart(&inventory.tree, &frame, &tracking).filter(|_| !(asked_for && is_connected));
    if let Some(why) = why {
        if asked_for {
            let detail = format!("{topic}: {why}; give them with --urdf, or choose another --tracking-frame");
            return Err(PlanError::Frame { detail });
        }
        plan.warn(
            format!("the IMU {topic} is not used: {why}"),
            "--urdf <robot description> or --tracking-frame",
        );
        return Ok(());
    }
    if scale.acceleration != 1.0 {
        plan.note(
            format!("{topic} measures accelerations in g; they are multiplied by {STANDARD_GRAVITY}"),
            "",
        );
    }
    if scale.angular_velocity != 1.0 {
        plan.note_degrees(&topic);
    }
    let distance =
        inventory.tree.lookup_static(&tracking, &frame).map_or(0.0, |t| t.translation.vector.norm());
    if distance > SAME_PLACE {
        plan.note(
            format!("the IMU is {distance:.3} m away from \"{tracking}\"; accelerations during rotation are off by up to that times the square of the angular velocity"),
            format!("--tracking-frame {frame}"),
        );
    }
    let source = chosen.planned(SensorKind::Imu, &frame);
    let statistics = chosen.survey.imu.clone().unwrap_or_default();
    let correction = Quaternion::identity();
    plan.imu = Some(PlannedImu { source, scale, correction, statistics });
    Ok(())
}
