//! From waypoints to a smooth walk: corners become turns or stops, straight pieces get a speed
//! profile within the limits.

use portolan_geometry::Vector2;

use super::Walk;
use super::smooth::{MOST_CURVED, STEEPEST};
use super::turn::UnitTurn;
use super::walk::Span;
use portolan_worlds::two_d::ClearanceGrid;

/// Limits of the motion of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// m/s.
    pub speed: f64,
    /// m/s².
    pub acceleration: f64,
    /// rad/s.
    pub turn_rate: f64,
    /// rad/s².
    pub turn_acceleration: f64,
}

impl Default for MotionLimits {
    fn default() -> Self {
        Self { speed: 0.8, acceleration: 0.6, turn_rate: 1.0, turn_acceleration: 1.5 }
    }
}

/// A corner of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Metres in the map.
    pub position: Vector2,
    /// Time to stand there, seconds; none to pass through.
    pub stop: Option<f64>,
}

/// Maximum angle of a turn in motion, radians; at sharper corners the robot stops.
const SHARPEST_TURN: f64 = 2.2;
/// Maximum distance from the corner at which a turn leaves its lines, metres.
const LONGEST_TANGENT: f64 = 1.1;
/// Minimum of this distance, metres, unless the lines are shorter; where surfaces leave less room the robot
/// stops.
const SHORTEST_TANGENT: f64 = 0.12;
/// Distance between waypoints below which they count as one, metres.
const SAME_POINT: f64 = 0.05;

/// Motion at a waypoint between two straight lines.
enum Corner {
    Stop { seconds: f64, angle: f64 },
    Turn { shape: UnitTurn, length: f64, tangent: f64, speed: f64 },
}

impl Walk {
    /// The walk through `waypoints`, standing `rest` seconds at both ends. With `clearance`, turns keep at
    /// least its distance (metres) from surfaces in its grid. Waypoints without a stop are cut a little,
    /// those with a stop are reached exactly. None without waypoints, and if waypoints are not finite or
    /// limits not above zero.
    pub fn through(
        waypoints: &[Waypoint],
        limits: &MotionLimits,
        rest: f64,
        clearance: Option<(&ClearanceGrid, f64)>,
    ) -> Option<Self> {
        let limit_values = [limits.speed, limits.acceleration, limits.turn_rate, limits.turn_acceleration];
        let is_finite = |p: &Waypoint| p.position.x.is_finite() && p.position.y.is_finite();
        if !limit_values.iter().all(|l| l.is_finite() && *l > 0.0) || !waypoints.iter().all(is_finite) {
            return None;
        }
        let points = merge_near(waypoints);
        let first = points.first()?;
        let heading = points.get(1).map_or(0.0, |next| angle_of(&(next.position - first.position)));
        let mut walk = Self::standing_at(first.position, heading);
        walk.push(Span::Rest, rest + first.stop.unwrap_or(0.0));
        let corners = plan_corners(&points, limits, clearance);
        let mut leg = 0;
        while leg + 1 < points.len() {
            leg = walk.add_move(&points, &corners, leg, limits);
        }
        walk.push(Span::Rest, rest + points.last().and_then(|p| p.stop).unwrap_or(0.0));
        Some(walk)
    }

