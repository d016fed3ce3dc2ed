//! Options requested by the user, and what they determine about the sensors before the recording is read.

use std::collections::BTreeSet;

use portolan_config::{ConfigError, Options, explain};
use portolan_ingest::{ConfiguredSensors, IngestOptions, SamplingRatios};

/// The setting with which memory and time depend on the mapped area instead of the duration of mapping.
pub const LIFELONG: &str = "portolan.submaps_per_place=4";

/// A whole configuration, single settings on top of it or of the automatic choice, or nothing.
#[derive(Clone, Debug, Default)]
pub struct RequestedOptions {
    /// The configuration of a robot; none: options are chosen from the recording.
    pub configuration: Option<Options>,
    /// Settings `path=value` that override everything, in order.
    pub settings: Vec<String>,
}

impl RequestedOptions {
    /// Sets what reading the recording needs of the options: sensors, frames, sampling. Topics, the tracking
    /// frame and excluded sensors that `ingest` already gives are kept.
    ///
    /// # Errors
    /// A setting that names no option, or has a value that it cannot have.
    pub fn configure(&self, ingest: &mut IngestOptions) -> Result<(), ConfigError> {
        let mut options = self.configuration.clone().unwrap_or_default();
        let mut named = BTreeSet::new();
        for setting in &self.settings {
            options.set(setting)?;
            named.extend(setting.split_once('=').and_then(|(path, _)| explain(path)).map(|doc| doc.path));
        }
        let asked = Asked { everything: self.configuration.is_some(), named };
        choose_dimension(ingest, &options, &asked);
        choose_sensors(ingest, &options, &asked);
        choose_frames(ingest, &options, &asked);
        sample(ingest, &options);
        Ok(())
    }

    /// Threads that a configuration or a setting allows for searching and optimising; none if neither gives a
    /// number.
    pub fn background_threads(&self) -> Option<usize> {
        let mut options = self.configuration.clone().unwrap_or_default();
        let mut is_asked = self.configuration.is_some();
        for setting in &self.settings {
            let path = setting.split_once('=').and_then(|(path, _)| explain(path)).map(|doc| doc.path);
            is_asked |= path.as_deref() == Some("map_builder.num_background_threads");
            options.set(setting).ok()?;
        }
        is_asked.then_some(options.map_builder.num_background_threads)
    }
}

/// Options that the user gave a value.
struct Asked {
    everything: bool,
    named: BTreeSet<String>,
}

impl Asked {
    fn about(&self, path: &str) -> bool {
        self.everything || self.named.contains(path)
    }

    /// The value if the user gave it.
    fn value<T>(&self, path: &str, value: T) -> Option<T> {
        self.about(path).then_some(value)
    }
}

/// A single setting chooses between 2D and 3D here; a whole configuration does it later.
fn choose_dimension(ingest: &mut IngestOptions, options: &Options, asked: &Asked) {
    let names = ["map_builder.use_trajectory_builder_2d", "map_builder.use_trajectory_builder_3d"];
    if asked.everything || !names.iter().any(|name| asked.named.contains(*name)) {
        return;
    }
    ingest.dimension = options.map_builder.dimension().ok().or(ingest.dimension);
}

fn choose_sensors(ingest: &mut IngestOptions, options: &Options, asked: &Asked) {
    let bridge = &options.bridge;
    let counts = ["num_laser_scans", "num_multi_echo_laser_scans", "num_point_clouds"];
    // Without a configuration it is not known yet whether the option for 2D counts; local SLAM in the
    // plane leaves out what it must not use.
    let use_imu = asked.everything.then_some(
        options.map_builder.use_trajectory_builder_3d
            || options.trajectory_builder.trajectory_builder_2d.use_imu_data,
    );
    let configured = ConfiguredSensors {
        num_laser_scans: bridge.num_laser_scans,
        num_multi_echo_laser_scans: bridge.num_multi_echo_laser_scans,
        num_point_clouds: bridge.num_point_clouds,
        use_odometry: asked.value("use_odometry", bridge.use_odometry),
        use_imu,
        use_nav_sat: asked.value("use_nav_sat", bridge.use_nav_sat),
        use_landmarks: asked.value("use_landmarks", bridge.use_landmarks),
    };
    if counts.iter().any(|name| asked.about(name)) {
        ingest.configured = Some(configured);
        return;
    }
    ingest.use_odometry = ingest.use_odometry.or(configured.use_odometry);
    ingest.use_imu = ingest.use_imu.or(configured.use_imu);
    ingest.use_nav_sat = ingest.use_nav_sat.or(configured.use_nav_sat);
    ingest.use_landmarks = ingest.use_landmarks.or(configured.use_landmarks);
}

fn choose_frames(ingest: &mut IngestOptions, options: &Options, asked: &Asked) {
    let bridge = &options.bridge;
    if ingest.tracking_frame.is_none() && asked.about("tracking_frame") && !bridge.tracking_frame.is_empty() {
        ingest.tracking_frame = Some(bridge.tracking_frame.clone());
    }
    if !bridge.map_frame.is_empty() {
        ingest.map_frame.clone_from(&bridge.map_frame);
    }
}

/// Options whose defaults are those of reading a recording anyway.
fn sample(ingest: &mut IngestOptions, options: &Options) {
    let bridge = &options.bridge;
    ingest.sampling = SamplingRatios {
        rangefinder: bridge.rangefinder_sampling_ratio,
        odometry: bridge.odometry_sampling_ratio,
        fixed_frame_pose: bridge.fixed_frame_pose_sampling_ratio,
        imu: bridge.imu_sampling_ratio,
        landmarks: bridge.landmarks_sampling_ratio,
    };
    ingest.num_subdivisions_per_laser_scan = bridge.num_subdivisions_per_laser_scan;
    ingest.ignore_out_of_order = bridge.ignore_out_of_order;
    ingest.with_intensities |= options.trajectory_builder.trajectory_builder_3d.use_intensities;
}
