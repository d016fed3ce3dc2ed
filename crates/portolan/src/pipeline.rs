//! Maps a recording, from reading to the finished map.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use portolan_config::Options;
use portolan_diagnose::{ImuMounting, compare_scans};
use portolan_geometry::{Dimension, NearFrame, Rigid3, Time, TransformBuffer, quaternion_from_angle_axis};
use portolan_ingest::{
    AzimuthTimes, IngestError, IngestOptions, Ingestion, Inventory, RangeNoise, SensorPlan, StampPolicy, plan,
};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapping::{
    BackendProgress, Consistency, DegenerateInterval, EndedTrajectory, InitialTrajectoryPose, Loss, Map,
    Mapper, MapperError, MapperSettings, MatchingResult, PoseGraph, Space, TrajectoryId, of_trajectory,
};
use portolan_numeric::LatencyHistogram;
use portolan_recall::Memory;
use portolan_recording::{Recording, RecordingError};
use portolan_reprojection::KeptScans;
use portolan_sensor::SensorId;

use crate::automatic;
use crate::known_places::{KnownMapSpace, KnownPlaces};
use crate::silence::Silences;
use crate::soundness::sound_poses;
use crate::unusable_scans::{ScanTally, UnusableScans};

/// Reasons why a recording could not be mapped.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// An error of the recording or its content.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// The recording could not be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// An error of mapping.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// An invalid setting.
    #[error("{0}")]
    Setting(String),
    /// Nothing was mapped.
    #[error("{0}; see `portolan check`, which looks at the recording as it is")]
    NoScans(Box<UnusableScans>),
}

/// Progress of mapping.
#[derive(Clone, Copy, Debug)]
pub struct PipelineProgress {
    /// Bytes of the recording read.
    pub position_bytes: u64,
    /// Bytes of the recording.
    pub total_bytes: u64,
    /// Seconds of the recording that are mapped.
    pub recording_seconds: f64,
    /// The pose graph.
    pub backend: BackendProgress,
}

/// A mapped recording.
pub struct MappedRecording<S: Space> {
    /// The map.
    pub map: Map<S>,
    /// Its trajectory in the map.
    pub trajectory_id: TrajectoryId,
    /// Which topics were used as which sensors.
    pub plan: SensorPlan,
    /// Scans matched.
    pub scans: u64,
    /// Seconds from the first to the last measurement.
    pub recording_seconds: f64,
    /// Time that local SLAM took for each matched scan.
    pub scan_times: LatencyHistogram,
    /// Repairs and losses: of the recording, of known maps, and while mapping.
    pub issues: IssueLog,
    /// Intervals in which scans had degenerate directions and the prediction determined the motion (3D).
    pub degenerate_intervals: Vec<DegenerateInterval>,
    /// Intervals in which nothing constrained the pose of the scanner, and what followed.
    pub losses: Vec<Loss>,
    /// Scans whose stamps were changed: their times in the map, and the stamps as recorded.
    pub recorded_times: BTreeMap<Time, Time>,
    /// The scans, if they are to be kept.
    pub kept_scans: KeptScans,
    /// Agreement of its scans with known maps.
    pub in_known_maps: Consistency,
    /// Whether it was stopped before the end of the recording, or before the map was finished.
    pub interrupted: bool,
}

impl<S: Space> MappedRecording<S> {
    /// Trajectories of the recording in the map: one, and one more for each time that its pose was lost.
    pub fn pieces(&self) -> Vec<TrajectoryId> {
        std::iter::once(self.trajectory_id).chain(self.losses.iter().filter_map(|loss| loss.piece)).collect()
    }

    /// Whether the piece of map after a loss is not connected with the map before.
    pub fn is_apart(&self, loss: &Loss) -> bool {
        let Some(piece) = loss.piece else { return true };
        let connectivity = &self.map.graph.state().connectivity;
        let before = self.pieces().into_iter().take_while(|id| *id != piece);
        !before.into_iter().any(|id| connectivity.are_connected(id, piece))
    }

    /// Whether odometry alone determines the pose of a piece of map.
    pub fn is_tied_by_odometry_alone(&self, loss: &Loss) -> bool {
        loss.piece.is_some_and(|piece| self.map.graph.is_tied_by_odometry_alone(piece))
    }