    /// Adds all spans from the rest at waypoint `first` to the next rest. Gives the index of the waypoint
    /// there.
    fn add_move(
        &mut self,
        points: &[Waypoint],
        corners: &[Corner],
        first: usize,
        limits: &MotionLimits,
    ) -> usize {
        let mut last = first + 1;
        // corners[i] belongs to waypoint i + 1.
        while matches!(corners.get(last - 1), Some(Corner::Turn { .. })) {
            last += 1;
        }
        let turns: Vec<&Corner> = corners[first..last - 1].iter().collect();
        let tangent = |corner: Option<&&Corner>| match corner {
            Some(Corner::Turn { tangent, .. }) => *tangent,
            _ => 0.0,
        };
        let lengths: Vec<f64> = (first..last)
            .map(|leg| {
                let full = (points[leg + 1].position - points[leg].position).norm();
                let i = leg - first;
                let cut = tangent(turns.get(i)) + if i > 0 { tangent(turns.get(i - 1)) } else { 0.0 };
                (full - cut).max(0.0)
            })
            .collect();
        let speeds = plan_speeds(&lengths, &turns, limits);
        for (i, length) in lengths.iter().enumerate() {
            self.add_straight(*length, speeds[i], speeds[i + 1], limits);
            if let Some(Corner::Turn { shape, length, .. }) = turns.get(i) {
                let speed = speeds[i + 1];
                self.push(Span::Turn { shape: shape.clone(), length: *length, speed }, length / speed);
            }
        }
        if let Some(Corner::Stop { seconds, angle }) = corners.get(last - 1) {
            self.push(Span::Rest, *seconds);
            self.push(Span::Pivot(*angle), pivot_time(*angle, limits));
        }
        last
    }

    /// Adds a straight line of `length` metres: up to a cruising speed, at this speed, down again. A change
    /// of speed from v₀ to v₁ at the acceleration a covers (v₀ + v₁)/2 · 1.875 |v₁ − v₀|/a.
    fn add_straight(&mut self, length: f64, from: f64, to: f64, limits: &MotionLimits) {
        let per_square = 0.5 * STEEPEST / limits.acceleration;
        let reachable = (0.5 * (length / per_square + from * from + to * to)).sqrt();
        let cruise = reachable.min(limits.speed).max(from).max(to);
        if cruise <= 0.0 {
            return;
        }
        let ramps = per_square * (2.0 * cruise * cruise - from * from - to * to);
        // Rounding may leave the ramps a hair longer than the piece.
        let shrink = if ramps > length { length / ramps } else { 1.0 };
        let seconds = |change: f64| STEEPEST * change / limits.acceleration * shrink;
        self.push(Span::Straight(from, cruise), seconds(cruise - from));
        self.push(Span::Straight(cruise, cruise), (length - ramps).max(0.0) / cruise);
        self.push(Span::Straight(cruise, to), seconds(cruise - to));
    }
}

/// Speeds at the ends of the straight pieces: at most those that the turns between them allow, and those
/// that can be reached and reduced again.
fn plan_speeds(lengths: &[f64], turns: &[&Corner], limits: &MotionLimits) -> Vec<f64> {
    let mut speeds = vec![0.0];
    speeds.extend(turns.iter().map(|corner| match corner {
        Corner::Turn { speed, .. } => *speed,
        Corner::Stop { .. } => 0.0,
    }));
    speeds.push(0.0);
    let per_square = 0.5 * STEEPEST / limits.acceleration;
    let reachable = |speed: f64, length: f64| (speed * speed + length / per_square).sqrt();
    for i in 1..speeds.len() {
        speeds[i] = speeds[i].min(reachable(speeds[i - 1], lengths[i - 1]));
    }
    for i in (1..speeds.len()).rev() {
        speeds[i - 1] = speeds[i - 1].min(reachable(speeds[i], lengths[i - 1]));
    }
    speeds
}

/// Time for a rotation on the spot within the limits, seconds.
fn pivot_time(angle: f64, limits: &MotionLimits) -> f64 {
    let by_rate = STEEPEST * angle.abs() / limits.turn_rate;
    let by_acceleration = (MOST_CURVED * angle.abs() / limits.turn_acceleration).sqrt();
    by_rate.max(by_acceleration)
}

/// Time that a walk through `before`, `here` and `after` needs to rotate on the spot at `here`, seconds; 0
/// if it does not stop there.
pub(super) fn turning_time(before: &Vector2, here: &Waypoint, after: &Vector2, limits: &MotionLimits) -> f64 {
    let angle = angle_between(&(here.position - before), &(after - here.position));
    let must_stand = here.stop.is_some() || angle.abs() > SHARPEST_TURN;
    if must_stand { pivot_time(angle, limits) } else { 0.0 }
}

