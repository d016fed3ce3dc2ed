//! Pose graphs: reading and writing g2o files, initial values, optimisation.
//!
//! The error of an edge with measurement `z` from pose `x_i` to pose `x_j` is computed from `z⁻¹ x_i⁻¹ x_j`:
//! in 2D (x, y, θ), in 3D six numbers by [`Se3ErrorConvention`](crate::factors::Se3ErrorConvention). Programs
//! use different conventions and therefore have different optima: for sphere2500, for example, it is 1351.4
//! with the logarithm of SE(3) (the default here), 1351.2 with the doubled vector part of the quaternion and
//! 727.1 with the vector part itself. `chi2 = Σ eᵀΩe`, twice the cost without robust losses.

mod chordal;
mod connectivity;
mod graph;
mod initialize;
mod optimize;
mod pose;
mod read;
mod report;
mod write;

pub use graph::{Edge, Graph, GraphError, PoseGraph, Vertex};
pub use initialize::Initialization;
pub use optimize::{OptimizeOptions, optimize_graph, optimize_pose_graph};
pub use pose::{GraphPose, InformationMatrix};
pub use read::{G2oError, G2oRepairs, read_g2o};
pub use report::{EdgeChi2, Report};
pub use write::write_g2o;