    /// Whether odometry alone determines the pose of a piece of map, although scans contradicted the map
    /// before it.
    pub fn is_unconfirmed(&self, loss: &Loss) -> bool {
        !loss.is_gap && self.is_tied_by_odometry_alone(loss)
    }

    /// Whether data were lost, of the recording, of known maps or while mapping; a piece of map is not
    /// connected with the rest; parts of the map overlap wrongly; or their relative pose is uncertain.
    pub fn lost_data(&self) -> bool {
        self.issues.lost_data()
            || self.losses.iter().any(|loss| self.is_apart(loss) || self.is_unconfirmed(loss))
            || self.map.graph.self_consistency().is_contradictory()
            || self.map.graph.drift().is_large()
    }

    /// Whether the map is sound and may be written: poses and constraints are finite, rotations are valid.
    pub fn is_sound(&self) -> bool {
        self.issues.count_of(IssueKind::GraphUnsound) == 0
    }

    /// Pose of the tracking frame in the map for every scan with a known pose, with the times that scans have
    /// in the map, in order of time. Scans that fitted nowhere have none, and invalid poses are left out.
    pub fn scan_poses(&self) -> Vec<(Time, Rigid3)> {
        self.scan_poses_of(self.pieces())
    }

    /// Those of the first piece and of pieces that are connected with it: a consistent map.
    pub fn connected_scan_poses(&self) -> Vec<(Time, Rigid3)> {
        let connectivity = &self.map.graph.state().connectivity;
        let is_connected = |id: &TrajectoryId| {
            *id == self.trajectory_id || connectivity.are_connected(*id, self.trajectory_id)
        };
        self.scan_poses_of(self.pieces().into_iter().filter(is_connected))
    }

    fn scan_poses_of(&self, pieces: impl IntoIterator<Item = TrajectoryId>) -> Vec<(Time, Rigid3)> {
        let poses = pieces.into_iter().flat_map(|id| sound_poses(self.map.scan_poses(id)));
        let mut poses: Vec<_> = poses.filter(|(time, _)| self.has_pose(*time)).collect();
        poses.sort_by_key(|(time, _)| *time);
        poses
    }

    /// The same, each with the time of its message in the recording.
    pub fn trajectory(&self) -> Vec<(Time, Rigid3)> {
        let recorded = |time: Time| self.recorded_times.get(&time).copied().unwrap_or(time);
        let mut poses = self.scan_poses();
        poses.iter_mut().for_each(|(time, _)| *time = recorded(*time));
        poses.sort_by_key(|(time, _)| *time);
        poses
    }

    /// Whether the pose of scans of this time is known, however accurately.
    fn has_pose(&self, time: Time) -> bool {
        !self.losses.iter().any(|loss| loss.leaves_open(time))
    }

    /// How many scans of each loss fitted nowhere and have no pose.
    pub fn scans_without_pose(&self) -> Vec<usize> {
        let mut counts = vec![0; self.losses.len()];
        let pieces = self.pieces().into_iter().filter_map(|id| self.map.trajectories.get(&id));
        for scan in pieces.flat_map(|piece| piece.scans.iter()) {
            for (loss, count) in self.losses.iter().zip(&mut counts) {
                *count += usize::from(loss.leaves_open(scan.time));
            }
        }
        counts
    }
}

/// A recording about to be mapped: its content, the topics in use, and the options.
#[derive(Clone, Debug)]
pub struct Preparation {
    inventory: Inventory,
    /// Which topics are used as which sensors.
    pub plan: SensorPlan,
    /// Options of mapping; may still be changed.
    pub options: Options,
    /// Mapping in 2D or 3D. Follows from the options.
    pub dimension: Dimension,
    /// Maximum number of threads for searching and optimising, if set by the user
    /// ([`RequestedOptions::background_threads`](crate::RequestedOptions::background_threads)).
    pub background_threads: Option<usize>,
    /// Folder in which scans are kept for pictures, in an unnamed file; they are not kept if unset.
    pub keep_scans_in: Option<PathBuf>,
    /// Folder in which data that grow with the length of the recording are spooled, in unnamed files; in
    /// memory if unset.
    pub spool_in: Option<PathBuf>,
    /// Results remembered from an earlier run and for a later one.
    pub memory: Memory,
}

