//! Local SLAM by matching sweeps to surfaces.

use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3, is_valid_pose};
use portolan_matching::Way;
use portolan_sensor::voxel_filter;

use super::conclusion::Wanted;
use super::first_sweeps::{FirstSweeps, TimedSweep};
use super::surface_tracking::{MatchedSweep, SurfaceTracker, in_tracking};
use super::unwarp::Gathered;
use super::{LocalSlam3d, MatchedScan, sweep_path};
use crate::pose_extrapolator::PoseExtrapolator;
use crate::weak_span::WeakScan;
use crate::{MatchingResult, OpenDirections, Spatial, TakenInstead};

/// Submaps of fewer scans are young.
const YOUNG: u32 = 10;
/// A match without the gyroscope has to fit so much better than one with it, unless that is saturated.
const CLEARLY_BETTER: f64 = 1.3;
/// After so many seconds without a sweep it may have gone on as before, or stopped; or a clock jumped.
const LONG_GAP: f64 = 0.5;

/// What matching to surfaces needs besides the submaps.
pub(super) struct BySurfaces {
    pub tracker: SurfaceTracker,
    voxel_size: f64,
    /// The first sweep, until the second one tells how fast it was.
    first: Option<TimedSweep>,
}

impl BySurfaces {
    pub fn new(voxel_size: f64) -> Self {
        Self { tracker: SurfaceTracker::new(voxel_size), voxel_size, first: None }
    }
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

    /// Matches a sweep to the older active submap.
    fn follow(&mut self, sweep: &TimedSweep) -> Option<MatchingResult<Spatial>> {
        let has_imu = self.has_imu;
        let extrapolator = self.extrapolator.as_mut()?;
        extrapolator.prepare(sweep.end);
        let start = extrapolator.last_pose_time();
        let predicted = sweep_path::predicted(extrapolator, sweep.end);
        if extrapolator.has_odometry(sweep.end) {
            self.standstill.add_odometry(&predicted.shift(), predicted.seconds());
        }
        let stood = self.standstill.pose();
        let mut way = match &stood {
            Some(pose) => sweep_path::standing(extrapolator, sweep.end, pose),
            None => predicted.clone(),
        };
        way.turn_is_measured = has_imu && extrapolator.has_gyroscope(sweep.end);
        way.shift_is_measured = stood.is_some() || extrapolator.has_odometry(sweep.end);
        let unmeasured = way.turn_is_measured.then(|| sweep_path::turning_on(extrapolator, sweep.end));
        let gravity = has_imu.then(|| extrapolator.estimate_gravity_orientation(sweep.end));
        let by_surfaces = self.by_surfaces.as_mut()?;
        let selection = by_surfaces.tracker.selection(&sweep.points);
        let submap = self.active_submaps.matching_submap()?;
        let target = (&submap.local_from_submap, submap.surfaces.as_ref()?);
        let mut matched = by_surfaces.tracker.match_sweep(&selection, &way, target);
        if way.seconds() > LONG_GAP
            && let Some((_, last)) = extrapolator.last_pose()
        {
            let stayed = sweep_path::standing(extrapolator, sweep.end, &last);
            let matched_there = by_surfaces.tracker.match_sweep(&selection, &stayed, target);
            if matched_there.fit() > matched.fit() {
                (matched, way) = (matched_there, stayed);
            }
        }
        let saturated = self.saturated_at > start;
        if let Some(other) = unmeasured.filter(|_| saturated || matched.contradicts_turn(&way)) {
            let by_scans = by_surfaces.tracker.match_sweep(&selection, &other, target);
            let wanted = if saturated { 1.0 } else { CLEARLY_BETTER };
            if by_scans.fit() > wanted * matched.fit() {
                (matched, way) = (by_scans, other);
                self.count("sweep whose turn the gyroscope did not tell; scans told it");
            }
        }
        match stood {
            Some(_) => self.gyroscope_bias.observe(&predicted.turn(), &Quaternion::identity(), way.seconds()),
            None if saturated => {}
            None => self.learn_bias(&way, &matched),
        }
        let open = self.report_match(sweep.end, &way, stood.is_some(), &matched);
        let fits_surfaces = matched.found.is_some();
        let mut scan = MatchedScan { open, ..self.seen_from_end(sweep, matched) };
        // Where grids of a bare place hold a scanner that wheels saw moving, they were made by its beams.
        if !fits_surfaces && !way.shift_is_measured {
            self.match_to_grids(&mut scan);
        }
        self.standstill.add_match(sweep.end, &scan.local_from_tracking);
        let stands = self.standstill.pose();
        if let Some(pose) = stands {
            scan.local_from_tracking = pose;
        }
        self.extrapolator.as_mut()?.add_pose(sweep.end, scan.local_from_tracking);
        let gravity = gravity.map(|level| self.leveled(sweep.end, &scan.local_from_tracking, level));
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
        if way.shift_is_measured || matched.found.as_ref().is_some_and(|f| f.weak.translations.is_empty()) {
            let shift = matched.local_from_tracking.translation.vector - way.start().translation.vector;
            self.weak_spans.moved(&(to_tracking * shift), seconds, &up);
        }
        let Some(found) = &matched.found else {
            self.count("scan that fits no surface; grids or odometry and gyroscope told its pose");
            return OpenDirections::default();
        };
        let from_submap = found.pose.rotation.inverse();
        let open = |directions: &[Vector3]| directions.iter().map(|d| from_submap * d).collect::<Vec<_>>();
        let told = |is_told: bool, by: TakenInstead| match is_told {
            true => by,
            false if stood => TakenInstead::Rest,
            false => TakenInstead::Velocity,
        };
        let scan = |taken| WeakScan { time: end, seconds, taken };
        let shifts = scan(told(way.shift_is_measured && !stood, TakenInstead::Odometry));
        // Where a gyroscope was not believed, the way turns as it did before and not as wheels did.
        let has_gyroscope = self.has_imu && self.extrapolator.as_ref().is_some_and(|e| e.has_gyroscope(end));
        let turns = scan(match way.turn_is_measured {
            true => TakenInstead::Gyroscope,
            false => told(way.shift_is_measured && !stood && !has_gyroscope, TakenInstead::Odometry),
        });
        let (translations, rotations) = (open(&found.weak.translations), open(&found.weak.rotations));
        self.weak_spans.add_shifts(&shifts, &translations, &up);
        self.weak_spans.add_turns(&turns, &rotations, &up);
        let (way_is_measured, turn_is_measured) = (way.shift_is_measured, way.turn_is_measured);
        OpenDirections { translations, rotations, way_is_measured, turn_is_measured }
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
            true => extrapolator.with_imu_based(&self.options.pose_extrapolator.imu_based),
            false => extrapolator,
        }
    }
}
