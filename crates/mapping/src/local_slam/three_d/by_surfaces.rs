//! Local SLAM by matching sweeps to surfaces.

use portolan_config::ImuBasedPoseExtrapolatorOptions;
use portolan_geometry::nalgebra::Matrix3;
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3, is_valid_pose};
use portolan_lidar_odometry::{Going, Way};
use portolan_motion::{ImuBasedSettings, PoseExtrapolator};
use portolan_sensor::voxel_filter;

use super::conclusion::Wanted;
use super::first_sweeps::{FirstSweeps, TimedSweep};
use super::inertial::{Arrival, Felt};
use super::posts::{PostsToMatch, RecentPosts};
use super::surface_tracking::{MatchedSweep, SurfaceTracker, Target, in_tracking};
use super::unwarp::Gathered;
use super::upright::GRAVITY;
use super::{LocalSlam3d, MatchedScan, sweep_path};
use crate::weak_span::WeakScan;
use crate::{MatchingResult, OpenDirections, Spatial, TakenInstead};

/// Submaps of fewer scans are young.
const YOUNG: u32 = 10;
/// A match without the gyroscope has to fit so much better than one with it, unless that is saturated.
const CLEARLY_BETTER: f64 = 1.3;
/// After so many seconds without a sweep it may have gone on as before, or stopped; or a clock jumped.
const LONG_GAP: f64 = 0.5;
/// Who seems to go more slowly by the first two sweeps while the IMU rests stands, m/s.
const SLOW: f64 = 1.0;
/// Seconds for which sweeps that fit no surface are believed to go on as before.
const GOES_ON: f64 = 1.0;
/// How far off matches to grids are, metres, where sweeps fit no surface.
const GRID_ERROR: f64 = 0.2;

/// What matching to surfaces needs besides the submaps.
pub(super) struct BySurfaces {
    pub tracker: SurfaceTracker,
    voxel_size: f64,
    /// The first sweep, until the second one tells how fast it was.
    first: Option<TimedSweep>,
    /// When a sweep last fitted.
    fitted_at: Option<Time>,
    posts: RecentPosts,
}

impl BySurfaces {
    pub fn new(voxel_size: f64) -> Self {
        let (tracker, posts) = (SurfaceTracker::new(voxel_size), RecentPosts::default());
        Self { tracker, voxel_size, first: None, fitted_at: None, posts }
    }
}

/// What is expected of a sweep.
struct Outlook {
    /// The way as the extrapolator predicts it.
    predicted: Way,
    /// Where it stood until now, if it stands.
    stood: Option<Rigid3>,
    /// The way as accelerations tell it.
    felt: Option<Felt>,
    /// The way that is believed.
    way: Way,
    /// From the tracking frame to a level one at the end, as the IMU alone says.
    level: Option<Quaternion>,
    /// Whether the gyroscope was at the end of its range.
    saturated: bool,
    /// What stands around, where nothing measures how it goes.
    posts: Option<PostsToMatch>,
}

impl LocalSlam3d {
    /// One whole sweep: finds where it was taken, inserts it. The first one waits for the second.
    pub(super) fn match_to_surfaces(
        &mut self,
        time: Time,
        gathered: &[Gathered],
    ) -> Vec<MatchingResult<Spatial>> {
        let points = SurfaceTracker::sweep(gathered, time, &self.options);
        if points.is_empty() {
            self.count("scan without a single return");
            return Vec::new();
        }
        let sweep = TimedSweep { end: time, points };
        let mut results = Vec::new();
        if !self.has_submap() {
            let Some(by_surfaces) = &mut self.by_surfaces else { return results };
            let Some(first) = by_surfaces.first.take() else {
                by_surfaces.first = Some(sweep);
                return results;
            };
            let inserted = self.insert_first(&first, Some(&sweep));
            results.extend(inserted.map(|result| MatchingResult { measured: first.points, ..result }));
        }
        let matched = self.follow(&sweep);
        results.extend(matched.map(|result| MatchingResult { measured: sweep.points, ..result }));
        results
    }

