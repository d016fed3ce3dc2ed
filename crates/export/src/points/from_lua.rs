//! Builds a pipeline from a configuration (`tools.md` §3, `options.md`).

use portolan_config::Value;
use portolan_config::lua::Dictionary;
use portolan_geometry::{NearFrame, Quaternion, Rigid3, rotation_from_roll_pitch_yaw};
use portolan_grids::{
    HybridInserter, HybridInserterOptions, ProbabilityInserter, ProbabilityInserterOptions,
};

use super::clouds::{CloudKind, WriteCloud};
use super::colours::{ColourSensor, IntensityToGrey};
use super::filters::{CountPoints, FrameFilter, HeightFilter, RangeFilter, Sample};
use super::floors::detect_floors;
use super::grid_files::{GridOutput2d, WriteGrid2d, WriteHybridGrid};
use super::moving::RemoveMoving;
use super::xray::{WriteXray, XrayOptions};
use super::{Log, Pipeline, PipelineContext, PointsError, Stage};

/// Default of the maximum number of rays per hit.
const DEFAULT_MISS_PER_HIT_LIMIT: f64 = 3.0;
/// Maximum deviation of the norm of a quaternion from 1.
const QUATERNION_TOLERANCE: f64 = 1e-9;

type Made = Result<Box<dyn Stage>, PointsError>;
type Make = fn(&Dictionary, &PipelineContext, Log) -> Made;

/// Stages by name; true for those that write files.
const STAGES: [(&str, bool, Make); 15] = [
    ("color_points", false, color_points),
    ("dump_num_points", false, |_, _, _| Ok(Box::new(CountPoints::default()))),
    ("fixed_ratio_sampler", false, |d, _, _| Ok(Box::new(Sample::new(d.number("sampling_ratio")?)?))),
    ("frame_id_filter", false, frame_id_filter),
    ("intensity_to_color", false, intensity_to_color),
    ("min_max_range_filter", false, |d, _, _| {
        Ok(Box::new(RangeFilter::new(d.number("min_range")?, d.number("max_range")?)))
    }),
    ("vertical_range_filter", false, |d, _, _| {
        let [min_z, max_z] = [d.number("min_z")? as f32, d.number("max_z")? as f32];
        Ok(Box::new(HeightFilter { min_z, max_z }))
    }),
    (MOVING, false, remove_moving),
    ("write_hybrid_grid", true, hybrid_grid),
    ("write_pcd", true, |d, c, _| cloud(CloudKind::Pcd, d, c)),
    ("write_ply", true, |d, c, _| cloud(CloudKind::Ply, d, c)),
    ("write_probability_grid", true, probability_grid),
    ("write_ros_map", true, ros_map),
    ("write_xray_image", true, xray),
    ("write_xyz", true, |d, c, _| cloud(CloudKind::Xyz, d, c)),
];
const MOVING: &str = "voxel_filter_and_remove_moving_objects";

/// Builds the stages of a table `pipeline`: an array of tables, each with `action` and the options of that
/// stage. Files are created at once.
///
/// # Errors
/// If an option is missing, unknown or wrong, a stage is unknown, a writing stage comes before one that needs
/// all points several times, or a file cannot be created.
pub fn pipeline_from_lua(
    stages: &Dictionary,
    context: &PipelineContext,
    log: Log,
) -> Result<Pipeline, PointsError> {
    let mut made: Vec<Box<dyn Stage>> = Vec::new();
    let mut writer: Option<&'static str> = None;
    for options in stages.array_of_dictionaries()? {
        let action = options.string("action")?;
        let Some((name, writes, make)) = STAGES.iter().find(|(name, ..)| *name == action) else {
            let known: Vec<&str> = STAGES.iter().map(|(name, ..)| *name).collect();
            return Err(PointsError::UnknownAction { action, known: known.join(", ") });
        };
        if let (MOVING, Some(writer)) = (*name, writer) {
            return Err(PointsError::Order(writer));
        }
        writer = writer.or(writes.then_some(*name));
        made.push(make(&options, context, log)?);
        options.finish()?;
    }
    Ok(Pipeline { stages: made })
}

fn setting(action: &'static str, reason: impl Into<String>) -> PointsError {
    PointsError::Setting { action, reason: reason.into() }
}

fn optional<T>(
    d: &Dictionary,
    key: &str,
    read: impl Fn(&Dictionary, &str) -> Result<T, portolan_config::ConfigError>,
    default: T,
) -> Result<T, PointsError> {
    if d.has_key(key) { Ok(read(d, key)?) } else { Ok(default) }
}

