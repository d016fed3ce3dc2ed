//! The spaces that local SLAM works in.

use std::fmt::Debug;

use portolan_submaps::{Submap2d, Submap3d};

/// A space that local SLAM works in: 2D or 3D.
pub trait LocalSlamSpace: Copy + Debug + Send + Sync + 'static {
    /// A submap as local SLAM builds it.
    type Submap: Clone + Debug + Send + Sync + 'static;
}

/// 2D mapping: poses (x, y, θ), grids of probabilities or signed distances.
#[derive(Clone, Copy, Debug)]
pub struct Space2d;

impl LocalSlamSpace for Space2d {
    type Submap = Submap2d;
}

/// 3D mapping: poses in 3D, hybrid grids.
#[derive(Clone, Copy, Debug)]
pub struct Space3d;

impl LocalSlamSpace for Space3d {
    type Submap = Submap3d;
}