    /// Inserts a first sweep for which no second came.
    pub(super) fn insert_waiting_first(&mut self) -> Vec<MatchingResult<Spatial>> {
        let Some(first) = self.by_surfaces.as_mut().and_then(|s| s.first.take()) else { return Vec::new() };
        let inserted = self.insert_first(&first, None);
        inserted.map(|result| MatchingResult { measured: first.points, ..result }).into_iter().collect()
    }

    fn insert_first(
        &mut self,
        first: &TimedSweep,
        second: Option<&TimedSweep>,
    ) -> Option<MatchingResult<Spatial>> {
        let voxel_size = self.by_surfaces.as_ref()?.voxel_size;
        let extrapolator = self.extrapolator.as_ref()?;
        let measured = |time: Time| extrapolator.estimate_gravity_orientation(time);
        let rotation_at: Option<&dyn Fn(Time) -> Quaternion> =
            if self.has_imu { Some(&measured) } else { None };
        let sweeps = FirstSweeps::new(first, second, rotation_at, voxel_size);
        let pieces = sweeps.pieces(first);
        let end = sweeps.pose_at(first.end);
        self.by_surfaces.as_mut()?.fitted_at = Some(first.end);
        // A pose from before, so that the extrapolator knows how fast it was.
        let earliest = extrapolator.last_pose_time().filter(|_| self.has_imu).unwrap_or(Time::MIN);
        let before = (first.end - Duration::from_seconds(0.05)).max(earliest);
        let (pose_before, gravity) = (sweeps.pose_at(before), self.has_imu.then(|| measured(first.end)));
        if !self.has_imu {
            self.extrapolator = Some(self.new_extrapolator());
        }
        let extrapolator = self.extrapolator.as_mut()?;
        extrapolator.add_pose(before, pose_before);
        extrapolator.add_pose(first.end, end);
        let gravity = gravity.map(|level| self.leveled(first.end, &end, level));
        let matched = MatchedSweep { local_from_tracking: end, pieces, found: None };
        Some(self.conclude(first.end, self.seen_from_end(first, matched), gravity))
    }

    /// What is expected of a sweep before it is matched.
    fn look_ahead(&mut self, end: Time) -> Option<Outlook> {
        let extrapolator = self.extrapolator.as_mut()?;
        extrapolator.prepare(end);
        let start = extrapolator.last_pose_time();
        let predicted = sweep_path::predicted(extrapolator, end);
        let has_odometry = extrapolator.has_odometry(end);
        if has_odometry {
            self.standstill.add_odometry(&predicted.shift(), predicted.seconds());
        }
        let stood = self.standstill.pose();
        let felt = start.filter(|_| self.has_imu).and_then(|start| self.inertial.felt(start, &predicted));
        let (mut way, going) = match (&stood, &felt) {
            (Some(pose), _) => (sweep_path::standing(extrapolator, end, pose), Going::Measured),
            (None, Some(felt)) if !has_odometry && self.inertial.is_right() => {
                (felt.way.clone(), Going::Felt(self.inertial.velocity_error()))
            }
            _ => (predicted.clone(), predicted.going),
        };
        way.going = going;
        way.turn_is_measured = self.has_imu && extrapolator.has_gyroscope(end);
        let level = self.has_imu.then(|| extrapolator.estimate_gravity_orientation(end));
        let saturated = self.saturated_at > start;
        Some(Outlook { predicted, stood, felt, way, level, saturated, posts: None })
    }