/// Reads a length that must be positive, metres.
fn size(d: &Dictionary, key: &'static str, action: &'static str) -> Result<f64, PointsError> {
    let size = d.number(key)?;
    // Checked in single precision, in which it is used.
    if (size as f32).is_finite() && size as f32 > 0.0 {
        return Ok(size);
    }
    Err(setting(action, format!("{key} is {size}: it must be positive, in metres")))
}

fn cloud(kind: CloudKind, d: &Dictionary, context: &PipelineContext) -> Made {
    Ok(Box::new(WriteCloud::create(kind, context.file(&d.string("filename")?), &context.frame)?))
}

fn color_points(d: &Dictionary, _: &PipelineContext, _: Log) -> Made {
    let frame_id = d.string("frame_id")?;
    let parts = d.dictionary("color")?.array_of_numbers()?;
    let [red, green, blue] = parts.as_slice() else {
        return Err(setting("color_points", "color must be three numbers from 0 to 255"));
    };
    let colour = [*red, *green, *blue].map(|v| (v / 255.0) as f32);
    Ok(Box::new(ColourSensor { frame_id, colour }))
}

fn intensity_to_color(d: &Dictionary, _: &PipelineContext, _: Log) -> Made {
    let frame_id = optional(d, "frame_id", Dictionary::string, String::new())?;
    let [min_intensity, max_intensity] =
        [d.number("min_intensity")? as f32, d.number("max_intensity")? as f32];
    if min_intensity.is_nan() || max_intensity.is_nan() || min_intensity >= max_intensity {
        return Err(setting("intensity_to_color", "min_intensity must be below max_intensity"));
    }
    Ok(Box::new(IntensityToGrey { frame_id, min_intensity, max_intensity }))
}

fn frame_id_filter(d: &Dictionary, _: &PipelineContext, _: Log) -> Made {
    let frames = |key| match d.has_key(key) {
        true => d.dictionary(key)?.array_of_strings(),
        false => Ok(Vec::new()),
    };
    let (keep, drop) = (frames("keep_frames")?, frames("drop_frames")?);
    match (keep.is_empty(), drop.is_empty()) {
        (false, true) => Ok(Box::new(FrameFilter::Keep(keep))),
        (true, false) => Ok(Box::new(FrameFilter::Drop(drop))),
        _ => Err(setting("frame_id_filter", "exactly one of keep_frames and drop_frames must have names")),
    }
}

fn remove_moving(d: &Dictionary, _: &PipelineContext, log: Log) -> Made {
    if !d.has_key("miss_per_hit_limit") {
        log(&format!("Using default value of {DEFAULT_MISS_PER_HIT_LIMIT} for miss_per_hit_limit."));
    }
    let limit = optional(d, "miss_per_hit_limit", Dictionary::number, DEFAULT_MISS_PER_HIT_LIMIT)?;
    log("Marking hits...");
    Ok(Box::new(RemoveMoving::new(size(d, "voxel_size", MOVING)?, limit)))
}

fn hybrid_grid(d: &Dictionary, context: &PipelineContext, _: Log) -> Made {
    let inserter = d.dictionary("range_data_inserter")?;
    let options = HybridInserterOptions {
        hit_probability: inserter.number("hit_probability")?,
        miss_probability: inserter.number("miss_probability")?,
        num_free_space_voxels: u32::try_from(inserter.non_negative_integer("num_free_space_voxels")?)
            .unwrap_or(u32::MAX),
        intensity_threshold: optional(&inserter, "intensity_threshold", Dictionary::number, 0.0)? as f32,
    };
    let voxel_size = size(d, "voxel_size", "write_hybrid_grid")?;
    let file = context.file(&d.string("filename")?);
    Ok(Box::new(WriteHybridGrid::new(voxel_size, HybridInserter::new(&options)?, file, &context.frame)?))
}

fn inserter_2d(d: &Dictionary) -> Result<ProbabilityInserter, PointsError> {
    let inserter = d.dictionary("range_data_inserter")?;
    let options = ProbabilityInserterOptions {
        hit_probability: inserter.number("hit_probability")?,
        miss_probability: inserter.number("miss_probability")?,
        insert_free_space: inserter.boolean("insert_free_space")?,
        ..ProbabilityInserterOptions::default()
    };
    Ok(ProbabilityInserter::new(&options)?)
}