impl Preparation {
    /// Survey of the recording.
    pub fn inventory(&self) -> &Inventory {
        &self.inventory
    }
}

/// Surveys a recording. Without `options` they are chosen from its content.
///
/// # Errors
/// If the recording cannot be read, or no plan can be made of what is in it.
pub fn prepare(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    options: Option<Options>,
) -> Result<Preparation, PipelineError> {
    let inventory = Inventory::of(recording, ingest)?;
    let mut plan = plan(&inventory, ingest).map_err(IngestError::from)?;
    if options.is_none() && plan.dimension == Dimension::TwoD {
        plan = check_scans(recording, &inventory, ingest, plan)?;
    }
    if options.is_none() && plan.dimension == Dimension::ThreeD {
        plan = check_imu_3d(recording, &inventory, ingest, plan)?;
    }
    let options = options.unwrap_or_else(|| match plan.dimension {
        Dimension::TwoD => automatic::options_2d(&plan, &plan.statistics()),
        Dimension::ThreeD => automatic::options_3d(&plan, &plan.statistics()),
    });
    let dimension = options.map_builder.dimension().map_err(|e| PipelineError::Setting(e.to_string()))?;
    Ok(Preparation {
        inventory,
        plan,
        options,
        dimension,
        background_threads: None,
        keep_scans_in: None,
        spool_in: None,
        memory: Memory::default(),
    })
}

/// Compares motions from scans with those of odometry and IMU. The plan then corrects the times of beams and
/// the clocks of odometry and IMU, or leaves one of them out, if scans show that. What the user specified is
/// kept.
fn check_scans(
    recording: &dyn Recording,
    inventory: &Inventory,
    ingest: &IngestOptions,
    mut plan: SensorPlan,
) -> Result<SensorPlan, PipelineError> {
    let compared = compare_scans(recording, inventory, &plan)?;
    if let Some(fault) = &compared.imu_fault {
        plan = warn_of_imu(fault, inventory, ingest, plan)?;
    } else if let Some(delay) = compared.imu_delay.filter(|_| ingest.time_offsets.is_empty()) {
        plan.delay_imu(delay.seconds, delay.sigma);
    }
    for (topics, jitter) in compared.jitters.iter().filter(|_| ingest.stamps != StampPolicy::AsIs) {
        plan.mark_jitter(topics, jitter);
    }
    if ingest.azimuth_times == AzimuthTimes::Auto {
        for (topic, duration) in &compared.durations {
            plan.time_beams(topic, duration.seconds, duration.sigma);
        }
    }
    if ingest.range_noise == RangeNoise::Auto {
        for (topic, sigma) in &compared.noises {
            plan.smooth_ranges(topic, *sigma);
        }
    }
    let is_wanted = ingest.odometry_topic.is_some() || ingest.use_odometry == Some(true);
    if let Some(hold) = compared.hold {
        plan.reject_repeats(&hold.to_string(), hold.longest, is_wanted);
    }
    if let Some(fault) = compared.fault {
        plan.reject_odometry(&fault.to_string(), fault.is_mirrored(), is_wanted);
    } else if let Some(delay) = compared.delay.filter(|_| ingest.time_offsets.is_empty()) {
        plan.delay_odometry(delay.seconds, delay.sigma);
    }
    Ok(plan)
}

/// Leaves out an IMU that does not rotate as the lidar does, unless the user asked for it. If only its unit
/// is wrong, that is corrected.
fn warn_of_imu(
    fault: &ImuMounting,
    inventory: &Inventory,
    ingest: &IngestOptions,
    mut plan: SensorPlan,
) -> Result<SensorPlan, PipelineError> {
    if fault.is_in_degrees() {
        plan.turn_in_degrees();
        return Ok(plan);
    }
    let is_wanted = ingest.imu_topic.is_some() || ingest.use_imu == Some(true);
    if !is_wanted {
        // The frame of an untrusted IMU cannot be the tracking frame: it need not even be upright.
        let without = IngestOptions { use_imu: Some(false), ..ingest.clone() };
        plan = portolan_ingest::plan(inventory, &without).map_err(IngestError::from)?;
    }
    plan.warn_of_imu(&fault.imu, &fault.to_string(), is_wanted);
    Ok(plan)
}