    /// Matches a sweep near the expected way, and near others if that may be wrong: then nothing is felt.
    fn match_near(&mut self, sweep: &TimedSweep, outlook: &mut Outlook) -> Option<MatchedSweep> {
        let extrapolator = self.extrapolator.as_mut()?;
        let BySurfaces { tracker, posts, .. } = self.by_surfaces.as_mut()?;
        let selection = tracker.selection(&sweep.points);
        let submap = self.active_submaps.matching_submap()?;
        outlook.posts = posts.to_match(sweep, &outlook.way, &submap.local_from_submap.inverse());
        let target = Target {
            local_from_submap: &submap.local_from_submap,
            surfaces: submap.surfaces.as_ref()?,
            posts: outlook.posts.as_ref(),
        };
        let unmeasured =
            outlook.way.turn_is_measured.then(|| sweep_path::turning_on(extrapolator, sweep.end));
        let mut matched = tracker.match_sweep(&selection, &outlook.way, &target);
        if matched.found.is_none() && matches!(outlook.way.going, Going::Felt(_)) {
            // A single wrong sample of an accelerometer throws it metres away.
            let mut as_before = outlook.predicted.clone();
            as_before.turn_is_measured = outlook.way.turn_is_measured;
            let matched_there = tracker.match_sweep(&selection, &as_before, &target);
            if matched_there.found.is_some() {
                (matched, outlook.way, outlook.felt) = (matched_there, as_before, None);
            }
        }
        if outlook.way.seconds() > LONG_GAP
            && let Some((_, last)) = extrapolator.last_pose()
        {
            let stayed = sweep_path::standing(extrapolator, sweep.end, &last);
            let matched_there = tracker.match_sweep(&selection, &stayed, &target);
            if matched_there.fit() > matched.fit() {
                (matched, outlook.way, outlook.felt) = (matched_there, stayed, None);
            }
        }
        if let Some(other) =
            unmeasured.filter(|_| outlook.saturated || matched.contradicts_turn(&outlook.way))
        {
            let by_scans = tracker.match_sweep(&selection, &other, &target);
            let wanted = if outlook.saturated { 1.0 } else { CLEARLY_BETTER };
            if by_scans.fit() > wanted * matched.fit() {
                (matched, outlook.way, outlook.felt) = (by_scans, other, None);
                self.count("sweep whose turn the gyroscope did not tell; scans told it");
            }
        }
        Some(matched)
    }

    /// Matches a sweep to the older active submap.
    fn follow(&mut self, sweep: &TimedSweep) -> Option<MatchingResult<Spatial>> {
        let mut outlook = self.look_ahead(sweep.end)?;
        let matched = self.match_near(sweep, &mut outlook)?;
        let Outlook { predicted, stood, felt, way, level, saturated, posts } = outlook;
        match stood {
            Some(_) => self.gyroscope_bias.observe(&predicted.turn(), &Quaternion::identity(), way.seconds()),
            None if saturated => {}
            None => self.learn_bias(&way, &matched),
        }
        let mut held = self.held_in_local(&matched);
        let open = self.report_match(sweep.end, &way, stood.is_some(), &matched);
        let asks_grids = self.asks_grids(sweep.end, &way, matched.found.is_some());
        let standing = posts.map(|posts| posts.seen_from_end(&matched.pieces));
        let mut scan = MatchedScan { open, ..self.seen_from_end(sweep, matched) };
        if asks_grids {
            held = Some(Matrix3::from_diagonal_element(GRID_ERROR * GRID_ERROR));
            self.match_to_grids(&mut scan);
        }
        self.standstill.add_match(sweep.end, &scan.local_from_tracking);
        let stands = self.standstill.pose();
        if let Some(pose) = stands {
            scan.local_from_tracking = pose;
        }
        if let Some(level) = &level {
            self.follow_inertially(sweep.end, &predicted, felt, (&scan, held), level);
        }
        if let (Some(points), Some(by_surfaces)) = (standing, &mut self.by_surfaces) {
            by_surfaces.posts.add(sweep.end, scan.local_from_tracking, points);
        }
        self.extrapolator.as_mut()?.add_pose(sweep.end, scan.local_from_tracking);
        let gravity = level.map(|level| self.leveled(sweep.end, &scan.local_from_tracking, level));
        let enough = stands.is_some() && !self.is_young() && self.stands_since_inserted(sweep.end);
        let wanted = match enough {
            true => Wanted::No,
            // Without a gyroscope the first sweeps are not straight enough to be worth more than their motion.
            false if way.turn_is_measured && self.is_young() => Wanted::Yes,
            false => Wanted::IfMoved,
        };
        let result = self.conclude_as(wanted, sweep.end, scan, gravity);
        match stands {
            Some(_) => self.inserted_standing += i32::from(result.inserted.is_some()),
            None => self.inserted_standing = 0,
        }
        Some(result)
    }

