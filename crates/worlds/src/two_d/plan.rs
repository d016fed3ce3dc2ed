//! Floor plans: surfaces, places to go to, and the passages between them.

use std::fmt;
use std::str::FromStr;

use portolan_geometry::Vector2;

use super::shape::Shape;
use super::{corridors, hall, office, warehouse};
use crate::WorldError;
use crate::random::Random;

/// The kinds of building that can be drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scene {
    /// An office floor: corridors that form loops, rooms with doors and furniture, glass fronts.
    #[default]
    Office,
    /// One long loop of smooth corridor: only the corners constrain the position along it.
    Corridors,
    /// A large hall with pillars and kiosks: most beams have no return.
    Hall,
    /// Rows of racks with pallets: aisles that look alike.
    Warehouse,
}

impl Scene {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Office, Self::Corridors, Self::Hall, Self::Warehouse];

    /// The name by which it is chosen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Office => "office",
            Self::Corridors => "corridors",
            Self::Hall => "hall",
            Self::Warehouse => "warehouse",
        }
    }

    /// Default width and height of the floor, metres.
    pub fn default_size(self) -> [f64; 2] {
        match self {
            Self::Office => [40.0, 25.0],
            Self::Corridors => [60.0, 24.0],
            Self::Hall => [60.0, 40.0],
            Self::Warehouse => [50.0, 30.0],
        }
    }

    /// The smallest floor that can be drawn, metres.
    pub fn minimum_size(self) -> [f64; 2] {
        match self {
            Self::Office => [26.0, 17.0],
            Self::Corridors => [10.0, 10.0],
            Self::Hall => [15.0, 12.0],
            Self::Warehouse => [20.0, 15.0],
        }
    }

    /// Default number of people who walk about.
    pub fn default_people(self) -> usize {
        match self {
            Self::Office => 5,
            Self::Corridors => 0,
            Self::Hall => 10,
            Self::Warehouse => 3,
        }
    }
}

impl fmt::Display for Scene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Scene {
    type Err = WorldError;
    fn from_str(name: &str) -> Result<Self, WorldError> {
        let known = Self::ALL.into_iter().find(|scene| scene.name() == name);
        known.ok_or_else(|| WorldError::UnknownScene {
            name: name.to_owned(),
            known: Self::ALL.map(Self::name).join(", "),
        })
    }
}

/// Style of a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanStyle {
    /// Width and height of the floor inside its outer walls, metres.
    pub size: [f64; 2],
    /// Fraction of doors that are closed, in [0, 1].
    pub closed_doors: f64,
    /// Density of furniture and other objects: 0 none, 1 usual, 2 twice as likely.
    pub clutter: f64,
    /// Fraction of larger rooms with a glass front, in [0, 1].
    pub glass: f64,
}

/// A junction or a room.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Name for display, for example `room 12`.
    pub name: String,
    /// Metres in the map frame; furniture may stand there.
    pub position: Vector2,
    /// Whether a tour enters it and comes back, instead of passing through.
    pub is_room: bool,
}

/// A passage between two junctions, with the rooms along it.
#[derive(Clone, Debug, PartialEq)]
pub struct Passage {
    /// Index of the place at one end.
    pub from: usize,
    /// Index of the place at the other end.
    pub to: usize,
    /// Indices of places reached from this passage, in order from `from` to `to`.
    pub rooms: Vec<usize>,
}

/// A floor with all fixed objects on it. The outer walls enclose (0, 0) to `size`.
#[derive(Clone, Debug, Default)]
pub struct FloorPlan {
    /// All surfaces.
    pub shapes: Vec<Shape>,
    /// Width and height, metres.
    pub size: Vector2,
    /// Places that a tour may visit; some may be locked or blocked.
    pub places: Vec<Place>,
    /// Connections of the junctions among the places.
    pub passages: Vec<Passage>,
}

/// Maximum length of a side of a floor, metres.
const LONGEST_SIDE: f64 = 200.0;

impl FloorPlan {
    /// Checks sizes and indices of a plan given by the user.
    ///
    /// # Errors
    /// [`WorldError::BadPlan`] says what to change.
    pub fn check(&self) -> Result<(), WorldError> {
        let bad = |detail: String| Err(WorldError::BadPlan { detail });
        let is_size = |side: f64| (1.0..=LONGEST_SIDE).contains(&side);
        if !is_size(self.size.x) || !is_size(self.size.y) {
            return bad(format!("its sides must be from 1 to {LONGEST_SIDE} m"));
        }
        let reach = Vector2::new(LONGEST_SIDE, LONGEST_SIDE);
        let is_near = |p: &Vector2| {
            (-reach.x..=2.0 * reach.x).contains(&p.x) && (-reach.y..=2.0 * reach.y).contains(&p.y)
        };
        let has_bounds = |shape: &Shape| {
            let (low, high) = shape.bounds();
            is_near(&low) && is_near(&high)
        };
        if let Some(index) = self.shapes.iter().position(|shape| !has_bounds(shape)) {
            return bad(format!("surface {index} is not a finite one on or near the floor"));
        }
        if let Some(place) = self.places.iter().find(|place| !is_near(&place.position)) {
            return bad(format!("place \"{}\" is not on or near the floor", place.name));
        }
        let ends = |passage: &Passage| [passage.from, passage.to];
        let mut indices =
            self.passages.iter().flat_map(|p| ends(p).into_iter().chain(p.rooms.iter().copied()));
        match indices.find(|index| *index >= self.places.len()) {
            Some(index) => bad(format!("a passage names place {index}, but there are {}", self.places.len())),
            None => Ok(()),
        }
    }

    /// Adds a place where passages meet, and gives its index.
    pub fn add_junction(&mut self, name: String, position: Vector2) -> usize {
        self.places.push(Place { name, position, is_room: false });
        self.places.len() - 1
    }

    /// Adds a room, and gives its index.
    pub fn add_room(&mut self, name: String, position: Vector2) -> usize {
        self.places.push(Place { name, position, is_room: true });
        self.places.len() - 1
    }

    /// Connects two places.
    pub fn add_passage(&mut self, from: usize, to: usize) {
        self.passages.push(Passage { from, to, rooms: Vec::new() });
    }
}

/// Draws the plan number `seed` of a scene; the same arguments give the same plan.
pub fn draw_plan(scene: Scene, style: &PlanStyle, seed: u64) -> FloorPlan {
    let mut random = Random::new(seed, scene.name(), 0);
    match scene {
        Scene::Office => office::draw(style, &mut random),
        Scene::Corridors => corridors::draw(style),
        Scene::Hall => hall::draw(style, &mut random),
        Scene::Warehouse => warehouse::draw(style, &mut random),
    }
}
