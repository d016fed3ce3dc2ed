//! Worlds in 3D: fixed solids, people who walk, and ray casting.

mod bvh;
mod draft;
mod field;
mod furnishing;
mod garage;
mod museum;
mod park;
mod pedestrian;
mod primitive;
mod scene;
mod stairs;
mod terrain;
mod tree;
mod tunnel;
mod world;

pub use bvh::Hierarchy;
pub use draft::SolidDraft;
pub use pedestrian::Pedestrian;
pub use primitive::{Body, Bounds, Hit3, Ray3, Solid};
pub use scene::Scene3d;
pub use terrain::Terrain;
pub use world::{Echo, Moment, SolidWorld};

use portolan_geometry::Vector3;

/// Style of a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidStyle {
    /// Width and depth, metres.
    pub size: [f64; 2],
    /// Storeys or decks.
    pub storeys: usize,
    /// Density of furniture and other objects: 0 none, 1 usual, at most 3.
    pub clutter: f64,
    /// Fraction of windows, 0 to 1.
    pub glass: f64,
}

/// Plan of a world: fixed solids, paths and positions of landmarks.
#[derive(Clone, Debug, Default)]
pub struct SolidPlan {
    /// All fixed solids.
    pub solids: Vec<Solid>,
    /// Closed paths over the ground, all from the same position and back to it, of which a tour is
    /// composed.
    pub loops: Vec<Vec<Vector3>>,
    /// Closed paths for people.
    pub strolls: Vec<Vec<Vector3>>,
    /// Positions of landmarks on walls, each with its normal: the direction from which it can be seen.
    pub marks: Vec<(Vector3, Vector3)>,
}
