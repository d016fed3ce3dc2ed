//! A saved 3D map: its planes, its solid and free cells, and its upright structures seen from above.

use std::sync::Arc;

use portolan_geometry::{Point3f, Rigid3, Vector3, is_valid_pose, rotation_from_roll_pitch_yaw, to_f32, yaw};
use portolan_grids::{BeamEnd, ScanAgreement};
use portolan_lidar_odometry::{PlaneMap, PosePrior, Registration, RegistrationSettings, Sigmas};
use portolan_mapping::{GraphState, NodeData, PoseGraph, SeenFromAbove, Space3d, TrajectoryId};
use portolan_sensor::PointCloud;
use rayon::prelude::*;

use crate::along::SolidField;
use crate::belief::{Freedom, MapError, Matrix6};
use crate::changes::ChangeCounter;
use crate::finder::LocalScan;
use crate::information::{Contact, information};
use crate::known_map::{Area, KnownMap, KnownMapError, ScanMatch, Window};
use crate::known_planes::{add_cells, planes_of_every_other_node, with_nodes};
use crate::localizer::LocalizerWork;
use crate::occupancy::{Occupancy, OccupancyBuilder};
use crate::own_scans::{error_of_own_scans, explained_by_chance};
use crate::recent::RecentScans;
use crate::renewal::Renewal;
use crate::renewal_3d::renew;
use crate::residuals::Residuals;
use crate::scan_3d::{JointScan3d, Scan3d};
use crate::settings::changes::CERTAIN_PLACE_3D;
use crate::settings::maps::{PLANE_VOXEL, USUAL_MAP_ERROR};
use crate::settings::matching::{
    MOST_REGISTRATION_STEPS, MOST_SLIDES, NARROWEST_REGISTRATION, NARROWEST_SLIDE, NARROWEST_WINDOW,
    ON_PLANE, REGISTRATION_REACH, SETTLED, SLIDING_COSINE,
};
use crate::settings::search::{AROUND_PROPOSAL_3D, LONGEST_PAUSE_3D, MOST_PROPOSALS_3D};
use crate::submap_cells::submap_cells;
use crate::voxel_changes::{KeptSweep, KnownVoxels, VoxelChanges};

/// A saved 3D map.
pub struct KnownMap3d {
    planes: Arc<PlaneMap>,
    pub(crate) occupancy: Arc<Occupancy>,
    /// Finds positions along streets.
    solid: SolidField,
    /// Cells that scans may contradict.
    pub(crate) voxels: Arc<KnownVoxels>,
    /// Proposes places.
    above: SeenFromAbove,
    registration: Registration,
    /// Fraction of a scan that the map explains at a wrong pose: floors fit anywhere.
    by_chance: f32,
    error: MapError,
}

impl KnownMap3d {
    /// The map that a pose graph holds.
    ///
    /// # Errors
    /// If it has no submaps, no grids or no solid cells, is too far from the origin, or grids cannot be made.
    pub fn new(state: &GraphState<Space3d>) -> Result<Self, KnownMapError> {
        if state.submaps.is_empty() {
            return Err(KnownMapError::Empty);
        }
        KnownMapError::require_near_origin(state)?;
        if state.submaps.values().all(|entry| entry.submap.is_none()) {
            return Err(KnownMapError::NoGrids(state.submaps.len()));
        }
        let (mut occupancy, mut solid, mut planes) =
            (OccupancyBuilder::new()?, SolidField::new()?, PlaneMap::new(PLANE_VOXEL));
        for submap in submap_cells(state) {
            occupancy.add(&submap);
            solid.add(&submap);
            add_cells(&mut planes, &submap, state);
        }
        let occupancy = occupancy.finish(state);
        let solid_cells = occupancy.solid();
        if solid_cells.is_empty() {
            return Err(KnownMapError::NoWalls);
        }
        let nodes: Vec<Vector3> =
            state.nodes.values().map(|node| node.map_from_tracking.translation.vector).collect();
        let above = SeenFromAbove::new(solid_cells.into_iter(), nodes)?;
        let settings = RegistrationSettings { min_matched_fraction: 0.0, ..Default::default() };
        let registration = Registration::new(settings);
        let (planes, occupancy) = (Arc::new(with_nodes(planes, state.nodes.values())), Arc::new(occupancy));
        let voxels = Arc::new(KnownVoxels::new(&occupancy, &planes, state)?);
        let mut map = Self {
            planes,
            occupancy,
            solid,
            voxels,
            above,
            registration,
            by_chance: 0.0,
            error: USUAL_MAP_ERROR,
        };
        map.by_chance = explained_by_chance(&map, state);
        // Matches scans to planes to which these scans contributed no point.
        let all =
            std::mem::replace(&mut map.planes, Arc::new(planes_of_every_other_node(state, PLANE_VOXEL)));
        map.error = error_of_own_scans(&map, state);
        map.planes = all;
        Ok(map)
    }

