//! Point-to-plane registration to a sweep.

use std::cell::OnceCell;

use portolan_geometry::nalgebra::{Matrix6, Point3, Vector6};
use portolan_geometry::{Rigid3, Vector3, quaternion_from_angle_axis};
use portolan_spatial::{KdTree, LocalSurface, Neighbour, local_surface};

/// Number of neighbours that define a local surface.
const NEIGHBOURS: usize = 10;
/// Radius of the neighbourhood of a surface, metres.
const NEIGHBOURHOOD: f32 = 1.5;
/// Maximum thickness of a surface, metres.
const MAX_THICKNESS: f32 = 0.05;
/// Minimum planarity of a surface.
const MIN_PLANARITY: f32 = 0.05;
/// Final distance within which nearest points are paired, metres. The distance shrinks to it from iteration
/// to iteration.
pub(super) const LAST_GATE: f64 = 0.3;
/// Factor by which that distance shrinks in each iteration.
const GATE_SHRINKS: f64 = 0.7;
/// Maximum number of iterations.
const ITERATIONS: usize = 9;
/// Norm of the pose change (metres and radians) below which the registration has converged.
const CONVERGED: f64 = 1e-3;
/// Stride of the points that are used while points are paired at larger distances.
pub(super) const FEWER: usize = 3;
/// The least scale of the robust loss, metres.
pub(super) const LEAST_SCALE: f64 = 0.03;
/// Minimum number of matched points.
const MIN_MATCHED: usize = 30;

/// A sweep that others are registered to.
pub(super) struct Target {
    points: Vec<[f32; 3]>,
    /// Tree of its points. The last sweeps of a batch need none, because no sweep is registered to them.
    tree: OnceCell<KdTree>,
    /// Surfaces at its points; they are computed on demand.
    pub surfaces: Vec<Surface>,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Surface {
    NotComputed,
    None,
    Some(LocalSurface),
}

/// A point of one sweep on a surface of another.
pub(super) struct Match {
    /// Indices of the points in their samples.
    pub source: usize,
    pub target: u32,
    /// Position of the source point in the frame of the target.
    pub place: Vector3,
    pub normal: Vector3,
    pub residual: f64,
}

impl Target {
    pub fn new(points: Vec<[f32; 3]>, surfaces: Option<&Vec<Surface>>) -> Self {
        let surfaces = surfaces.cloned().unwrap_or_else(|| vec![Surface::NotComputed; points.len()]);
        Self { points, tree: OnceCell::new(), surfaces }
    }

    fn tree(&self) -> &KdTree {
        self.tree.get_or_init(|| KdTree::new(&self.points))
    }

    /// A point and the surface there.
    fn surface(&mut self, index: u32) -> Option<(Vector3, LocalSurface)> {
        let point = *self.points.get(index as usize)?;
        let known = self.surfaces.get_mut(index as usize)?;
        if let Surface::NotComputed = known {
            let tree = self.tree.get_or_init(|| KdTree::new(&self.points));
            let found = local_surface(&self.points, tree, point, NEIGHBOURS, NEIGHBOURHOOD);
            let found = found.filter(|s| s.thickness < MAX_THICKNESS && s.planarity > MIN_PLANARITY);
            *known = found.map_or(Surface::None, Surface::Some);
        }
        match known {
            Surface::Some(surface) => Some((Vector3::from(point.map(f64::from)), *surface)),
            Surface::None | Surface::NotComputed => None,
        }
    }

