//! Chooses the range sensors, and whether to map in 2D or in 3D.

use std::cmp::Ordering;

use portolan_geometry::{Dimension, Vector3};
use portolan_sensor::SensorKind;

use super::beam_elevation::beam_elevation;
use super::point_times::times_of_points;
use super::request::Request;
use super::robot::{reason_apart, upright_frame};
use super::{Chosen, PlanError, PlannedRange, SensorPlan};
use crate::azimuth_time::AzimuthTimes;
use crate::options::IngestOptions;
use crate::range_noise::RangeNoise;
use crate::survey::{Inventory, TopicSurvey, is_range};
use crate::tf::is_fixed_frame;

/// Maximum tilt of a 2D scanner, degrees.
const MAX_TILT_DEGREES: f64 = 20.0;
/// Minimum vertical field of view of a 3D lidar, degrees.
const MIN_VERTICAL_DEGREES: f64 = 5.0;
/// Minimum horizontal field of view of a 3D lidar, degrees; a depth camera has less.
const MIN_HORIZONTAL_DEGREES: f64 = 150.0;

/// Chooses the range sensors: those requested, or all that can be used together. Sets the dimension.
pub(super) fn choose<'a>(
    inventory: &'a Inventory,
    options: &IngestOptions,
    request: &Request<'a>,
    plan: &mut SensorPlan,
) -> Result<Vec<Chosen<'a>>, PlanError> {
    if !request.range.is_empty() {
        plan.dimension = options.dimension.unwrap_or_else(|| dimension_of(&request.range));
        return Ok(request.range.clone());
    }
    let candidates: Vec<&TopicSurvey> =
        inventory.topics.iter().filter(|t| is_range(&t.info.type_name) && t.info.count != Some(0)).collect();
    if candidates.is_empty() {
        return Err(PlanError::NoRangeSensor { detail: describe_topics(inventory) });
    }
    let sensors = without_results(candidates, options, plan);
    let sensors = one_per_frame(sensors, plan);
    let (scans, clouds): (Vec<_>, Vec<_>) = sensors.into_iter().partition(|c| !is_cloud(c));
    choose_dimension(scans, clouds, inventory, options, plan)
}

fn describe_topics(inventory: &Inventory) -> String {
    let mut types: Vec<String> =
        inventory.topics.iter().map(|t| format!("{} ({})", t.info.topic, t.info.type_name)).collect();
    types.truncate(20);
    if types.is_empty() {
        return "the recording has no messages at all".to_owned();
    }
    let packets = inventory.topics.iter().any(|t| t.info.type_name.to_lowercase().contains("packet"));
    let advice = if packets {
        "; raw packets must be converted to point clouds first, by the driver of the lidar"
    } else {
        ""
    };
    format!(
        "the recording has no LaserScan, MultiEchoLaserScan or PointCloud2, only {}{advice}",
        types.join(", ")
    )
}

fn fixed_noise(noise: RangeNoise) -> Option<f64> {
    match noise {
        RangeNoise::Auto => None,
        RangeNoise::Fixed(sigma) => Some(sigma),
    }
}

fn is_cloud(chosen: &Chosen) -> bool {
    &*chosen.survey.info.type_name == "sensor_msgs/PointCloud2"
}

/// The option that requests it.
fn flag(chosen: &Chosen) -> &'static str {
    if is_cloud(chosen) { "--points" } else { "--scan" }
}

/// Leaves out clouds in frames that belong to no sensor: results of mapping.
fn without_results<'a>(
    candidates: Vec<&'a TopicSurvey>,
    options: &IngestOptions,
    plan: &mut SensorPlan,
) -> Vec<Chosen<'a>> {
    let is_result = |t: &TopicSurvey| {
        let frame = t.frame.as_deref().unwrap_or("");
        frame == options.map_frame || is_fixed_frame(frame)
    };
    let (results, sensors): (Vec<_>, Vec<_>) = candidates.into_iter().partition(|t| is_result(t));
    for result in results {
        plan.note(
            format!(
                "{} is not used: its frame \"{}\" is that of a map, not of a sensor",
                result.info.topic,
                result.frame.as_deref().unwrap_or("")
            ),
            format!("--points {}", result.info.topic),
        );
    }
    sensors.into_iter().map(Chosen::named_after_topic).collect()
}

