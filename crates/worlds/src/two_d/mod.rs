//! Worlds in 2D: fixed surfaces, people who walk, and ray casting.

mod clearance;
mod corridors;
mod draft;
mod furniture;
mod grid;
mod hall;
mod office;
mod person;
mod plan;
mod rooms;
mod shape;
mod warehouse;

pub use clearance::{ClearanceGrid, PathCosts, PathSearch};
pub use draft::{Draft, Opening};
pub use grid::{Crossings, ShapeGrid};
pub use person::{NearbyPeople, Person};
pub use plan::{FloorPlan, Passage, Place, PlanStyle, Scene, draw_plan};
pub use shape::{Hit, Material, Outline, Ray, Shape};

/// Edge of a cell of the ray-casting grid, metres.
const CAST_CELL: f64 = 0.5;

/// A building with its people.
#[derive(Clone, Debug)]
pub struct World {
    fixed: ShapeGrid,
    people: Vec<Person>,
}

impl World {
    /// A world of fixed surfaces and walking people.
    pub fn new(shapes: Vec<Shape>, people: Vec<Person>) -> Self {
        Self { fixed: ShapeGrid::new(shapes, CAST_CELL), people }
    }

    /// All fixed surfaces.
    pub fn fixed(&self) -> &ShapeGrid {
        &self.fixed
    }

    /// The people who walk.
    pub fn people(&self) -> &[Person] {
        &self.people
    }
}
