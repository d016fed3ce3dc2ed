//! Georeference of a map: its pose on the Earth.

use portolan_geometry::{
    GeodeticPosition, Rigid3, TransformBuffer, Vector3, moved, rotation_from_roll_pitch_yaw,
};
use portolan_mapping::{EndedTrajectory, Map, PoseGraph, Space, TrajectoryId, of_trajectory};
use portolan_numeric::median;

/// Minimum number of fixes to align a map.
const FEWEST_FIXES: usize = 10;
/// Factor of the median residual above which a fix is an outlier (multipath); dimensionless.
const OUTLIER: f64 = 3.0;
/// Minimum ratio of the spread of positions to the residuals of fixes (both RMS), which determines the
/// heading to a few degrees; dimensionless.
const LEAST_SPREAD: f64 = 3.0;
/// Ratio of the median of a Rayleigh distribution to the standard deviation along each axis.
const MEDIAN_BY_SIGMA: f64 = 1.177_41;

/// Pose of a map on the Earth, from a trajectory with satellite fixes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Georeference {
    /// Origin of the fixed frame of the fixes.
    origin: GeodeticPosition,
    /// Pose of this frame in the map.
    map_from_fixed: Rigid3,
    /// Standard deviation of the residuals of fixes against the map made with them, along each horizontal
    /// axis, metres; none if the file has no fixes any more.
    sigma: Option<f64>,
}

/// A fix in the fixed frame, and the position of the tracking frame in the map at its time.
struct Pair {
    in_fixed: Vector3,
    in_map: Vector3,
}

impl Pair {
    /// Horizontal residual, metres.
    fn residual(&self, map_from_fixed: &Rigid3) -> f64 {
        ((map_from_fixed * nalgebra::Point3::from(self.in_fixed)).coords - self.in_map).xy().norm()
    }
}

/// The fixes of a trajectory at times between its nodes.
fn pairs<S: Space>(graph: &PoseGraph<S>, id: TrajectoryId) -> Vec<Pair> {
    let poses: TransformBuffer = of_trajectory(&graph.state().nodes, id)
        .map(|(_, node)| (node.data.time, node.map_from_tracking))
        .collect();
    let fixes = graph.problem().sensors.get(&id).into_iter().flat_map(|sensors| sensors.fixed_frame.values());
    let pair = |fix: &portolan_sensor::FixedFramePoseData| {
        let in_fixed = fix.fixed_from_tracking?.translation.vector;
        Some(Pair { in_fixed, in_map: poses.lookup(fix.time)?.translation.vector })
    };
    fixes.filter_map(pair).collect()
}

/// Pose of the fixed frame in the map that fits the fixes best, upright in both frames: least squares (Horn
/// 1987, about one axis), repeated without outliers. None if the fixes do not determine a heading: the path
/// is too short in comparison with their residuals.
fn aligned(pairs: &[Pair], at_first: &Rigid3) -> Option<Rigid3> {
    let all: Vec<&Pair> = pairs.iter().collect();
    let rough = fitted(&all, at_first)?;
    let mut off: Vec<f64> = all.iter().map(|pair| pair.residual(&rough)).collect();
    let most = OUTLIER * median(&mut off)?;
    let inliers: Vec<&Pair> = all.into_iter().filter(|pair| pair.residual(&rough) <= most).collect();
    let fitted = fitted(&inliers, at_first)?;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / inliers.len().max(1) as f64;
    let centre = inliers.iter().map(|pair| pair.in_map).sum::<Vector3>() / inliers.len().max(1) as f64;
    let spread = mean(&mut inliers.iter().map(|pair| (pair.in_map - centre).xy().norm_squared()));
    let error = mean(&mut inliers.iter().map(|pair| pair.residual(&fitted).powi(2)));
    (spread.sqrt() > LEAST_SPREAD * error.sqrt()).then_some(fitted)
}

fn fitted(pairs: &[&Pair], at_first: &Rigid3) -> Option<Rigid3> {
    if pairs.len() < FEWEST_FIXES {
        return None;
    }
    let count = pairs.len() as f64;
    let in_fixed = pairs.iter().map(|pair| pair.in_fixed).sum::<Vector3>() / count;
    let in_map = pairs.iter().map(|pair| pair.in_map).sum::<Vector3>() / count;
    let (mut sine, mut cosine) = (0.0, 0.0);
    for pair in pairs {
        let (a, b) = ((pair.in_fixed - in_fixed).xy(), (pair.in_map - in_map).xy());
        sine += a.perp(&b);
        cosine += a.dot(&b);
    }
    let rotation = rotation_from_roll_pitch_yaw(0.0, 0.0, sine.atan2(cosine));
    let mut shift = in_map - rotation * in_fixed;
    // Heights of fixes are too inaccurate here, and 2D has none.
    shift.z = at_first.translation.z;
    Some(Rigid3::from_parts(shift.into(), rotation))
}

impl Georeference {
    /// Georeference of a map; of several trajectories with fixes the first one is used. None if the map was
    /// made without fixes, or if the file has no position of the fixed frame on the Earth.
    pub fn of<S: Space>(map: &Map<S>) -> Option<Self> {
        let mut all = map.trajectories.iter();
        all.find_map(|(id, ended)| Self::of_trajectory(&map.graph, *id, ended))
    }

    fn of_trajectory<S: Space>(
        graph: &PoseGraph<S>,
        id: TrajectoryId,
        ended: &EndedTrajectory,
    ) -> Option<Self> {
        let origin = ended.fixed_frame_on_earth?;
        let map_from_fixed = graph.problem().fixed_frame_origins.get(&id).copied().flatten()?;
        let pairs = pairs(graph, id);
        // Optimisation may have left the fixed frame at a rotation that does not fit the fixes best.
        let map_from_fixed = aligned(&pairs, &map_from_fixed).unwrap_or(map_from_fixed);
        let mut off: Vec<f64> = pairs.iter().map(|pair| pair.residual(&map_from_fixed)).collect();
        let sigma = median(&mut off).map(|distance| distance / MEDIAN_BY_SIGMA);
        Some(Self { origin, map_from_fixed, sigma })
    }

    /// Georeference after the map was shifted along its axes, metres.
    pub fn moved_by(self, shift: &Vector3) -> Self {
        Self { map_from_fixed: moved(&self.map_from_fixed, shift), ..self }
    }

    /// Position in the map of a position on the Earth, metres.
    pub fn in_map(&self, place: &GeodeticPosition) -> Vector3 {
        let in_fixed = self.origin.local_from_ecef() * nalgebra::Point3::from(place.to_ecef());
        (self.map_from_fixed * in_fixed).coords
    }

    /// Standard deviation of the residuals of fixes against the map made with them, along each horizontal
    /// axis, metres; none if unknown.
    pub fn sigma(&self) -> Option<f64> {
        self.sigma
    }

    /// Sets the fixed frame for one more trajectory of the map, so that the map stays georeferenced when
    /// other trajectories are removed.
    pub fn apply_to<S: Space>(&self, map: &mut Map<S>, id: TrajectoryId) {
        if let Some(ended) = map.trajectories.get_mut(&id) {
            ended.fixed_frame_on_earth = Some(self.origin);
            map.graph.set_fixed_frame_origin(id, self.map_from_fixed);
        }
    }
}