    /// Whether grids tell where a sweep is that fits no surface. Those of a bare place were made by the beams, and hold a
    /// scanner where it was: where a gyroscope tells how it turns, it goes on as before for a while.
    fn asks_grids(&mut self, end: Time, way: &Way, fits_surfaces: bool) -> bool {
        let Some(by_surfaces) = &mut self.by_surfaces else { return false };
        if fits_surfaces {
            by_surfaces.fitted_at = Some(end);
        }
        let since = by_surfaces.fitted_at.map_or(f64::INFINITY, |at| end.seconds_since(at));
        !fits_surfaces && way.going == Going::AsBefore && (!way.turn_is_measured || since > GOES_ON)
    }

    /// The covariance of what a match may be held off by, m² in the local map; none where a sweep fits nothing.
    fn held_in_local(&self, matched: &MatchedSweep) -> Option<Matrix3<f64>> {
        let found = matched.found.as_ref()?;
        let turn = self.active_submaps.matching_submap()?.local_from_submap.rotation.to_rotation_matrix();
        Some(turn * found.held * turn.transpose())
    }

    /// Tells the inertial filter where a sweep ended, or begins it anew there.
    fn follow_inertially(
        &mut self,
        end: Time,
        predicted: &Way,
        felt: Option<Felt>,
        (scan, held): (&MatchedScan, Option<Matrix3<f64>>),
        level: &Quaternion,
    ) {
        let (place, turn) = (scan.local_from_tracking.translation.vector, scan.local_from_tracking.rotation);
        let open: Vec<Vector3> = scan.open.translations.iter().map(|d| turn * d).collect();
        if let Some(felt) = felt {
            let stands = self.standstill.pose().is_some();
            let before = predicted.end().translation.vector;
            self.inertial.follow(end, &felt, &before, &Arrival { place, open: &open, held, stands });
            return;
        }
        let at_rest = self.standstill.force_at_rest();
        let force = turn * (level.inverse() * Vector3::z()) * at_rest.unwrap_or(GRAVITY);
        let velocity = (place - predicted.start().translation.vector) / predicted.seconds().max(1e-3);
        // An IMU rests in smooth motion, too.
        let seems_to_stand = at_rest.is_some() && velocity.norm() < SLOW;
        let velocity = if seems_to_stand { Vector3::zeros() } else { velocity };
        self.inertial.begin(end, [&place, &velocity, &force], at_rest.is_some());
    }

    /// From the tracking frame to a level one, where a sweep matched and the IMU alone says `level`.
    fn leveled(&mut self, end: Time, local_from_tracking: &Rigid3, level: Quaternion) -> Quaternion {
        self.upright.add_sweep(end, local_from_tracking, &level);
        self.upright.level_from_tracking(&local_from_tracking.rotation).unwrap_or(level)
    }

    /// Whether the first submap does not know its surfaces yet: a single sweep shows few of them.
    fn is_young(&self) -> bool {
        self.active_submaps.matching_submap().is_none_or(|submap| submap.num_range_data < YOUNG)
    }

    /// What a match says of the gyroscope.
    fn learn_bias(&mut self, way: &Way, matched: &MatchedSweep) {
        let holds_rotation = matched.found.as_ref().is_some_and(|f| f.weak.rotations.is_empty());
        // What the first sweeps got wrong fits the map that was made of them.
        if way.turn_is_measured && holds_rotation && !self.is_young() {
            let turn = way.start().rotation.inverse() * matched.local_from_tracking.rotation;
            self.gyroscope_bias.observe(&way.turn(), &turn, way.seconds());
        }
    }