/// Compares rotations of a lidar with those of the IMU. The plan then corrects the clock and mounting of the
/// IMU, or leaves the IMU out, if they show that. What the user specified is kept.
fn check_imu_3d(
    recording: &dyn Recording,
    inventory: &Inventory,
    ingest: &IngestOptions,
    mut plan: SensorPlan,
) -> Result<SensorPlan, PipelineError> {
    if plan.imu.is_none() {
        return Ok(plan);
    }
    let is_wanted = ingest.imu_topic.is_some() || ingest.use_imu == Some(true);
    if is_wanted && !ingest.time_offsets.is_empty() {
        return Ok(plan);
    }
    let compared = portolan_clocks::measure(recording, inventory, ingest, &mut |_| {});
    if let Some(misalignment) = compared.misalignment.as_ref().filter(|_| !is_wanted) {
        let correction = quaternion_from_angle_axis(&misalignment.rotation);
        plan.turn_imu(correction, &misalignment.to_string());
    }
    if let Some(mounting) = &compared.mounting {
        plan = warn_of_imu(mounting, inventory, ingest, plan)?;
    } else if let Some(offset) =
        portolan_clocks::common_offset(&compared.offsets).filter(|_| ingest.time_offsets.is_empty())
    {
        plan.delay_imu(offset.seconds, offset.sigma);
    }
    Ok(plan)
}

/// A map that a recording is added to, in a near frame.
pub struct KnownMap<S: Space> {
    /// Its trajectories.
    pub graph: PoseGraph<S>,
    /// The frame of the graph; that of the files until [`KnownMap::bring_near`].
    pub frame: NearFrame,
    /// Options, sensors and scans of its trajectories.
    pub trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
    /// Pose in that frame at which the recording starts (`map_from_tracking`), if known. Otherwise it is
    /// searched in the whole map.
    pub start: Option<Rigid3>,
    /// Repairs and losses when it was read.
    pub issues: IssueLog,
}

impl<S: Space> KnownMap<S> {
    /// A map without content.
    pub fn empty(options: &Options) -> Self {
        let graph = PoseGraph::new(options.map_builder.pose_graph.clone());
        let frame = NearFrame::default();
        Self { graph, frame, trajectories: BTreeMap::new(), start: None, issues: IssueLog::default() }
    }

    /// Moves everything into a near frame, so that single precision suffices.
    pub fn bring_near(&mut self) {
        self.frame = self.graph.near_frame();
        self.graph.move_by(&-self.frame.origin());
        self.start = self.start.map(|start| self.frame.near(&start));
    }

    /// The start for the pose graph: at `time`, relative to the first trajectory of the map that has nodes.
    fn initial_pose(&self, time: Time) -> Option<InitialTrajectoryPose> {
        let to_trajectory_id = self.graph.state().nodes.keys().next()?.trajectory_id;
        let nodes: TransformBuffer = of_trajectory(&self.graph.state().nodes, to_trajectory_id)
            .map(|(_, node)| (node.data.time, node.map_from_tracking))
            .collect();
        let relative_pose = nodes.lookup_clamped(time)?.inverse() * self.start?;
        Some(InitialTrajectoryPose { to_trajectory_id, relative_pose, time })
    }
}

