//! Worlds in 3D: what stands in them, who walks in them, and what a beam meets.

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

/// What a world looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidStyle {
    /// Width and depth, metres.
    pub size: [f64; 2],
    /// Storeys or decks.
    pub storeys: usize,
    /// How much stands about: 0 nothing, 1 as usual, at most 3.
    pub clutter: f64,
    /// Fraction of windows, 0 to 1.
    pub glass: f64,
}

/// A world as it is drawn, before anything moves.
#[derive(Clone, Debug, Default)]
pub struct SolidPlan {
    /// Everything fixed.
    pub solids: Vec<Solid>,
    /// Closed paths over the ground, all from the same place and back to it. A tour is made of them.
    pub loops: Vec<Vec<Vector3>>,
    /// Closed paths for people.
    pub strolls: Vec<Vec<Vector3>>,
    /// Places for landmarks on walls, with the direction in which they can be seen.
    pub marks: Vec<(Vector3, Vector3)>,
}
