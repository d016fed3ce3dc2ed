//! Matches a scan to a 2D map and computes the information of the match.

use portolan_geometry::{Point3f, Rigid2, Rigid3, Vector2, Vector3, embed_3d, project_2d, to_f32};
use portolan_grids::{BeamEnd, ScanAgreement, beam_ends};
use portolan_mapping::{NodeData, Space2d};
use portolan_mapping::{PoseGraph, TrajectoryId};
use portolan_matching::{GradientMatcher2d, GradientMatcherOptions2d, MatcherOptionError};
use portolan_sensor::PointCloud;

use crate::belief::Freedom;
use crate::changes::{ChangeCounter, ChangeGrid};
use crate::information::{Contact, information};
use crate::known_map::{Area, KnownMap, ScanMatch, Window};
use crate::known_map_2d::KnownMap2d;
use crate::localizer::LocalizerWork;
use crate::recent::RecentScans;
use crate::renewal::{Renewal, renew};
use crate::scan_2d::{JointScan2d, Scan2d};
use crate::settings::changes::CERTAIN_PLACE_2D;
use crate::settings::matching::{FARTHEST_DESCENT, NEAR_WALL_LIKELIHOOD};
use crate::settings::search::{AROUND_PROPOSAL_2D, LONGEST_PAUSE_2D, PROPOSALS_2D};
use crate::voxel_changes::KeptSweep;

/// Matches scans to a map.
pub(crate) struct Matcher2d {
    gradient: GradientMatcher2d,
}

impl Matcher2d {
    pub fn new() -> Result<Self, MatcherOptionError> {
        let options = GradientMatcherOptions2d {
            occupied_space_weight: 1.0,
            translation_weight: 0.5,
            rotation_weight: 0.5,
            ..GradientMatcherOptions2d::default()
        };
        Ok(Self { gradient: GradientMatcher2d::new(&options)? })
    }

    /// Matches a cloud in a window around a guess.
    pub fn place(
        &self,
        map: &KnownMap2d,
        cloud: &PointCloud,
        points: &[Vector2],
        guess: &Rigid2,
        window: Window,
    ) -> Rigid2 {
        let searched = map.field.search(points, guess, window);
        let descended = self.gradient.match_scan(searched.translation, &searched, cloud, &map.grid).pose;
        let is_near = descended.is_finite()
            && (descended.translation - searched.translation).norm() < FARTHEST_DESCENT.metres
            && (descended.angle - searched.angle).abs() < FARTHEST_DESCENT.radians;
        if is_near { descended } else { searched }
    }
}

static LOCALIZER_WORK: LocalizerWork<KnownMap2d> = LocalizerWork::compiled();

impl KnownMap for KnownMap2d {
    type Space = Space2d;
    type Scan = Scan2d;
    type Joint = JointScan2d;
    const FREEDOM: Freedom = Freedom::TwoD;
    const CERTAIN_PLACE: f64 = CERTAIN_PLACE_2D;
    const LONGEST_PAUSE: f64 = LONGEST_PAUSE_2D;

    fn localizer_work() -> &'static LocalizerWork<Self> {
        &LOCALIZER_WORK
    }

    fn local_from_scan(local_from_tracking: &Rigid3) -> Rigid3 {
        embed_3d(&project_2d(local_from_tracking))
    }

    fn points_in_tracking(node: &NodeData) -> PointCloud {
        let tracking_from_aligned = Rigid3::from_parts(Default::default(), node.gravity_alignment.inverse());
        node.filtered_gravity_aligned_point_cloud.transformed(&to_f32(&tracking_from_aligned))
    }

    fn scan(&self, returns: &PointCloud) -> Scan2d {
        Scan2d::new(returns)
    }

    fn joint(&self, recent: &RecentScans<Scan2d>) -> JointScan2d {
        JointScan2d::of(recent)
    }

    fn propose(
        &self,
        joint: &JointScan2d,
        area: Option<Area>,
        is_known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Rigid3> {
        let found = match area {
            Some(Area { centre, metres }) => {
                self.places.find_within(&joint.cloud, &PROPOSALS_2D, &centre, metres)
            }
            None => self.places.find(&joint.cloud, &PROPOSALS_2D),
        };
        let poses = found.places.iter().map(|place| embed_3d(&place.pose)).filter(|pose| !is_known(pose));
        poses.map(|pose| self.refine_pose(joint, &pose, AROUND_PROPOSAL_2D)).collect()
    }

    fn refine_pose(&self, joint: &JointScan2d, guess: &Rigid3, window: Window) -> Rigid3 {
        let JointScan2d { cloud, points } = joint;
        embed_3d(&self.matcher.place(self, cloud, points, &project_2d(guess), window))
    }

    fn find(&self, scan: &Scan2d, guess: &Rigid3, window: Window) -> ScanMatch {
        let pose = self.matcher.place(self, &scan.cloud, &scan.points, &project_2d(guess), window);
        let information = information(contacts(self, scan, &pose), Self::FREEDOM);
        let pose = embed_3d(&pose);
        ScanMatch { pose, information, agreement: self.agreement(scan, &pose) }
    }

    fn beam_ends<'a>(
        &'a self,
        scan: &'a Scan2d,
        pose: &Rigid3,
    ) -> impl Iterator<Item = (&'a Point3f, BeamEnd)> {
        beam_ends(&self.grid, &project_2d(pose), &scan.cloud)
    }

    fn agreement(&self, scan: &Scan2d, pose: &Rigid3) -> ScanAgreement {
        self.beam_ends(scan, pose).map(|(_, end)| end).collect()
    }

    fn renew(&self, graph: &mut PoseGraph<Space2d>, new: TrajectoryId, _sweeps: &[&KeptSweep]) -> Renewal {
        renew(graph, new, self)
    }

    fn change_counter(&self) -> Box<dyn ChangeCounter> {
        Box::new(ChangeGrid::new(self.cells.clone()))
    }
}

/// The points of a scan at walls of the map, with the normals of the surfaces in the scan.
fn contacts<'a>(
    map: &'a KnownMap2d,
    scan: &'a Scan2d,
    pose: &Rigid2,
) -> impl Iterator<Item = Contact> + use<'a> {
    let (rotation, translation) = (pose.rotation_matrix(), pose.translation);
    let contact = move |(point, tangent): (&Vector2, &Option<Vector2>)| {
        let along = rotation * (*tangent)?;
        let lever = rotation * point;
        let is_near = map.field.at(&(lever + translation)) >= NEAR_WALL_LIKELIHOOD;
        let (lever, normal) = (Vector3::new(lever.x, lever.y, 0.0), Vector3::new(-along.y, along.x, 0.0));
        is_near.then_some(Contact { lever, normal })
    };
    scan.points.iter().zip(&scan.tangents).filter_map(contact)
}
