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
mod stairs;
mod terrain;
mod tree;
mod tunnel;
mod world;

pub use bvh::Hierarchy;
pub use draft::SolidDraft;
pub(crate) use field::draw_field;
pub(crate) use garage::draw_garage;
pub(crate) use museum::draw_museum;
pub(crate) use park::draw_park;
pub use pedestrian::Pedestrian;
pub use primitive::{Body, Bounds, Hit3, Ray3, Solid};
pub use terrain::Terrain;
pub(crate) use tunnel::draw_tunnel;
pub use world::{Echo, Moment, SolidWorld};

use portolan_geometry::Vector3;

/// A world as it is drawn, before anything moves.
#[derive(Clone, Debug, Default)]
pub struct SolidPlan {
    /// Everything fixed.
    pub solids: Vec<Solid>,
    /// Closed ways over the ground, all from the same place and back to it. A tour is made of them.
    pub loops: Vec<Vec<Vector3>>,
    /// Closed ways for people.
    pub strolls: Vec<Vec<Vector3>>,
    /// Places for landmarks on walls, with the direction in which they can be seen.
    pub marks: Vec<(Vector3, Vector3)>,
}
