//! The kinds of surroundings in 3D.

use std::fmt;
use std::str::FromStr;

use super::{
    SolidPlan, SolidStyle, field::draw_field, garage::draw_garage, museum::draw_museum, park::draw_park,
    tunnel::draw_tunnel,
};
use crate::WorldError;

/// The kinds of surroundings in 3D.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Scene3d {
    /// Storeys of halls around an atrium, stairs, a ramp, and a garden: walked with a backpack.
    #[default]
    Museum,
    /// Decks that look alike, joined by sloped ramps: driven.
    Garage,
    /// Hills, trees and winding paths: driven or walked under the open sky.
    Park,
    /// A long smooth tunnel with a slight bend, from whose middle a lidar sees neither end: driven.
    Tunnel,
    /// Open, nearly flat ground with next to nothing on it: driven.
    Field,
}

impl Scene3d {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Museum, Self::Garage, Self::Park, Self::Tunnel, Self::Field];

    /// The name by which it is chosen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Museum => "museum",
            Self::Garage => "garage",
            Self::Park => "park",
            Self::Tunnel => "tunnel",
            Self::Field => "field",
        }
    }

    /// Default width and depth of the ground (length and width of the tunnel), metres.
    pub fn default_size(self) -> [f64; 2] {
        match self {
            Self::Museum => [34.0, 24.0],
            Self::Garage => [48.0, 32.0],
            Self::Park => [80.0, 64.0],
            Self::Tunnel => [300.0, 6.0],
            Self::Field => [240.0, 240.0],
        }
    }

    /// Smallest size that can be drawn, metres.
    pub fn minimum_size(self) -> [f64; 2] {
        match self {
            Self::Museum => [22.0, 19.0],
            Self::Garage => [40.0, 26.0],
            Self::Park => [30.0, 30.0],
            Self::Tunnel => [60.0, 3.0],
            Self::Field => [60.0, 60.0],
        }
    }

    /// Default number of storeys or decks.
    pub fn default_storeys(self) -> usize {
        match self {
            Self::Museum | Self::Garage => 3,
            Self::Park | Self::Tunnel | Self::Field => 1,
        }
    }

    /// Default number of people who walk about.
    pub fn default_people(self) -> usize {
        match self {
            Self::Museum => 12,
            Self::Garage => 3,
            Self::Park => 8,
            Self::Tunnel | Self::Field => 0,
        }
    }

    /// Draws such surroundings; the same seed gives the same plan.
    pub fn draw(self, style: &SolidStyle, seed: u64) -> SolidPlan {
        match self {
            Self::Museum => draw_museum(style, seed),
            Self::Garage => draw_garage(style, seed),
            Self::Park => draw_park(style, seed),
            Self::Tunnel => draw_tunnel(style, seed),
            Self::Field => draw_field(style, seed),
        }
    }
}

impl fmt::Display for Scene3d {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Scene3d {
    type Err = WorldError;

    fn from_str(name: &str) -> Result<Self, WorldError> {
        Self::ALL.into_iter().find(|scene| scene.name() == name).ok_or_else(|| WorldError::UnknownScene {
            name: name.to_owned(),
            known: Self::ALL.map(Self::name).join(", "),
        })
    }
}
