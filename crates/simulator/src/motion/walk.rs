//! A walk as a sequence of spans, each with a closed form.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Vector2, Vector3};

use super::smooth;
use super::turn::UnitTurn;
use super::{Motion, MotionState, Rolling};

/// Pose and derivatives of a robot in 2D.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState2d {
    /// Metres in the map.
    pub position: Vector2,
    /// Radians, unwrapped.
    pub heading: f64,
    /// (cos, sin) of the heading.
    pub direction: Vector2,
    /// m/s along the direction.
    pub speed: f64,
    /// m/s² along the direction.
    pub acceleration: f64,
    /// rad/s.
    pub turn_rate: f64,
    /// rad/s².
    pub turn_acceleration: f64,
    /// Metres driven since the start.
    pub travelled: f64,
}

/// Motion during one span.
#[derive(Clone, Debug)]
pub(crate) enum Span {
    /// Standing still.
    Rest,
    /// Rotation on the spot by an angle, radians.
    Pivot(f64),
    /// Straight line, while the speed changes smoothly from the first to the second value, m/s.
    Straight(f64, f64),
    /// A turn of the given length with constant speed.
    Turn { shape: UnitTurn, length: f64, speed: f64 },
}

#[derive(Clone, Debug)]
struct TimedSpan {
    start_time: f64,
    duration: f64,
    /// State at the start; its speed, acceleration and rates are not used.
    start: MotionState2d,
    span: Span,
}

/// The motion of a wheeled robot: without lateral velocity, with continuous velocity and acceleration, at
/// rest at both ends.
#[derive(Clone, Debug)]
pub struct Walk {
    spans: Vec<TimedSpan>,
    end_time: f64,
    end: MotionState2d,
}

impl Walk {
    /// A walk that stands at a pose, to which spans are added.
    pub(crate) fn standing_at(position: Vector2, heading: f64) -> Self {
        let (sine, cosine) = libm::sincos(heading);
        let end = MotionState2d {
            position,
            heading,
            direction: Vector2::new(cosine, sine),
            speed: 0.0,
            acceleration: 0.0,
            turn_rate: 0.0,
            turn_acceleration: 0.0,
            travelled: 0.0,
        };
        Self { spans: Vec::new(), end_time: 0.0, end }
    }

    /// A robot that stands for `duration` seconds.
    pub fn standing(position: Vector2, heading: f64, duration: f64) -> Self {
        let mut walk = Self::standing_at(position, heading);
        walk.push(Span::Rest, duration);
        walk
    }

    /// Adds a span; spans that take no time are left out.
    pub(crate) fn push(&mut self, span: Span, duration: f64) {
        if duration <= 0.0 {
            return;
        }
        let timed = TimedSpan { start_time: self.end_time, duration, start: self.end, span };
        self.end = timed.state(duration);
        self.end_time += duration;
        self.spans.push(timed);
    }

    /// Pose and derivatives at `time` seconds; the start before 0, the end after the duration.
    pub fn state_2d(&self, time: f64) -> MotionState2d {
        let after = self.spans.partition_point(|s| s.start_time <= time);
        match self.spans.get(after.saturating_sub(1)) {
            Some(span) if time < self.end_time => {
                span.state((time - span.start_time).clamp(0.0, span.duration))
            }
            _ => self.end,
        }
    }
}

impl TimedSpan {
    fn state(&self, elapsed: f64) -> MotionState2d {
        let share = elapsed / self.duration;
        let still = MotionState2d {
            speed: 0.0,
            acceleration: 0.0,
            turn_rate: 0.0,
            turn_acceleration: 0.0,
            ..self.start
        };
        match &self.span {
            Span::Rest => still,
            Span::Pivot(angle) => MotionState2d {
                turn_rate: angle * smooth::slope(share) / self.duration,
                turn_acceleration: angle * smooth::bend(share) / (self.duration * self.duration),
                ..still.turned(angle * smooth::step(share))
            },
            Span::Straight(from, to) => {
                let gained = (to - from) * self.duration * smooth::area(share);
                let distance = from * elapsed + gained;
                MotionState2d {
                    position: self.start.position + self.start.direction * distance,
                    speed: from + (to - from) * smooth::step(share),
                    acceleration: (to - from) * smooth::slope(share) / self.duration,
                    travelled: self.start.travelled + distance,
                    ..still
                }
            }
            Span::Turn { shape, length, speed } => {
                let (turned, first, second) = shape.heading(share);
                let (local, d) = (shape.position(share) * *length, self.start.direction);
                let moved = Vector2::new(d.x * local.x - d.y * local.y, d.y * local.x + d.x * local.y);
                MotionState2d {
                    position: self.start.position + moved,
                    speed: *speed,
                    turn_rate: first * speed / length,
                    turn_acceleration: second * (speed / length) * (speed / length),
                    travelled: self.start.travelled + length * share,
                    ..still.turned(turned)
                }
            }
        }
    }
}

impl MotionState2d {
    fn turned(&self, angle: f64) -> Self {
        let heading = self.heading + angle;
        let (sine, cosine) = libm::sincos(heading);
        Self { heading, direction: Vector2::new(cosine, sine), ..*self }
    }

    /// Pose of the robot in the map.
    pub fn map_from_base(&self) -> Rigid3 {
        let (sine, cosine) = libm::sincos(0.5 * self.heading);
        let rotation = Quaternion::new_unchecked(na::Quaternion::new(cosine, 0.0, 0.0, sine));
        Rigid3::from_parts(na::Translation3::new(self.position.x, self.position.y, 0.0), rotation)
    }
}

impl Motion for Walk {
    fn duration(&self) -> f64 {
        self.end_time
    }

    fn state(&self, time: f64) -> MotionState {
        let s = self.state_2d(time);
        let (d, left) = (s.direction, Vector2::new(-s.direction.y, s.direction.x));
        let velocity = d * s.speed;
        let acceleration = d * s.acceleration + left * (s.speed * s.turn_rate);
        MotionState {
            map_from_base: s.map_from_base(),
            velocity_in_map: Vector3::new(velocity.x, velocity.y, 0.0),
            acceleration_in_map: Vector3::new(acceleration.x, acceleration.y, 0.0),
            angular_velocity_in_base: Vector3::new(0.0, 0.0, s.turn_rate),
            angular_acceleration_in_base: Vector3::new(0.0, 0.0, s.turn_acceleration),
        }
    }
}

impl Rolling for Walk {
    fn rolled(&self, time: f64) -> (f64, f64) {
        let state = self.state_2d(time);
        (state.travelled, state.heading)
    }
}
