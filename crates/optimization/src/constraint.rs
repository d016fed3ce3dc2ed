//! Constraints between submaps and nodes.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Vector3};

use crate::{NodeId, SubmapId};

/// Where a constraint comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ConstraintTag {
    /// The node was inserted into the submap.
    IntraSubmap,
    /// The node was matched against the submap: a loop closure.
    InterSubmap,
}

/// A measured pose of a node in a submap.
#[derive(Clone, Debug, PartialEq)]
pub struct Constraint {
    /// The submap.
    pub submap_id: SubmapId,
    /// The node.
    pub node_id: NodeId,
    /// Pose of the node in the submap. In 2D the node frame is the *gravity-aligned* tracking frame
    /// while the map is in memory; files have the tracking frame (`formats.md` §2.1).
    pub submap_from_node: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
    /// Where it comes from.
    pub tag: ConstraintTag,
    /// The direction along which the match does not constrain the position (2D).
    pub open: Option<OpenShift>,
    /// Match score in [0, 1] for those found by matching in this run; files do not keep it.
    pub score: Option<f32>,
}

/// A degenerate direction of a match: that of a corridor whose doors look alike.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenShift {
    /// Unit vector in the frame of the node.
    pub direction: Vector3,
}

impl OpenShift {
    /// A shift (frame of the node) without its component along the degenerate direction.
    pub fn closed_part(&self, shift: &Vector3) -> Vector3 {
        shift - self.direction * self.direction.dot(shift)
    }

    /// Square root of the information of a match with these weights (1/m, 1/rad).
    pub(crate) fn square_root_information(&self, (translation, rotation): (f64, f64)) -> na::Matrix6<f64> {
        let mut root = na::Matrix6::from_diagonal_element(rotation);
        let closed = na::Matrix3::identity() - self.direction * self.direction.transpose();
        root.fixed_view_mut::<3, 3>(0, 0).copy_from(&(closed * translation));
        root
    }
}

impl Constraint {
    /// Whether it is a loop closure.
    pub fn is_loop_closure(&self) -> bool {
        self.tag == ConstraintTag::InterSubmap
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_along_a_degenerate_direction_have_no_weight() {
        let open = OpenShift { direction: Vector3::new(0.6, 0.8, 0.0) };
        assert!(open.closed_part(&Vector3::new(3.0, 4.0, 0.0)).norm() < 1e-12);
        assert!(
            (open.closed_part(&Vector3::new(-0.8, 0.6, 0.5)) - Vector3::new(-0.8, 0.6, 0.5)).norm() < 1e-12
        );
        let root = open.square_root_information((500.0, 1600.0));
        let residual = root * na::Vector6::new(3.0 - 0.8, 4.0 + 0.6, 0.0, 0.0, 0.0, 0.1);
        assert!(
            (residual - na::Vector6::new(-400.0, 300.0, 0.0, 0.0, 0.0, 160.0)).norm() < 1e-9,
            "{residual}"
        );
    }
}
