//! Observations of landmarks between two nodes (slam2d §14.6 item 2, slam3d §9.1).

use portolan_geometry::{Quaternion, Rigid2, Rigid3, embed_3d};

use super::interpolation::{Interpolated, interpolate};
use super::rotation::{read_se2, read_se3};
use super::se3_between::{PairJacobians, weighted_residual};
use crate::sparse::{Factor, VariableId};

/// A landmark observed at a time between two 2D nodes. The tracking frame at that time is interpolated
/// between the nodes with their gravity alignments. The residual is that of [`Se3Between`](super::Se3Between)
/// from this frame to the landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark2d {
    /// Previous node (2D), next node (2D), landmark (pose in 3D).
    pub variables: [VariableId; 3],
    /// Time of the observation: 0 at the previous, 1 at the next node.
    pub interpolation_factor: f64,
    /// Gravity alignment (gravity-aligned from tracking) of the previous and of the next node.
    pub gravity_alignments: [Quaternion; 2],
    /// Pose of the landmark in the tracking frame.
    pub tracking_from_landmark: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// A landmark observed at a time between two nodes in 3D; otherwise like [`Landmark2d`].
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark3d {
    /// Previous node, next node, landmark: poses in 3D.
    pub variables: [VariableId; 3],
    /// Time of the observation: 0 at the previous, 1 at the next node.
    pub interpolation_factor: f64,
    /// Pose of the landmark in the tracking frame.
    pub tracking_from_landmark: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// The tracking frame of a 2D node.
fn tracking_pose(node: &Rigid2, gravity_alignment: &Quaternion) -> Rigid3 {
    let pose = embed_3d(node);
    Rigid3::from_parts(pose.translation, pose.rotation * gravity_alignment)
}

impl Landmark2d {
    /// The tracking frame at the time of the observation, for nodes at the given poses. Multiplied by
    /// `tracking_from_landmark` it gives the initial pose of the landmark.
    pub fn interpolated_tracking_pose(&self, previous: &Rigid2, next: &Rigid2) -> Rigid3 {
        self.interpolate(previous, next).pose
    }

    fn interpolate(&self, previous: &Rigid2, next: &Rigid2) -> Interpolated {
        let [first, second] = &self.gravity_alignments;
        let (first, second) = (tracking_pose(previous, first), tracking_pose(next, second));
        interpolate(&first, &second, self.interpolation_factor)
    }
}

impl Landmark3d {
    /// The tracking frame at the time of the observation, for nodes at the given poses.
    pub fn interpolated_tracking_pose(&self, previous: &Rigid3, next: &Rigid3) -> Rigid3 {
        interpolate(previous, next, self.interpolation_factor).pose
    }
}

impl Factor for Landmark2d {
    fn variables(&self) -> &[VariableId] {
        &self.variables
    }

    fn residual_dimension(&self) -> usize {
        6
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let &[previous, next, landmark] = parameters else { return false };
        let (Some(previous), Some(next)) = (read_se2(previous), read_se2(next)) else { return false };
        let Some(landmark) = read_se3(landmark) else { return false };
        let tracking = self.interpolate(&previous, &next);
        let poses = (&tracking.pose, &landmark);
        let weights = (self.translation_weight, self.rotation_weight);
        let Some([previous, next, to]) = jacobians else {
            weighted_residual(poses, &self.tracking_from_landmark, weights, residual, None);
            return true;
        };
        let mut by_pose = [0.0; 36];
        let pair = PairJacobians { from: &mut by_pose, to };
        weighted_residual(poses, &self.tracking_from_landmark, weights, residual, Some(pair));
        for (second, jacobian) in [(false, previous), (true, next)] {
            let mut by_node = [0.0; 36];
            tracking.carry(&by_pose, second, &mut by_node);
            let (by_xy, rest) = jacobian.split_at_mut(12);
            by_xy.copy_from_slice(&by_node[..12]);
            // The heading changes by twice the half-angle about z.
            rest.iter_mut().zip(&by_node[30..]).for_each(|(j, v)| *j = 0.5 * v);
        }
        true
    }
}

impl Factor for Landmark3d {
    fn variables(&self) -> &[VariableId] {
        &self.variables
    }

    fn residual_dimension(&self) -> usize {
        6
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let &[previous, next, landmark] = parameters else { return false };
        let (Some(previous), Some(next)) = (read_se3(previous), read_se3(next)) else { return false };
        let Some(landmark) = read_se3(landmark) else { return false };
        let tracking = interpolate(&previous, &next, self.interpolation_factor);
        let poses = (&tracking.pose, &landmark);
        let weights = (self.translation_weight, self.rotation_weight);
        let Some([previous, next, to]) = jacobians else {
            weighted_residual(poses, &self.tracking_from_landmark, weights, residual, None);
            return true;
        };
        let mut by_pose = [0.0; 36];
        let pair = PairJacobians { from: &mut by_pose, to };
        weighted_residual(poses, &self.tracking_from_landmark, weights, residual, Some(pair));
        tracking.carry(&by_pose, false, previous);
        tracking.carry(&by_pose, true, next);
        true
    }
}
