//! Converts options and sensors of a trajectory to and from the third message of a file.

use std::collections::BTreeSet;

use portolan_config::{PureLocalizationTrimmerOptions, TrajectoryBuilderOptions};
use portolan_geometry::Time;
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::InitialTrajectoryPose;
use portolan_sensor::{SensorId, SensorKind};

use super::MapConversionError;
use super::option_message::OptionMessage;
use super::values::{id_to_proto, pose_in_file};
use portolan_pbstream::pose_to_proto;
use portolan_pbstream::proto::mapping::sensor_id::SensorType;
use portolan_pbstream::proto::mapping::{
    self, TrajectoryBuilderOptions as BuilderMessage, TrajectoryBuilderOptionsWithSensorIds as WithSensors,
};

/// Number of submaps that the deprecated `pure_localization = true` keeps.
const PURE_LOCALIZATION_SUBMAPS: usize = 3;

/// All options of a trajectory, 2D and 3D, as a message.
pub fn builder_options_to_proto(options: &TrajectoryBuilderOptions) -> BuilderMessage {
    options.to_message()
}

/// The options of a message. Absent tables, as in older files, have their defaults; absent numbers are zero.
/// The deprecated `pure_localization` becomes a trimmer that keeps 3 submaps.
#[allow(deprecated)]
pub fn builder_options_from_proto(message: &BuilderMessage) -> TrajectoryBuilderOptions {
    let mut options = TrajectoryBuilderOptions::of_message(message, &TrajectoryBuilderOptions::default());
    if message.pure_localization && options.pure_localization_trimmer.is_none() {
        let max_submaps_to_keep = PURE_LOCALIZATION_SUBMAPS;
        options.pure_localization_trimmer = Some(PureLocalizationTrimmerOptions { max_submaps_to_keep });
    }
    options
}

/// Options, sensors (by kind, then name) and start of a trajectory as a message.
///
/// # Errors
/// If the start refers to a trajectory whose number does not fit a file.
pub fn trajectory_options_to_proto(
    options: &TrajectoryBuilderOptions,
    sensors: &BTreeSet<SensorId>,
    initial_pose: Option<&InitialTrajectoryPose>,
) -> Result<WithSensors, MapConversionError> {
    let mut message = builder_options_to_proto(options);
    if let Some(initial) = initial_pose {
        message.initial_trajectory_pose = Some(mapping::InitialTrajectoryPose {
            relative_pose: Some(pose_to_proto(&initial.relative_pose)),
            to_trajectory_id: id_to_proto(initial.to_trajectory_id.0)?,
            timestamp: initial.time.ticks(),
        });
    }
    let mut sensor_id: Vec<_> = sensors
        .iter()
        .map(|s| mapping::SensorId { r#type: sensor_type(s.kind).into(), id: s.id.to_string() })
        .collect();
    sensor_id.sort_by(|a, b| (a.r#type, &a.id).cmp(&(b.r#type, &b.id)));
    Ok(WithSensors { sensor_id, trajectory_builder_options: Some(message) })
}

/// Options and sensors of a message. Sensors of unknown kinds are left out and counted.
pub fn trajectory_options_from_proto(
    message: &WithSensors,
    issues: &mut IssueLog,
) -> (TrajectoryBuilderOptions, BTreeSet<SensorId>) {
    let mut sensors = BTreeSet::new();
    for sensor in &message.sensor_id {
        match SensorType::try_from(sensor.r#type).ok().and_then(sensor_kind) {
            Some(kind) => {
                sensors.insert(SensorId::new(kind, sensor.id.as_str()));
            }
            None => issues.count(IssueKind::UnknownSensorKind, 1),
        }
    }
    let default = BuilderMessage::default();
    (builder_options_from_proto(message.trajectory_builder_options.as_ref().unwrap_or(&default)), sensors)
}

/// Start of a trajectory, if its options have one: number of the trajectory in the file that it is relative
/// to, relative pose, and time.
pub(super) fn initial_pose_from_proto(
    message: &WithSensors,
) -> Option<(i32, Option<portolan_geometry::Rigid3>, Time)> {
    let initial = message.trajectory_builder_options.as_ref()?.initial_trajectory_pose.as_ref()?;
    let pose = pose_in_file(initial.relative_pose.as_ref());
    Some((initial.to_trajectory_id, pose, Time::from_ticks(initial.timestamp)))
}

fn sensor_type(kind: SensorKind) -> SensorType {
    match kind {
        SensorKind::Range => SensorType::Range,
        SensorKind::Imu => SensorType::Imu,
        SensorKind::Odometry => SensorType::Odometry,
        SensorKind::FixedFramePose => SensorType::FixedFramePose,
        SensorKind::Landmark => SensorType::Landmark,
    }
}

/// Results of another program's local SLAM are not measurements: they have no sensor kind here.
fn sensor_kind(kind: SensorType) -> Option<SensorKind> {
    Some(match kind {
        SensorType::Range => SensorKind::Range,
        SensorType::Imu => SensorKind::Imu,
        SensorType::Odometry => SensorKind::Odometry,
        SensorType::FixedFramePose => SensorKind::FixedFramePose,
        SensorType::Landmark => SensorKind::Landmark,
        SensorType::LocalSlamResult => return None,
    })
}