    /// Registers points to planes near a guess; returns the guess where no planes fit.
    pub(crate) fn register(&self, points: &[Point3f], guess: &Rigid3, window: Window) -> Rigid3 {
        let scale = window.metres.clamp(NARROWEST_REGISTRATION.metres, REGISTRATION_REACH.metres);
        let sigmas =
            Sigmas { translation: scale, rotation: window.radians.max(NARROWEST_REGISTRATION.radians) };
        let prior = PosePrior { pose: *guess, sigmas };
        let found = self.registration.register_scan(&self.planes, points, guess, &prior, scale);
        found.map(|f| f.pose).filter(is_valid_pose).unwrap_or(*guess)
    }

    /// Moves a pose along its most degenerate direction to where the points are most likely. Returns the
    /// pose and its information from planes and from this search. The judging points choose the direction;
    /// the registered points give the information of the planes.
    fn slide(
        &self,
        (points, judged, registered): (&[Point3f], &[Point3f], &[Point3f]),
        pose: &Rigid3,
        window: Window,
    ) -> (Rigid3, Matrix6) {
        let by_planes = information(self.contacts(judged, pose), Self::FREEDOM);
        let shifts = by_planes.fixed_view::<3, 3>(0, 0).into_owned().symmetric_eigen();
        let direction: Vector3 = shifts.eigenvectors.column(shifts.eigenvalues.argmin().0).into_owned();
        let (map_from_scan, along) = (to_f32(pose), direction.cast::<f32>());
        let constrains = |point: &Point3f| {
            self.planes.plane_near(point).is_none_or(|plane| {
                let is_near = plane.normal.dot(&(point.coords - plane.point)).abs() < ON_PLANE;
                !is_near || f64::from(plane.normal.dot(&along).abs()) > SLIDING_COSINE
            })
        };
        let placed: Vec<Point3f> = points.iter().map(|p| map_from_scan * p).filter(constrains).collect();
        let found = self.solid.along(
            &placed,
            &direction,
            window.metres.clamp(NARROWEST_SLIDE, REGISTRATION_REACH.metres),
        );
        // Planes that face along the direction constrain the position, too.
        let held = direction.dot(&(by_planes.fixed_view::<3, 3>(0, 0) * direction)).max(0.0);
        let share = found.information / (found.information + held).max(f64::MIN_POSITIVE);
        let mut slid = *pose;
        slid.translation.vector += share * found.shift * direction;
        let mut both = Residuals::new(&self.planes, registered, pose).information();
        let mut block = both.fixed_view_mut::<3, 3>(0, 0);
        block += found.information * direction * direction.transpose();
        (slid, both)
    }

