//! Filters corrections for the driver of a robot, so that its pose in the map does not jump where it must
//! not.
//!
//! A driver follows poses in the local map, which are continuous, and needs the transform from there to the
//! known map for goals and paths (REP 105 of ROS splits frames the same way). That transform changes
//! whenever a scan corrects the pose, and by metres when the place is found again.

use portolan_geometry::{
    Rigid3, Time, angle_axis_from_quaternion, quaternion_from_angle_axis, rotation_angle,
};

use crate::settings::jumps::{
    CONFIRMED_AFTER, METRES_BY_DISTANCE, METRES_BY_TIME, METRES_BY_TURN, OTHER_PLACE, RADIANS_BY_DISTANCE,
    RADIANS_BY_TIME, RADIANS_BY_TURN,
};
use crate::state::{Estimate, Reason, State};

/// How corrections are applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Jumps {
    /// Apply them gradually while the robot moves, however large they are.
    Smooth,
    /// Apply them at once.
    #[default]
    Immediate,
    /// Apply small ones gradually; jump to another place at once, but only after that place has been
    /// confirmed.
    Hold,
}

impl Jumps {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Smooth, Self::Immediate, Self::Hold];

    /// Its name as an argument.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Immediate => "immediate",
            Self::Hold => "hold",
        }
    }
}

/// Turns estimates into poses for a driver.
#[derive(Clone, Debug)]
pub struct Corrections {
    jumps: Jumps,
    /// `map_from_local` as reported.
    reported: Option<Rigid3>,
    last: Option<(Time, Rigid3)>,
    /// Time since which another place is localised, and its `map_from_local`.
    elsewhere: Option<(Time, Rigid3)>,
}

impl Corrections {
    /// Nothing has been reported yet.
    pub fn new(jumps: Jumps) -> Self {
        Self { jumps, reported: None, last: None, elsewhere: None }
    }

    /// Takes the next estimate; returns the pose of the tracking frame in the map for the driver. None until
    /// the first localisation, and after local SLAM lost track until the next one. While nothing is
    /// localised, the pose moves with local SLAM.
    pub fn add(&mut self, estimate: &Estimate) -> Option<Rigid3> {
        if estimate.reason == Reason::LocalMapLost && estimate.state == State::Lost {
            *self = Self::new(self.jumps);
        }
        let local_from_tracking = estimate.local_from_tracking;
        let before = self.last.replace((estimate.time, local_from_tracking));
        if let (State::Localised, Some(place)) = (estimate.state, &estimate.place) {
            let found = place.map_from_tracking * local_from_tracking.inverse();
            let reported = self.corrected(estimate, &found, before);
            self.reported = Some(reported);
        }
        self.reported.map(|map_from_local| map_from_local * local_from_tracking)
    }

    /// `map_from_local` as reported last.
    pub fn map_from_local(&self) -> Option<Rigid3> {
        self.reported
    }

    fn corrected(&mut self, estimate: &Estimate, found: &Rigid3, before: Option<(Time, Rigid3)>) -> Rigid3 {
        let (Some(reported), Some((time, from))) = (self.reported, before) else { return *found };
        let at = estimate.local_from_tracking;
        // Compared at the robot: a rotation about the far origin of the local map must not count as a
        // translation.
        let (now, wanted) = (reported * at, *found * at);
        let is_jump = (wanted.translation.vector - now.translation.vector).norm() > OTHER_PLACE.metres
            || rotation_angle(&(now.inverse() * wanted)) > OTHER_PLACE.radians;
        if self.jumps == Jumps::Immediate
            || self.jumps == Jumps::Hold && self.is_confirmed(estimate, found, is_jump)
        {
            return *found;
        }
        if self.jumps == Jumps::Hold && is_jump {
            return reported;
        }
        let motion = from.inverse() * at;
        let (metres, turn) = (motion.translation.vector.norm(), rotation_angle(&motion));
        let seconds = estimate.time.seconds_since(time).clamp(0.0, 1.0);
        let most_shift = METRES_BY_DISTANCE * metres + METRES_BY_TURN * turn + METRES_BY_TIME * seconds;
        let most_turn = RADIANS_BY_DISTANCE * metres + RADIANS_BY_TURN * turn + RADIANS_BY_TIME * seconds;
        towards(&now, &wanted, most_shift, most_turn) * at.inverse()
    }

