//! Pose graphs: reading and writing g2o files, initial values, optimisation.
//!
//! The error of an edge with measurement `z` from pose `x_i` to pose `x_j` is `e = z⁻¹ x_i⁻¹ x_j`, in the plane as
//! (x, y, θ), in space as (x, y, z, qx, qy, qz) with the quaternion's w ≥ 0 (**not** doubled: this is what the
//! information matrices of EDGE_SE3:QUAT refer to, and what the published optima of the standard graphs are
//! reached with). `chi2 = Σ eᵀΩe`, twice the cost without robust losses.

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
pub use pose::GraphPose;
pub use read::{G2oError, G2oRepairs, read_g2o};
pub use report::{EdgeChi2, Report};
pub use write::write_g2o;