    /// Registers in windows of any size: from several starts, of which the result that fits best is
    /// returned.
    fn search(&self, points: &[Point3f], guess: &Rigid3, window: Window) -> Rigid3 {
        let steps = |window: f64, reach: f64| {
            ((window - reach) / reach).ceil().clamp(0.0, MOST_REGISTRATION_STEPS) as i32
        };
        let rings = steps(window.metres, REGISTRATION_REACH.metres);
        let turns = steps(window.radians, REGISTRATION_REACH.radians);
        if rings == 0 && turns == 0 {
            return self.register(points, guess, window);
        }
        let step = REGISTRATION_REACH.metres.min(window.metres);
        let shifts = (-rings..=rings).flat_map(|x| (-rings..=rings).map(move |y| (x, y)));
        let starts = shifts.flat_map(|(x, y)| (-turns..=turns).map(move |turn| (x, y, turn)));
        let from = |(x, y, turn): (i32, i32, i32)| {
            let mut start = *guess;
            start.translation.vector += step * Vector3::new(f64::from(x), f64::from(y), 0.0);
            start.rotation =
                rotation_from_roll_pitch_yaw(0.0, 0.0, REGISTRATION_REACH.radians * f64::from(turn))
                    * start.rotation;
            let found = self.register(points, &start, AROUND_PROPOSAL_3D);
            (self.agreement_of(points, &found).explained, found)
        };
        let found: Vec<_> = starts.collect::<Vec<_>>().into_par_iter().map(from).collect();
        let best = found.into_iter().reduce(|best, other| if other.0 > best.0 { other } else { best });
        best.map_or(*guess, |best| best.1)
    }

    /// Agreement of points with the map at a pose. `explained` is the fraction beyond that expected by
    /// chance (as in Cohen, "A coefficient of agreement for nominal scales", 1960): 1 where all points are
    /// explained, 0 where no more are than at a random pose.
    pub(crate) fn agreement_of(&self, points: &[Point3f], pose: &Rigid3) -> ScanAgreement {
        let mut agreement: ScanAgreement = self.ends_of(points, pose).map(|(_, end)| end).collect();
        let beyond_chance = (agreement.explained - self.by_chance) / (1.0 - self.by_chance);
        agreement.explained = beyond_chance.max(0.0);
        agreement
    }

    fn ends_of<'a>(
        &'a self,
        points: &'a [Point3f],
        pose: &Rigid3,
    ) -> impl Iterator<Item = (&'a Point3f, BeamEnd)> + use<'a> {
        let pose = to_f32(pose);
        points.iter().map(move |point| {
            let placed = pose * point;
            let end = if self.occupancy.is_solid_near(&placed) || self.is_on_plane(&placed) {
                BeamEnd::AtSolid
            } else if self.occupancy.is_free(&placed) {
                BeamEnd::InFree
            } else {
                BeamEnd::Unknown
            };
            (point, end)
        })
    }

    fn is_on_plane(&self, point: &Point3f) -> bool {
        self.planes
            .plane_near(point)
            .is_some_and(|plane| plane.normal.dot(&(point.coords - plane.point)).abs() < ON_PLANE)
    }

    /// The points that are on planes, with the normals of these.
    fn contacts<'a>(
        &'a self,
        points: &'a [Point3f],
        pose: &Rigid3,
    ) -> impl Iterator<Item = Contact> + use<'a> {
        let (map_from_scan, origin) = (to_f32(pose), pose.translation.vector);
        points.iter().filter_map(move |point| {
            let point = map_from_scan * point;
            let plane = self.planes.plane_near(&point)?;
            let is_near = plane.normal.dot(&(point.coords - plane.point)).abs() < ON_PLANE;
            let lever = point.coords.cast::<f64>() - origin;
            is_near.then_some(Contact { lever, normal: plane.normal.cast() })
        })
    }
}

static LOCALIZER_WORK: LocalizerWork<KnownMap3d> = LocalizerWork::compiled();

