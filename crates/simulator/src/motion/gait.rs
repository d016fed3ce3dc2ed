//! Motion of a walker or a vehicle along an itinerary: corners are cut, and the body sways and bobs.

use portolan_geometry::Vector3;

use super::itinerary::Itinerary;
use super::smooth;
use super::spline::{Control, KNOT_SPACING, SplineMotion};
use portolan_worlds::Random;
use portolan_worlds::three_d::Scene3d;

/// Length of a step of a walker, metres.
const STEP: f64 = 0.72;
/// Speed below which a direction is not updated, m/s.
const SLOW: f64 = 0.08;
/// Speed at which the gait reaches its full amplitude, m/s.
const FULL_GAIT: f64 = 0.9;

/// Platform that carries the sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Carrier {
    /// A walker with the sensors on the back, who bobs and sways with every step.
    #[default]
    Walker,
    /// A vehicle on wheels: level, or pitched like the ground.
    Wheels,
}

impl Carrier {
    /// The default platform in a scene.
    pub fn usual_in(scene: Scene3d) -> Self {
        match scene {
            Scene3d::Museum => Self::Walker,
            _ => Self::Wheels,
        }
    }

    /// Standard deviations of the smoothing of positions and of yaw, seconds.
    fn smoothing(self) -> (f64, f64) {
        match self {
            Self::Walker => (0.33, 0.4),
            Self::Wheels => (0.55, 0.15),
        }
    }
}

/// A swaying motion: a sum of sines with random frequencies.
struct Sway(Vec<[f64; 3]>);

impl Sway {
    fn new(random: &mut Random, amplitude: f64, frequencies: [f64; 2]) -> Self {
        let mut sine = || {
            let omega = std::f64::consts::TAU * random.between(frequencies[0], frequencies[1]);
            [amplitude * random.between(0.3, 0.7), omega, random.between(0.0, std::f64::consts::TAU)]
        };
        Self((0..3).map(|_| sine()).collect())
    }

    fn at(&self, time: f64) -> f64 {
        self.0.iter().map(|[a, omega, phase]| a * libm::sin(omega * time + phase)).sum()
    }
}

/// Control points of the motion along an itinerary, with `base_link` at `height` above the ground.
/// `gait` scales bobbing and swaying; 0 is none.
pub(crate) fn motion_along(
    itinerary: &Itinerary,
    carrier: Carrier,
    height: f64,
    gait: f64,
    random: &mut Random,
) -> Option<SplineMotion> {
    let count = (itinerary.duration() / KNOT_SPACING).ceil() as usize + 1;
    let time = |k: usize| k as f64 * KNOT_SPACING;
    let places: Vec<_> = (0..count).map(|k| itinerary.place(time(k))).collect();
    let (position_smoothing, yaw_smoothing) = carrier.smoothing();
    let coordinate = |axis: usize| {
        let raw: Vec<f64> = places.iter().map(|place| place.position[axis]).collect();
        smoothed(&raw, position_smoothing)
    };
    let [x, y, z] = [coordinate(0), coordinate(1), coordinate(2)];
    let speeds: Vec<f64> = (0..count)
        .map(|k| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(count - 1));
            (places[b].walked - places[a].walked) / (time(b) - time(a)).max(KNOT_SPACING)
        })
        .collect();
    let yaws = smoothed(&directions(&x, &y, itinerary), yaw_smoothing);
    let shape = Shape { carrier, gait };
    let mut sways = shape.sways(random);
    let controls = (0..count).map(|k| {
        let swing = smooth::step((speeds[k] / FULL_GAIT).clamp(0.0, 1.0));
        let (before, after) = (k.saturating_sub(1), (k + 1).min(count - 1));
        let slope = slope([x[after] - x[before], y[after] - y[before], z[after] - z[before]]);
        let body = shape.body(places[k].walked, time(k), swing, slope, &mut sways);
        let (sine, cosine) = libm::sincos(yaws[k]);
        let offset =
            Vector3::new(body[0] * cosine - body[1] * sine, body[0] * sine + body[1] * cosine, body[2]);
        let [px, py, pz] = [x[k] + offset.x, y[k] + offset.y, z[k] + height + offset.z];
        [px, py, pz, body[3], body[4], yaws[k] + body[5]]
    });
    SplineMotion::new(controls.collect::<Vec<Control>>(), itinerary.duration())
}

/// Slope of the ground along the path; 0 at rest.
fn slope([dx, dy, dz]: [f64; 3]) -> f64 {
    let run = (dx * dx + dy * dy).sqrt();
    if run > SLOW * KNOT_SPACING { dz / run } else { 0.0 }
}