    /// What a match says of directions that scans leave open, in the tracking frame.
    fn report_match(&mut self, end: Time, way: &Way, stood: bool, matched: &MatchedSweep) -> OpenDirections {
        let to_tracking = matched.local_from_tracking.rotation.inverse();
        let (up, seconds) = (to_tracking * Vector3::z(), way.seconds());
        // Where nothing tells how it moved, nothing tells in which direction either.
        let is_measured = way.going == Going::Measured;
        if is_measured || matched.found.as_ref().is_some_and(|f| f.weak.translations.is_empty()) {
            let shift = matched.local_from_tracking.translation.vector - way.start().translation.vector;
            self.weak_spans.moved(&(to_tracking * shift), seconds, &up);
        }
        let Some(found) = &matched.found else {
            self.count(
                "scan that fits no surface; its pose is what wheels, IMU, the velocity before or grids tell",
            );
            return OpenDirections::default();
        };
        let from_submap = found.pose.rotation.inverse();
        let open = |directions: &[Vector3]| directions.iter().map(|d| from_submap * d).collect::<Vec<_>>();
        let going = match way.going {
            _ if stood => TakenInstead::Rest,
            Going::Measured => TakenInstead::Odometry,
            Going::Felt(_) => TakenInstead::Accelerometer,
            Going::AsBefore => TakenInstead::Velocity,
        };
        // Where a gyroscope was not believed, the way turns as it did before and not as wheels did.
        let has_gyroscope = self.has_imu && self.extrapolator.as_ref().is_some_and(|e| e.has_gyroscope(end));
        let turning = match (way.turn_is_measured, going) {
            (true, _) => TakenInstead::Gyroscope,
            (false, TakenInstead::Odometry) if has_gyroscope => TakenInstead::Velocity,
            (false, TakenInstead::Accelerometer) => TakenInstead::Velocity,
            (false, going) => going,
        };
        let scan = |taken| WeakScan { time: end, seconds, taken };
        let (shifts, turns) = (scan(going), scan(turning));
        let (translations, rotations) = (open(&found.weak.translations), open(&found.weak.rotations));
        self.weak_spans.add_shifts(&shifts, &translations, &up);
        self.weak_spans.add_turns(&turns, &rotations, &up);
        let turn_is_measured = way.turn_is_measured;
        OpenDirections { translations, rotations, way_is_measured: is_measured, turn_is_measured }
    }

    /// Puts a scan where it fits the grids of the older submap best.
    fn match_to_grids(&mut self, scan: &mut MatchedScan) {
        if let Some(submap) = self.active_submaps.matching_submap_mut() {
            submap.draw_grids();
        }
        let thinned = voxel_filter(&scan.scan.returns, self.options.voxel_filter_size);
        let [high, low] = self.clouds(&thinned);
        if !high.is_empty() && !low.is_empty() {
            let submap = self.active_submaps.matching_submap();
            let (matched, _) = self.matcher.match_scan(&scan.local_from_tracking, [&high, &low], submap);
            if is_valid_pose(&matched) {
                scan.local_from_tracking = matched;
            }
        }
        scan.clouds = Some([high, low]);
    }

    fn seen_from_end(&self, sweep: &TimedSweep, matched: MatchedSweep) -> MatchedScan {
        MatchedScan {
            local_from_tracking: matched.local_from_tracking,
            scan: in_tracking(&sweep.points, &matched.pieces, self.options.use_intensities),
            clouds: None,
            open: OpenDirections::default(),
        }
    }

    pub(super) fn new_extrapolator(&self) -> PoseExtrapolator {
        let options = &self.options.pose_extrapolator.constant_velocity;
        let extrapolator = PoseExtrapolator::new(
            options.pose_queue_duration,
            options.imu_gravity_time_constant,
            self.extras.use_all_odometry,
        );
        match self.options.pose_extrapolator.use_imu_based {
            true => {
                extrapolator.with_imu_based(&imu_based_settings(&self.options.pose_extrapolator.imu_based))
            }
            false => extrapolator,
        }
    }
}

/// The settings of the fit that these options describe.
fn imu_based_settings(options: &ImuBasedPoseExtrapolatorOptions) -> ImuBasedSettings {
    let solver = &options.solver_options;
    ImuBasedSettings {
        pose_queue_duration: options.pose_queue_duration,
        gravity_constant: options.gravity_constant,
        pose_translation_weight: options.pose_translation_weight,
        pose_rotation_weight: options.pose_rotation_weight,
        imu_acceleration_weight: options.imu_acceleration_weight,
        imu_rotation_weight: options.imu_rotation_weight,
        odometry_translation_weight: options.odometry_translation_weight,
        odometry_rotation_weight: options.odometry_rotation_weight,
        max_num_iterations: u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX),
        use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
    }
}
