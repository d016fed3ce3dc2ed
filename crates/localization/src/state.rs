//! State of localisation after a scan, and the reason for it.

use std::fmt;

use nalgebra::Matrix3;
use portolan_geometry::{NearFrame, Rigid3, Time};
use portolan_grids::ScanAgreement;
use portolan_mapping::Placement;

use crate::belief::Matrix6;

/// How certain the place is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// Nothing fits yet.
    Searching,
    /// Something fits, but other places may fit as well.
    Tentative,
    /// The place is known.
    Localised,
    /// The place was known, but scans do not confirm it at the moment.
    Uncertain,
    /// The place was known, but was given up; [`Estimate::reason`] gives the reason.
    Lost,
}

impl State {
    /// All of them, in the usual order.
    pub const ALL: [Self; 5] =
        [Self::Searching, Self::Tentative, Self::Localised, Self::Uncertain, Self::Lost];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Tentative => "tentative",
            Self::Localised => "localised",
            Self::Uncertain => "uncertain",
            Self::Lost => "lost",
        }
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why the state is what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// No place in the map fits what was seen.
    NoPlaceFits,
    /// Several places fit about as well.
    SeveralPlacesFit,
    /// One place fits, but too little was seen along the path to accept it.
    TooLittleSeen,
    /// Scans fit the map.
    ScansFit,
    /// Scans contradict the map.
    ScansContradict,
    /// The map is unknown where the scans see.
    OutsideTheMap,
    /// Something hides the surroundings from the scanner: local SLAM alone predicts the pose.
    PlaceHidden,
    /// Another place fits better.
    AnotherPlaceFitsBetter,
    /// Local SLAM lost track, so that the motion of the scanner is unmeasured.
    LocalMapLost,
}

impl Reason {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::NoPlaceFits,
        Self::SeveralPlacesFit,
        Self::TooLittleSeen,
        Self::ScansFit,
        Self::ScansContradict,
        Self::OutsideTheMap,
        Self::PlaceHidden,
        Self::AnotherPlaceFitsBetter,
        Self::LocalMapLost,
    ];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoPlaceFits => "no_place_fits",
            Self::SeveralPlacesFit => "several_places_fit",
            Self::TooLittleSeen => "too_little_seen",
            Self::ScansFit => "scans_fit",
            Self::ScansContradict => "scans_contradict",
            Self::OutsideTheMap => "outside_the_map",
            Self::PlaceHidden => "place_hidden",
            Self::AnotherPlaceFitsBetter => "another_place_fits_better",
            Self::LocalMapLost => "local_map_lost",
        }
    }
}

/// A place in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Pose of the tracking frame in the map.
    pub map_from_tracking: Rigid3,
    /// Covariance of the pose in the map: x, y, z and a small rotation about these axes (the last about z:
    /// yaw), metres and radians. In 2D its entries for z and tilts have no meaning.
    pub covariance: Matrix6,
    /// Agreement of the map with the scan at this pose: fractions of its beams.
    pub agreement: ScanAgreement,
}

impl Place {
    /// Covariance of x, y and yaw alone.
    pub fn covariance_2d(&self) -> Matrix3<f64> {
        let axis = |i: usize| if i < 2 { i } else { 5 };
        Matrix3::from_fn(|i, j| self.covariance.get((axis(i), axis(j))).copied().unwrap_or_default())
    }
}

/// Result of localisation after one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Time of the scan.
    pub time: Time,
    /// How certain the place is.
    pub state: State,
    /// Reason for the state.
    pub reason: Reason,
    /// Pose of the tracking frame in the local map: smooth, except for jumps where local SLAM lost track.
    pub local_from_tracking: Rigid3,
    /// The place; the most likely one where the state is tentative; none where there is no candidate.
    pub place: Option<Place>,
}

impl Estimate {
    /// Converts an estimate from a frame near the map to the map.
    pub fn in_map(mut self, frame: &NearFrame) -> Self {
        if let Some(place) = &mut self.place {
            place.map_from_tracking = frame.in_map(&place.map_from_tracking);
        }
        self
    }

    /// How a node of this scan may be used in the map: found, if its position has at most the standard
    /// deviation `certain`, metres; carried along otherwise.
    pub(crate) fn placement(&self, certain: f64) -> Placement {
        let Some(place) = self.place.filter(|_| self.state == State::Localised) else {
            return Placement::Unknown;
        };
        let worst = place.covariance.fixed_view::<3, 3>(0, 0).symmetric_eigenvalues().max();
        match worst.max(0.0).sqrt() <= certain {
            true => Placement::Found(place.map_from_tracking),
            false => Placement::Carried(place.map_from_tracking),
        }
    }
}