/// Heading of the path at each sample, radians, unwrapped; where the walk turns around, it rotates on the
/// spot.
fn directions(x: &[f64], y: &[f64], itinerary: &Itinerary) -> Vec<f64> {
    let count = x.len();
    let mut known: Vec<Option<f64>> = vec![None; count];
    let mut last: Option<f64> = None;
    for (k, slot) in known.iter_mut().enumerate() {
        let (a, b) = (k.saturating_sub(1), (k + 1).min(count - 1));
        let (dx, dy) = (x[b] - x[a], y[b] - y[a]);
        let moved = (dx * dx + dy * dy).sqrt();
        if moved < SLOW * KNOT_SPACING * (b - a).max(1) as f64 {
            continue;
        }
        let raw = libm::atan2(dy, dx);
        let unwrapped = last.map_or(raw, |l| l + wrapped(raw - l));
        (*slot, last) = (Some(unwrapped), Some(unwrapped));
    }
    let first = known.iter().flatten().next().copied().unwrap_or(0.0);
    let mut yaws = Vec::with_capacity(count);
    let mut held = first;
    for direction in &known {
        held = direction.unwrap_or(held);
        yaws.push(held);
    }
    // From the direction before to the direction after, smoothly.
    for (start, end) in itinerary.turns() {
        let (a, b) = ((start / KNOT_SPACING) as usize, (end / KNOT_SPACING) as usize);
        let from = yaws.get(a.saturating_sub(4)).copied().unwrap_or(first);
        let after = known.iter().skip(b).flatten().next().copied().unwrap_or(from);
        // The slow end and start of the strokes before and after belong to the turn.
        for k in a..count {
            let share = ((k as f64 * KNOT_SPACING - start) / (end - start)).clamp(0.0, 1.0);
            if k > b && known[k].is_some() {
                break;
            }
            yaws[k] = from + (after - from) * smooth::step(share);
        }
    }
    yaws
}

fn wrapped(angle: f64) -> f64 {
    portolan_geometry::normalize_angle(angle)
}

/// Smooths samples with a Gaussian; beyond the ends the first and the last sample are repeated.
fn smoothed(samples: &[f64], deviation: f64) -> Vec<f64> {
    let reach = (4.0 * deviation / KNOT_SPACING).ceil() as usize;
    let weight = |i: usize| {
        let d = (i as f64 - reach as f64) * KNOT_SPACING / deviation;
        libm::exp(-0.5 * d * d)
    };
    let weights: Vec<f64> = (0..=2 * reach).map(weight).collect();
    let total: f64 = weights.iter().sum();
    let last = samples.len().saturating_sub(1);
    let sum = |k: usize| -> f64 {
        weights.iter().enumerate().map(|(i, w)| w * samples[(k + i).saturating_sub(reach).min(last)]).sum()
    };
    (0..samples.len()).map(|k| sum(k) / total).collect()
}

/// Motion of the body relative to the path.
struct Shape {
    carrier: Carrier,
    gait: f64,
}

impl Shape {
    /// Swaying of x, y, z, roll, pitch and yaw.
    fn sways(&self, random: &mut Random) -> [Sway; 6] {
        let (amplitudes, frequencies) = match self.carrier {
            Carrier::Walker => ([0.006, 0.012, 0.004, 0.018, 0.022, 0.06], [0.08, 0.55]),
            Carrier::Wheels => ([0.0, 0.0, 0.001, 0.002, 0.002, 0.0], [0.7, 3.0]),
        };
        amplitudes.map(|amplitude| Sway::new(random, amplitude * self.gait, frequencies))
    }

    /// Offset of the body from the path: forward, left, up (metres), roll, pitch, yaw (radians).
    fn body(&self, walked: f64, time: f64, swing: f64, slope: f64, sways: &mut [Sway; 6]) -> Control {
        let share = match self.carrier {
            // A standing walker sways a little.
            Carrier::Walker => 0.12 + 0.88 * swing,
            Carrier::Wheels => swing,
        };
        let mut body = [0, 1, 2, 3, 4, 5].map(|i| share * sways[i].at(time));
        match self.carrier {
            Carrier::Walker => {
                let phase = std::f64::consts::TAU * walked / STEP;
                let amplitude = self.gait * swing;
                let ((one, other), (half, _)) = (libm::sincos(phase), libm::sincos(0.5 * phase));
                body[0] += 0.008 * amplitude * other;
                body[1] += 0.025 * amplitude * half;
                body[2] += 0.022 * amplitude * one;
                body[3] += 0.022 * amplitude * half;
                body[4] += 0.015 * amplitude * other;
                body[5] += 0.03 * amplitude * libm::cos(0.5 * phase);
            }
            Carrier::Wheels => body[4] -= libm::atan(slope),
        }
        body
    }
}