impl KnownMap for KnownMap3d {
    type Space = Space3d;
    type Scan = Scan3d;
    type Joint = JointScan3d;
    const FREEDOM: Freedom = Freedom::ThreeD;
    const CERTAIN_PLACE: f64 = CERTAIN_PLACE_3D;
    const LONGEST_PAUSE: f64 = LONGEST_PAUSE_3D;

    fn localizer_work() -> &'static LocalizerWork<Self> {
        &LOCALIZER_WORK
    }

    fn error(&self) -> MapError {
        self.error
    }

    fn local_from_scan(local_from_tracking: &Rigid3) -> Rigid3 {
        let heading = rotation_from_roll_pitch_yaw(0.0, 0.0, yaw(&local_from_tracking.rotation));
        Rigid3::from_parts(local_from_tracking.translation, heading)
    }

    fn points_in_tracking(node: &NodeData) -> PointCloud {
        let clouds = [&node.high_resolution_point_cloud, &node.low_resolution_point_cloud];
        PointCloud::new(clouds.into_iter().flat_map(|cloud| &cloud.points).copied().collect())
    }

    fn scan(&self, returns: &PointCloud) -> Scan3d {
        Scan3d::new(returns)
    }

    fn joint(&self, recent: &RecentScans<Scan3d>) -> JointScan3d {
        JointScan3d::of(recent)
    }

    fn propose(
        &self,
        joint: &JointScan3d,
        area: Option<Area>,
        is_known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Rigid3> {
        let area = area.as_ref().map(|area| (&area.centre, area.metres));
        let found = self.above.find(&joint.columns, area);
        let settled = found.poses.par_iter().filter(|pose| !is_known(pose)).map(|pose| {
            let pose = self.refine_pose(joint, pose, AROUND_PROPOSAL_3D);
            let agreement = self.agreement_of(&joint.points, &pose);
            (agreement.explained - agreement.contradicted(), pose)
        });
        let mut settled: Vec<(f32, Rigid3)> = settled.collect();
        settled.sort_by(|a, b| b.0.total_cmp(&a.0));
        settled.into_iter().take(MOST_PROPOSALS_3D).map(|(_, pose)| pose).collect()
    }

    fn refine_pose(&self, joint: &JointScan3d, guess: &Rigid3, window: Window) -> Rigid3 {
        let mut pose = self.search(&joint.points, guess, window);
        for _ in 0..MOST_SLIDES {
            let (slid, _) = self.slide((&joint.thinned, &joint.points, &joint.points), &pose, window);
            let moved = (slid.translation.vector - pose.translation.vector).norm();
            pose = slid;
            if moved < SETTLED {
                break;
            }
            pose = self.register(&joint.points, &pose, NARROWEST_WINDOW);
        }
        pose
    }

    fn find(&self, scan: &Scan3d, guess: &Rigid3, window: Window) -> ScanMatch {
        let pose = self.register(&scan.points, guess, window);
        let (pose, information) = self.slide((&scan.thinned, &scan.judged, &scan.points), &pose, window);
        ScanMatch { pose, information, agreement: self.agreement(scan, &pose) }
    }

    fn beam_ends<'a>(
        &'a self,
        scan: &'a Scan3d,
        pose: &Rigid3,
    ) -> impl Iterator<Item = (&'a Point3f, BeamEnd)> {
        self.ends_of(&scan.judged, pose)
    }

    fn agreement(&self, scan: &Scan3d, pose: &Rigid3) -> ScanAgreement {
        self.agreement_of(&scan.judged, pose)
    }

    fn kept_sweep(scan: &LocalScan, place: &Rigid3) -> Option<KeptSweep> {
        Some(KeptSweep::new(scan, place))
    }

    fn renew(&self, graph: &mut PoseGraph<Space3d>, new: TrajectoryId, sweeps: &[&KeptSweep]) -> Renewal {
        renew(graph, new, self, sweeps)
    }

    fn change_counter(&self) -> Box<dyn ChangeCounter> {
        Box::new(VoxelChanges::new(Arc::clone(&self.voxels)))
    }
}
