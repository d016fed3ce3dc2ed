//! Describes the examined places of a map, for programs and for users.

use portolan_geometry::{Rigid3, yaw};
use portolan_localization::{Distinctness, ExaminedPlace};
use serde::Serialize;

use super::examine::{ExaminedMap, PlaceCount};

/// How well the places of a map can be distinguished.
#[derive(Serialize)]
pub struct Places {
    /// Length of the trajectories.
    trajectory_metres: f64,
    /// Places of each kind.
    kinds: Vec<Kind>,
    /// All of them along the trajectories.
    places: Vec<Place>,
}

#[derive(Serialize)]
struct Kind {
    kind: &'static str,
    places: usize,
    fraction_of_trajectory: f64,
}

/// A place: metres and radians in the map.
#[derive(Serialize)]
struct Place {
    kind: &'static str,
    trajectory: u32,
    node: u32,
    pose: Pose,
    /// Fraction of the beams of the node's scan that the map explains.
    explained: f64,
    /// Mean fraction that it explains less the fraction that it contradicts, of the scans before it.
    fit: f64,
    /// The best place elsewhere.
    other: Option<Pose>,
    /// Fit of the same scans at the other place.
    other_fit: Option<f64>,
    /// Degenerate direction of the scan, radians in the map; none if there is none, or only in rotation.
    open_direction: Option<f64>,
}

#[derive(Serialize)]
struct Pose {
    x: f64,
    y: f64,
    z: f64,
    yaw: f64,
}

impl Places {
    /// Summary for users: the number of examined places and the fraction that is distinct.
    pub fn text(&self) -> String {
        let distinct = self.kinds.iter().find(|kind| kind.kind == Distinctness::Distinct.name());
        format!(
            "  places: {} along {:.0} m were examined, {:.0} % of the trajectory is distinct\n",
            self.places.len(),
            self.trajectory_metres,
            100.0 * distinct.map_or(0.0, |kind| kind.fraction_of_trajectory),
        )
    }

    /// Describes an examined map.
    pub fn of(examined: &ExaminedMap) -> Self {
        let kind = |(kind, count): (Distinctness, PlaceCount)| Kind {
            kind: kind.name(),
            places: count.places,
            fraction_of_trajectory: count.fraction_of_path,
        };
        Self {
            trajectory_metres: examined.path_length(),
            kinds: examined.counts().into_iter().map(kind).collect(),
            places: examined.places.iter().map(Place::of).collect(),
        }
    }
}

impl Place {
    fn of(place: &ExaminedPlace) -> Self {
        let degenerate = place.degenerate_direction.filter(|direction| direction.norm() > 0.5);
        Self {
            kind: place.distinctness.name(),
            trajectory: place.node_id.trajectory_id.0,
            node: place.node_id.index,
            pose: Pose::of(&place.map_from_tracking),
            explained: place.explained,
            fit: place.fit,
            other: place.other.map(|other| Pose::of(&other.map_from_tracking)),
            other_fit: place.other.map(|other| other.fit),
            open_direction: degenerate.map(|direction| direction.y.atan2(direction.x)),
        }
    }
}

impl Pose {
    fn of(map_from_tracking: &Rigid3) -> Self {
        let at = map_from_tracking.translation;
        Self { x: at.x, y: at.y, z: at.z, yaw: yaw(&map_from_tracking.rotation) }
    }
}