/// Maps a recording in the space that the preparation names, beginning with the content of `known`. `observe`
/// is called regularly and stops everything cleanly by returning false.
///
/// The function is long because the part after the loop takes apart everything that the loop has filled.
pub fn map_recording<S: KnownMapSpace>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: Preparation,
    known: KnownMap<S>,
    settings: MapperSettings,
    observe: &mut dyn FnMut(&PipelineProgress) -> bool,
) -> Result<MappedRecording<S>, PipelineError> {
    let Preparation { inventory, plan, options, keep_scans_in, spool_in, memory, .. } = preparation;
    let mut ingestion = Ingestion::with_plan(recording, &inventory, plan.clone(), ingest)?;
    let initial_pose = inventory.first_time.and_then(|time| known.initial_pose(time));
    let mut places = KnownPlaces::new(&known, &options, settings.threads);
    let (known_issues, frame) = (known.issues, known.frame);
    let mut mapper = Mapper::<S>::with_graph(&options, settings, known.graph, known.trajectories)?;
    mapper.remember_with(&memory)?;
    places.begin(&mut mapper)?;
    spool_in.map_or(Ok(()), |folder| mapper.spool_in(&folder))?;
    let sensors: BTreeSet<SensorId> = ingestion.sensors().into_iter().collect();
    let trajectory_id = mapper.add_trajectory(&sensors, initial_pose)?;
    let mut silences = Silences::default();
    let mut tally = ScanTally::default();
    let mut kept_scans = keep_scans_in.as_deref().map_or_else(KeptScans::default, KeptScans::in_folder);
    let (mut scans, mut interrupted) = (0, false);
    let mut take = |matched: &[MatchingResult<S>], mapper: &mut Mapper<S>| {
        for scan in matched {
            kept_scans.keep(scan.time, &scan.local_from_tracking, &scan.measured);
        }
        scans += matched.len() as u64;
        places.add(matched, mapper)
    };
    let mut span: Option<(Time, Time)> = None;
    let mut latest = None;
    while let Some((sensor_id, measurement)) = ingestion.next_measurement()? {
        tally.add(&measurement);
        let time = measurement.time();
        let (first, last) = span.get_or_insert((time, time));
        *last = time.max(*last);
        let recording_seconds = last.seconds_since(*first);
        silences.add(&sensor_id, time);
        let matched = mapper.add(trajectory_id, &sensor_id, measurement)?;
        take(&matched, &mut mapper)?;
        let (position_bytes, total_bytes) = ingestion.progress();
        let backend = mapper.progress();
        let progress = PipelineProgress { position_bytes, total_bytes, recording_seconds, backend };
        latest = Some(progress);
        if !observe(&progress) {
            interrupted = true;
            mapper.stop();
            break;
        }
    }
    let matched = mapper.finish_trajectory(trajectory_id)?;
    take(&matched, &mut mapper)?;
    kept_scans.finish();
    places.finish(&mut mapper)?;
    let scan_times = mapper.scan_times().clone();
    let degenerate_intervals = mapper.degenerate_intervals().to_vec();
    let losses = mapper.losses().to_vec();
    let was_read = !interrupted;
    let (mut map, mapping_issues) = mapper.finish_while(&mut |backend| {
        let continues = latest.is_none_or(|latest| observe(&PipelineProgress { backend, ..latest }));
        interrupted |= !continues;
        continues
    })?;
    if scans == 0 || map.graph.state().nodes.is_empty() {
        let mut issues = mapping_issues;
        issues.merge(&ingestion.issues());
        return Err(PipelineError::NoScans(Box::new(tally.verdict(&issues))));
    }
    map.graph.move_by(&frame.origin());
    let mut unused_fixes = 0;
    for id in std::iter::once(trajectory_id).chain(losses.iter().filter_map(|loss| loss.piece)) {
        if let Some(ended) = map.trajectories.get_mut(&id) {
            ended.fixed_frame_on_earth = ingestion.nav_sat_origin();
        }
        unused_fixes += map.graph.unused_fixes(id);
    }
    let mut issues = known_issues;
    issues.merge(&ingestion.issues());
    if was_read {
        issues.merge(&silences.issues());
    }
    issues.append(&mapping_issues);
    issues.count(IssueKind::FixesNotUsed, unused_fixes as u64);
    issues.count(IssueKind::ScansNotKept, u64::from(kept_scans.failure().is_some()));
    let mut mapped = MappedRecording {
        map,
        trajectory_id,
        plan,
        scans,
        recording_seconds: span.map_or(0.0, |(first, last)| last.seconds_since(first)),
        scan_times,
        issues,
        degenerate_intervals,
        losses,
        recorded_times: ingestion.recorded_times().clone(),
        kept_scans,
        in_known_maps: Consistency::default(),
        interrupted,
    };
    mapped.in_known_maps = mapped.map.graph.consistency_with_others(&mapped.pieces().into_iter().collect());
    Ok(mapped)
}