/// Merges waypoints that are too near for a straight line between them; stops are kept.
fn merge_near(waypoints: &[Waypoint]) -> Vec<Waypoint> {
    let mut points: Vec<Waypoint> = Vec::with_capacity(waypoints.len());
    for point in waypoints {
        match points.last_mut() {
            Some(last) if (point.position - last.position).norm() < SAME_POINT => {
                let stop = last.stop.unwrap_or(0.0) + point.stop.unwrap_or(0.0);
                last.stop = (last.stop.is_some() || point.stop.is_some()).then_some(stop);
            }
            _ => points.push(*point),
        }
    }
    points
}

/// Motion at every waypoint but the first; the last is a stop.
fn plan_corners(
    points: &[Waypoint],
    limits: &MotionLimits,
    clearance: Option<(&ClearanceGrid, f64)>,
) -> Vec<Corner> {
    let mut corners: Vec<Corner> = points
        .windows(3)
        .map(|three| {
            let (before, after) =
                (three[1].position - three[0].position, three[2].position - three[1].position);
            let angle = angle_between(&before, &after);
            if let Some(seconds) = three[1].stop {
                return Corner::Stop { seconds, angle };
            }
            let room = 0.5 * before.norm().min(after.norm());
            plan_turn(&three[1].position, &before, angle, room, limits, clearance)
                .unwrap_or(Corner::Stop { seconds: 0.0, angle })
        })
        .collect();
    if points.len() > 1 {
        corners.push(Corner::Stop { seconds: 0.0, angle: 0.0 });
    }
    corners
}

/// The widest turn at a corner that keeps clear of surfaces; none if the robot must stop.
fn plan_turn(
    corner: &Vector2,
    before: &Vector2,
    angle: f64,
    room: f64,
    limits: &MotionLimits,
    clearance: Option<(&ClearanceGrid, f64)>,
) -> Option<Corner> {
    if angle.abs() > SHARPEST_TURN {
        return None;
    }
    let shape = UnitTurn::new(angle);
    let direction = before.normalize();
    let mut tangent = room.min(LONGEST_TANGENT);
    while tangent >= SHORTEST_TANGENT.min(0.999 * room) {
        let length = shape.length_for_tangent(tangent);
        let start = corner - direction * tangent;
        let is_clear = clearance.is_none_or(|(grid, needed)| {
            (0..=16).all(|i| {
                let local = shape.position(f64::from(i) / 16.0) * length;
                let moved = Vector2::new(
                    direction.x * local.x - direction.y * local.y,
                    direction.y * local.x + direction.x * local.y,
                );
                grid.clearance(&(start + moved)) >= needed
            })
        });
        if is_clear {
            let speed = turn_speed(angle.abs(), length, limits);
            return Some(Corner::Turn { shape, length, tangent, speed });
        }
        tangent *= 0.75;
    }
    None
}

/// The largest constant speed within the limits of rates.
fn turn_speed(angle: f64, length: f64, limits: &MotionLimits) -> f64 {
    let by_rate = limits.turn_rate * length / (STEEPEST * angle).max(1e-12);
    let by_acceleration = length * (limits.turn_acceleration / (MOST_CURVED * angle).max(1e-12)).sqrt();
    // Lateral acceleration: v² κ.
    let sideways = (limits.acceleration * length / (STEEPEST * angle).max(1e-12)).sqrt();
    limits.speed.min(by_rate).min(by_acceleration).min(sideways)
}

fn angle_of(direction: &Vector2) -> f64 {
    libm::atan2(direction.y, direction.x)
}

/// Angle from one direction to another, in (−π, π].
fn angle_between(from: &Vector2, to: &Vector2) -> f64 {
    libm::atan2(from.x * to.y - from.y * to.x, from.dot(to))
}