/// Order of topics that hold the same scans processed in several ways, the best first: clouds with times of
/// points before others, then those with more points in all, then the topic with more messages, the shorter
/// name, the first by name.
fn raw_first(a: &Chosen, b: &Chosen) -> Ordering {
    let count = |c: &Chosen| c.survey.info.count.unwrap_or(c.survey.seen);
    let points = |c: &Chosen| {
        let returns = c.survey.range.as_ref().filter(|_| is_cloud(c)).map_or(0, |range| range.returns);
        returns as u64 * count(c)
    };
    let has_times = |c: &Chosen| is_cloud(c) && c.survey.point_time.is_some();
    has_times(b)
        .cmp(&has_times(a))
        .then_with(|| points(b).cmp(&points(a)))
        .then_with(|| count(b).cmp(&count(a)))
        .then_with(|| a.topic().len().cmp(&b.topic().len()))
        .then_with(|| a.topic().cmp(b.topic()))
}

/// Keeps the rawest of several topics of one frame, which are the same scans processed in several ways.
fn one_per_frame<'a>(sensors: Vec<Chosen<'a>>, plan: &mut SensorPlan) -> Vec<Chosen<'a>> {
    let better = |a: &Chosen, b: &Chosen| raw_first(a, b).is_lt();
    let mut kept: Vec<Chosen> = Vec::new();
    for sensor in sensors {
        let twin = kept.iter_mut().find(|k| {
            !k.frame().is_empty() && k.frame() == sensor.frame() && is_cloud(k) == is_cloud(&sensor)
        });
        let Some(twin) = twin else {
            kept.push(sensor);
            continue;
        };
        let loser = if better(&sensor, twin) { std::mem::replace(twin, sensor) } else { sensor };
        plan.note(
            format!(
                "{} is not used: {} has the same frame \"{}\"",
                loser.topic(),
                twin.topic(),
                twin.frame()
            ),
            format!("{} {}", flag(&loser), loser.topic()),
        );
    }
    kept
}

fn sees_3d(chosen: &Chosen) -> bool {
    let degrees = chosen.survey.range.as_ref().map_or(0.0, |r| r.vertical_field_of_view.to_degrees());
    is_cloud(chosen) && degrees >= MIN_VERTICAL_DEGREES
}

fn looks_around(chosen: &Chosen) -> bool {
    let degrees = chosen.survey.range.as_ref().map_or(0.0, |r| r.field_of_view.to_degrees());
    sees_3d(chosen) && degrees >= MIN_HORIZONTAL_DEGREES
}

fn dimension_of(range: &[Chosen]) -> Dimension {
    if range.iter().any(sees_3d) { Dimension::ThreeD } else { Dimension::TwoD }
}

fn choose_dimension<'a>(
    scans: Vec<Chosen<'a>>,
    clouds: Vec<Chosen<'a>>,
    inventory: &Inventory,
    options: &IngestOptions,
    plan: &mut SensorPlan,
) -> Result<Vec<Chosen<'a>>, PlanError> {
    let names =
        |chosen: &[Chosen]| chosen.iter().map(|c| c.topic().to_owned()).collect::<Vec<_>>().join(", ");
    let scans = without_leaning(scans, clouds.is_empty(), inventory, plan);
    if scans.is_empty() || clouds.is_empty() {
        let only = if scans.is_empty() { clouds } else { scans };
        plan.dimension = options.dimension.unwrap_or_else(|| dimension_of(&only));
        return Ok(only);
    }
    // A lidar with a wide field of view is preferred to a 2D scanner; a depth camera is not.
    let in_3d = clouds.iter().any(looks_around);
    plan.dimension = options.dimension.unwrap_or(if in_3d { Dimension::ThreeD } else { Dimension::TwoD });
    let (used, unused, flag) = match plan.dimension {
        Dimension::ThreeD => (clouds, scans, "--scan"),
        Dimension::TwoD => (scans, clouds, "--points"),
    };
    plan.note(
        format!("mapping with {}, not with {}", names(&used), names(&unused)),
        format!("{flag} {}", unused.first().map_or("", |c| c.topic())),
    );
    Ok(used)
}