    /// Points of a sweep on surfaces of this one, in the order of the sweep. The search starts from the
    /// matches `before`, which are in the same order.
    pub fn matches(
        &mut self,
        source: &[(usize, Vector3)],
        pose: &Rigid3,
        gate: f64,
        before: &[Match],
    ) -> Vec<Match> {
        let mut matches = Vec::with_capacity(source.len());
        let mut before = before.iter().peekable();
        for (index, point) in source {
            let place = (pose * Point3::from(*point)).coords;
            while before.next_if(|m| m.source < *index).is_some() {}
            let last = before.peek().filter(|m| m.source == *index).map(|m| m.target);
            let Some(nearest) = self.nearest(place.cast::<f32>().into(), gate as f32, last) else {
                continue;
            };
            let Some((on_surface, surface)) = self.surface(nearest.index) else { continue };
            let normal = Vector3::from(surface.normal.map(f64::from));
            let residual = normal.dot(&(place - on_surface));
            matches.push(Match { source: *index, target: nearest.index, place, normal, residual });
        }
        matches
    }

    /// Nearest point. The search is faster if the previous nearest point `last` is still near.
    fn nearest(&self, place: [f32; 3], gate: f32, last: Option<u32>) -> Option<Neighbour> {
        let position = last.and_then(|last| Some((last, *self.points.get(last as usize)?)));
        match position {
            Some((last, position)) => {
                self.tree().nearest_from(place, gate, Neighbour::of(place, last, position))
            }
            None => self.tree().nearest(place, gate),
        }
    }

    /// Pose of a sweep in the frame of this one; none if too few points match.
    pub fn register(&mut self, source: &[(usize, Vector3)], guess: Rigid3, gate: f64) -> Option<Rigid3> {
        let (mut pose, mut gate) = (guess, gate);
        let few: Vec<(usize, Vector3)> = source.iter().step_by(FEWER).copied().collect();
        let mut matches = Vec::new();
        for _ in 0..ITERATIONS {
            let is_near = gate <= LAST_GATE;
            matches = self.matches(if is_near { source } else { &few }, &pose, gate, &matches);
            if matches.len() < MIN_MATCHED {
                return None;
            }
            let scale = scale_of(&matches);
            let (mut information, mut gradient) = (Matrix6::identity() * 1e-6, Vector6::zeros());
            for m in &matches {
                let (row, weight) = (m.jacobian(), weight(m.residual, scale));
                information += row * row.transpose() * weight;
                gradient += row * (m.residual * weight);
            }
            let change = -information.cholesky()?.solve(&gradient);
            let turn = quaternion_from_angle_axis(&change.fixed_rows::<3>(3).into_owned());
            pose = Rigid3::from_parts(change.fixed_rows::<3>(0).into_owned().into(), turn) * pose;
            gate = (gate * GATE_SHRINKS).max(LAST_GATE);
            if is_near && change.norm() < CONVERGED {
                break;
            }
        }
        Some(pose)
    }
}

impl Target {
    /// Pose of a sweep in the frame of this one, and the weighted number of points that fit.
    pub fn registered(
        &mut self,
        source: &[(usize, Vector3)],
        guess: Rigid3,
        gate: f64,
    ) -> Option<(f64, Rigid3)> {
        let pose = self.register(source, guess, gate)?;
        let matches = self.matches(source, &pose, LAST_GATE, &[]);
        Some((matches.iter().map(|m| weight(m.residual, 2.0 * LEAST_SCALE)).sum(), pose))
    }
}

impl Match {
    /// Derivative of the residual by a small translation and rotation of the source in the frame of the
    /// target.
    pub fn jacobian(&self) -> Vector6<f64> {
        let turn = self.place.cross(&self.normal);
        Vector6::new(self.normal.x, self.normal.y, self.normal.z, turn.x, turn.y, turn.z)
    }
}

/// The scale of the robust loss: one and a half times the median of the residuals, metres.
pub(super) fn scale_of(matches: &[Match]) -> f64 {
    let mut sizes: Vec<f64> = matches.iter().map(|m| m.residual.abs()).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() {
        return LEAST_SCALE;
    }
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    (1.5 * *median).max(LEAST_SCALE)
}

/// Weight of a residual (Geman and McClure).
pub(super) fn weight(residual: f64, scale: f64) -> f64 {
    (1.0 + (residual / scale).powi(2)).powi(-2)
}