    /// Whether another place has been localised for long enough.
    fn is_confirmed(&mut self, estimate: &Estimate, found: &Rigid3, is_jump: bool) -> bool {
        if !is_jump {
            self.elsewhere = None;
            return false;
        }
        let at = estimate.local_from_tracking;
        let is_same = |other: &Rigid3| {
            ((*other * at).translation.vector - (*found * at).translation.vector).norm() < OTHER_PLACE.metres
        };
        let since =
            self.elsewhere.filter(|(_, other)| is_same(other)).map_or(estimate.time, |(since, _)| since);
        self.elsewhere = Some((since, *found));
        let is_confirmed = estimate.time.seconds_since(since) >= CONFIRMED_AFTER;
        if is_confirmed {
            self.elsewhere = None;
        }
        is_confirmed
    }
}

/// Moves a pose towards another, by at most this translation, metres, and rotation, radians.
fn towards(from: &Rigid3, to: &Rigid3, most_shift: f64, most_turn: f64) -> Rigid3 {
    let shift = to.translation.vector - from.translation.vector;
    let turn = angle_axis_from_quaternion(&(to.rotation * from.rotation.inverse()));
    let share = |most: f64, whole: f64| if whole > most { most / whole } else { 1.0 };
    let shift = shift * share(most_shift, shift.norm());
    let turn = turn * share(most_turn, turn.norm());
    let rotation = quaternion_from_angle_axis(&turn) * from.rotation;
    Rigid3::from_parts((from.translation.vector + shift).into(), rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::Matrix6;
    use crate::state::Place;
    use portolan_geometry::Duration;

    /// A robot that drives along x at 0.5 m/s and is localised `off` metres to the side.
    fn estimate(index: i64, off: f64, state: State) -> Estimate {
        let local_from_tracking = Rigid3::translation(0.05 * index as f64, 0.0, 0.0);
        let map_from_tracking = Rigid3::translation(0.0, off, 0.0) * local_from_tracking;
        let place =
            Place { map_from_tracking, covariance: Matrix6::identity(), agreement: Default::default() };
        let time = Time::from_ticks(0) + Duration::from_seconds(0.1 * index as f64);
        Estimate { time, state, reason: Reason::ScansFit, local_from_tracking, place: Some(place) }
    }

    /// Lateral positions reported to the driver, scan by scan; the place jumps by `jump` metres after 2 s.
    fn reported(jumps: Jumps, jump: f64) -> Vec<f64> {
        let mut corrections = Corrections::new(jumps);
        let off = |i: i64| if i < 20 { 1.0 } else { 1.0 + jump };
        (0..200)
            .filter_map(|i| corrections.add(&estimate(i, off(i), State::Localised)))
            .map(|pose| pose.translation.y)
            .collect()
    }

    fn largest_step(reported: &[f64]) -> f64 {
        reported.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn jumps_follow_the_policy() {
        assert!((largest_step(&reported(Jumps::Immediate, 3.0)) - 3.0).abs() < 1e-9);
        let smooth = reported(Jumps::Smooth, 0.3);
        assert!(largest_step(&smooth) < 0.011 && (smooth[199] - 1.3).abs() < 1e-9, "{smooth:?}");
        let hold = reported(Jumps::Hold, 3.0);
        assert!((hold[39] - 1.0).abs() < 1e-9 && (hold[41] - 4.0).abs() < 1e-9, "{:?}", &hold[38..42]);
        assert!(largest_step(&reported(Jumps::Hold, 0.3)) < 0.011);
    }

    #[test]
    fn poses_follow_local_slam_while_not_localised_but_not_across_a_loss_of_the_local_map() {
        let mut corrections = Corrections::new(Jumps::Hold);
        assert!(corrections.add(&estimate(0, 1.0, State::Tentative)).is_none());
        assert!(corrections.add(&estimate(1, 1.0, State::Localised)).is_some());
        let uncertain = corrections.add(&Estimate { place: None, ..estimate(9, 0.0, State::Lost) });
        assert!(uncertain.is_some_and(|pose| (pose.translation.x - 0.45).abs() < 1e-9));
        let lost = Estimate { reason: Reason::LocalMapLost, ..estimate(10, 0.0, State::Lost) };
        assert!(corrections.add(&lost).is_none() && corrections.map_from_local().is_none());
    }
}