fn probability_grid(d: &Dictionary, context: &PipelineContext, log: Log) -> Made {
    let action = "write_probability_grid";
    let draw = optional(d, "draw_trajectories", Dictionary::boolean, true)?;
    let output_type = optional(d, "output_type", Dictionary::string, "png".to_owned())?;
    let path = context.file(&format!("{}.{output_type}", d.string("filename")?));
    let output = match output_type.as_str() {
        "png" => GridOutput2d::Png {
            path,
            trajectories: if draw { context.trajectories.clone() } else { Vec::new() },
        },
        "pb" => {
            if draw {
                log("Trajectories are not drawn into a serialised grid.");
            }
            GridOutput2d::Proto { path }
        }
        other => return Err(setting(action, format!("output_type is \"{other}\": it must be png or pb"))),
    };
    let resolution = size(d, "resolution", action)?;
    Ok(Box::new(WriteGrid2d::new(resolution, inserter_2d(d)?, output, &context.frame)?))
}

fn ros_map(d: &Dictionary, context: &PipelineContext, _: Log) -> Made {
    let output = GridOutput2d::RosMap { stem: context.file(&d.string("filestem")?) };
    let resolution = size(d, "resolution", "write_ros_map")?;
    Ok(Box::new(WriteGrid2d::new(resolution, inserter_2d(d)?, output, &context.frame)?))
}

fn xray(d: &Dictionary, context: &PipelineContext, _: Log) -> Made {
    let action = "write_xray_image";
    let floors = match optional(d, "separate_floors", Dictionary::boolean, false)? {
        false => Vec::new(),
        true => match context.trajectories.as_slice() {
            [trajectory] => detect_floors(trajectory)?,
            _ => return Err(setting(action, "separate_floors needs exactly one trajectory")),
        },
    };
    let draw = optional(d, "draw_trajectories", Dictionary::boolean, true)?;
    let options = XrayOptions {
        file: context.file(&d.string("filename")?),
        voxel_size: size(d, "voxel_size", action)? as f32,
        view_from_points: view_from_points(&transform(&d.dictionary("transform")?, action)?, &context.frame),
        saturation_factor: optional(d, "saturation_factor", Dictionary::number, 1.0)? as f32,
        floors,
        trajectories: if draw { context.trajectories.clone() } else { Vec::new() },
    };
    Ok(Box::new(WriteXray::new(options)?))
}

/// Transform from the frame of the points to a view of the map, up to the origin of the view, which pictures
/// do not show.
fn view_from_points(view_from_map: &Rigid3, frame: &NearFrame) -> Rigid3 {
    if frame.is_map() {
        return *view_from_map;
    }
    let view_from_points = view_from_map * frame.in_map(&Rigid3::identity());
    NearFrame::around([view_from_points.translation.vector]).near(&view_from_points)
}

/// Reads a table with `translation` {x, y, z} and `rotation`: {roll, pitch, yaw}, or a quaternion with keys
/// w, x, y, z.
fn transform(d: &Dictionary, action: &'static str) -> Result<Rigid3, PointsError> {
    let translation = d.dictionary("translation")?.array_of_numbers()?;
    let [x, y, z] = translation.as_slice() else {
        return Err(setting(action, "translation must be three numbers"));
    };
    let table = d.dictionary("rotation")?;
    let rotation = if table.has_key("w") {
        let [w, x, y, z] = [table.number("w")?, table.number("x")?, table.number("y")?, table.number("z")?];
        let quaternion = portolan_geometry::nalgebra::Quaternion::new(w, x, y, z);
        if (quaternion.norm() - 1.0).abs() > QUATERNION_TOLERANCE || quaternion.norm().is_nan() {
            return Err(setting(action, format!("the quaternion has length {}, not 1", quaternion.norm())));
        }
        Quaternion::new_unchecked(quaternion)
    } else {
        let angles = table.array_of_numbers()?;
        let [roll, pitch, yaw] = angles.as_slice() else {
            return Err(setting(action, "rotation must be roll, pitch and yaw, or w, x, y, z"));
        };
        rotation_from_roll_pitch_yaw(*roll, *pitch, *yaw)
    };
    let pose = Rigid3::from_parts(portolan_geometry::Vector3::new(*x, *y, *z).into(), rotation);
    let finite = pose.to_homogeneous().iter().all(|v| v.is_finite());
    finite.then_some(pose).ok_or_else(|| setting(action, "the transform is not finite"))
}

/// The table of a configuration under a key, as a dictionary.
///
/// # Errors
/// If there is no such table.
pub fn table_of(configuration: &portolan_config::Table, key: &str) -> Result<Dictionary, PointsError> {
    match configuration.entries.get(key).and_then(Value::as_table) {
        Some(table) => Ok(Dictionary::new(table.clone())),
        None => Err(setting("pipeline", format!("the configuration has no table \"{key}\""))),
    }
}