/// Leaves out scanners whose plane is tilted against that of the robot, unless there are no others.
fn without_leaning<'a>(
    scans: Vec<Chosen<'a>>,
    keep_one: bool,
    inventory: &Inventory,
    plan: &mut SensorPlan,
) -> Vec<Chosen<'a>> {
    let leaning = |c: &Chosen| {
        let base = upright_frame(&inventory.tree, c.frame(), [], Dimension::TwoD)?;
        // Upside down is fine. For one that is tilted to and fro the largest tilt counts.
        let poses = inventory.tree.lookup_often(base, c.frame());
        let upright = poses.iter().map(|pose| (pose.rotation * Vector3::z()).z.abs()).reduce(f64::min)?;
        (upright < MAX_TILT_DEGREES.to_radians().cos()).then_some(upright.acos().to_degrees())
    };
    if keep_one && scans.iter().all(|c| leaning(c).is_some()) {
        return scans;
    }
    let mut kept = Vec::new();
    for scan in scans {
        match leaning(&scan) {
            Some(degrees) => plan.note(
                format!(
                    "{} is not used: its plane leans {degrees:.0}° against that of the robot",
                    scan.topic()
                ),
                format!("--scan {}", scan.topic()),
            ),
            None => kept.push(scan),
        }
    }
    kept
}

/// Plans the range sensors that transforms connect with the tracking frame.
pub(super) fn connect(
    inventory: &Inventory,
    options: &IngestOptions,
    request: &Request,
    range: Vec<Chosen>,
    plan: &mut SensorPlan,
) -> Result<(), PlanError> {
    let mut refused = Vec::new();
    for chosen in range {
        let frame = frame_of(&chosen, plan);
        if !is_used(inventory, request, &chosen, &frame, plan)? {
            refused.push(chosen.topic().to_owned());
            continue;
        }
        let planned = planned(&chosen, &frame, options, plan);
        plan.range.push(planned);
    }
    if plan.range.is_empty() {
        let detail = format!(
            "no transforms connect any of {} with \"{}\"; give them with --urdf, or choose another --tracking-frame",
            refused.join(", "),
            plan.tracking_frame
        );
        return Err(PlanError::Frame { detail });
    }
    if plan.range.len() > 1 {
        let names: Vec<&str> = plan.range.iter().map(|r| &*r.source.topic).collect();
        plan.note(
            format!("{} range sensors are used together: {}", names.len(), names.join(", ")),
            "--scan or --points",
        );
    }
    Ok(())
}

/// The frame of a sensor: the tracking frame if it names none.
fn frame_of(chosen: &Chosen, plan: &mut SensorPlan) -> String {
    if !chosen.frame().is_empty() {
        return chosen.frame().to_owned();
    }
    let frame = plan.tracking_frame.clone();
    plan.note(
        format!("{} names no frame; it is taken to be at \"{frame}\"", chosen.topic()),
        "--tracking-frame",
    );
    frame
}

/// Whether a sensor in this frame is used. A requested one is used even if it is on another robot.
fn is_used(
    inventory: &Inventory,
    request: &Request,
    chosen: &Chosen,
    frame: &str,
    plan: &mut SensorPlan,
) -> Result<bool, PlanError> {
    let Some(why) = reason_apart(&inventory.tree, frame, &plan.tracking_frame) else { return Ok(true) };
    let is_connected = inventory.tree.connected(&plan.tracking_frame, frame);
    if request.range.is_empty() {
        let change = match is_connected {
            true => format!("{} {}", flag(chosen), chosen.topic()),
            false => "--urdf <robot description>".to_owned(),
        };
        plan.warn(format!("{} is not used: {why}", chosen.topic()), change);
        return Ok(false);
    }
    if is_connected {
        return Ok(true);
    }
    let topic = chosen.topic();
    let detail = format!("{topic}: {why}; give them with --urdf, or choose another --tracking-frame");
    Err(PlanError::Frame { detail })
}

fn planned(chosen: &Chosen, frame: &str, options: &IngestOptions, plan: &mut SensorPlan) -> PlannedRange {
    let beam_elevation = beam_elevation(chosen, is_cloud(chosen), options, plan);
    let times = times_of_points(chosen, is_cloud(chosen), options.azimuth_times, plan);
    let statistics = chosen.survey.range.clone().unwrap_or_default();
    PlannedRange {
        times_are_uncertain: options.azimuth_times == AzimuthTimes::Auto && statistics.times_are_uncertain,
        source: chosen.planned(SensorKind::Range, frame),
        point_time: times.recorded,
        scan_duration: (options.azimuth_times == AzimuthTimes::Off && !is_cloud(chosen)).then_some(0.0),
        range_noise: fixed_noise(options.range_noise).filter(|_| !is_cloud(chosen)),
        length_unit: chosen.survey.length_unit,
        azimuth_times: times.by_azimuth,
        turn: times.turn,
        beam_elevation,
        statistics,
    }
}
