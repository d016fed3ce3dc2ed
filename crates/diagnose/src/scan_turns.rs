//! Estimates the rotation of a lidar from scan to scan from the shift of its range profile.

use portolan_geometry::Time;
use portolan_geometry::nalgebra::{Matrix3, Vector3};
use portolan_ingest::TimedPoints;
use portolan_recording::LaserScan;

use crate::rotation::Turn;

/// Maximum number of beams of a profile; scans with more are thinned.
const MAX_BEAMS: usize = 360;
/// Largest rotation between two scans, radians.
const MAX_TURN: f32 = 0.6;
/// Difference of ranges above which all count alike, metres.
const MAX_DIFFERENCE: f32 = 0.3;
/// Fraction of the beams with readings, of the scan that has fewer of them, that must be seen by both scans.
const MIN_OVERLAP: f32 = 0.3;
/// Minimum number of beams for a comparison.
const FEWEST: f32 = 10.0;
/// Maximum number of scans that are compared.
const MAX_SCANS: usize = 20_000;
/// Interval between scans above which they are not compared, seconds.
const MAX_INTERVAL: f64 = 1.0;

/// Number of cells of the profile of a spinning lidar: one for each degree.
const CELLS: usize = 360;
/// Maximum slope of the points of a cloud that enter its profile; dimensionless.
const STEEPEST: f32 = 0.12;

/// Rotations of a scanner.
#[derive(Debug, Default)]
pub(crate) struct ScanTurns {
    last: Option<(Time, Vec<f32>)>,
    costs: Vec<f32>,
    pub turns: Vec<Turn>,
}

impl ScanTurns {
    /// Takes the next scan. Only scans of the same shape are compared.
    pub fn add(&mut self, time: Time, scan: &LaserScan) {
        let stride = scan.ranges.len().div_ceil(MAX_BEAMS).max(1);
        let increment = scan.angle_increment.abs() * stride as f32;
        if self.turns.len() >= MAX_SCANS || increment.is_nan() || increment <= 0.0 {
            return;
        }
        let limits = scan.range_min.max(0.05)..=scan.range_max;
        let value = |r: &f32| if limits.contains(r) { *r } else { f32::NAN };
        let profile: Vec<f32> = scan.ranges.iter().step_by(stride).map(value).collect();
        if let Some((last_time, last)) = self.last.replace((time, profile))
            && (0.0..MAX_INTERVAL).contains(&time.seconds_since(last_time))
            && let Some((_, profile)) = &self.last
            && last.len() == profile.len()
        {
            let window = ((MAX_TURN / increment) as usize).min(profile.len() / 3);
            if let Some(shift) = best_shift(&last, profile, window, &mut self.costs) {
                // Walls move opposite to the rotation; a negative increment counts beams clockwise.
                let turn = -f64::from(shift * increment) * f64::from(scan.angle_increment.signum());
                self.turns.push((last_time, time, turn));
            }
        }
    }
}

/// Shift of `now` against `before` in beams, with a fraction.
fn best_shift(before: &[f32], now: &[f32], window: usize, costs: &mut Vec<f32>) -> Option<f32> {
    costs.clear();
    let enough = enough(before, now);
    for shift in 0..=2 * window {
        let (a, b) =
            if shift <= window { (&before[window - shift..], now) } else { (before, &now[shift - window..]) };
        costs.push(cost(a.iter(), b.iter(), enough));
    }
    Some(lowest(costs)? - window as f32)
}

/// Rotations of a spinning lidar about its own axis, from its beams near the horizontal.
#[derive(Debug, Default)]
pub(crate) struct CloudTurns {
    last: Option<(Time, Profile)>,
    costs: Vec<f32>,
    pub turns: Vec<Turn>,
    /// Whether points have times; without, it is not known when within a revolution of the head they were measured.
    pub has_times: bool,
}

impl CloudTurns {
    /// Takes the next cloud, in the frame of its sensor.
    pub fn add(&mut self, cloud: &TimedPoints) {
        let Some(first) = cloud.points.first().filter(|_| self.turns.len() < MAX_SCANS) else { return };
        self.has_times |= first.time < 0.0;
        let profile = profile(cloud);
        if let Some((last_time, last)) = self.last.replace((cloud.time, profile))
            && (0.0..MAX_INTERVAL).contains(&cloud.time.seconds_since(last_time))
            && let Some((_, profile)) = &self.last
            && let Some(found) = best_turn(&last, profile, &mut self.costs)
        {
            let middle = 0.5 * first.time;
            let [before, now] = found
                .offsets
                .unwrap_or([middle; 2])
                .map(|offset| portolan_geometry::Duration::from_seconds(f64::from(offset)));
            self.turns.push((last_time + before, cloud.time + now, f64::from(found.turn)));
        }
    }
}

/// Range profile of a sweep, degree by degree.
#[derive(Debug)]
struct Profile {
    /// Horizontal range of the most level point in each direction; NaN where there is none.
    ranges: Vec<f32>,
    /// Times at which these were measured, seconds before the time of the cloud (not positive).
    offsets: Vec<f32>,
}

/// Rotation of the sensor between two sweeps.
struct FoundTurn {
    turn: f32,
    /// Mean times at which the constraining points were measured in the sweep before and in this one, if
    /// known: walls on one side are seen at one time in each revolution of the head.
    offsets: Option<[f32; 2]>,
}

fn profile(cloud: &TimedPoints) -> Profile {
    let mut cells = vec![(f32::INFINITY, f32::NAN, 0.0); CELLS];
    for point in &cloud.points {
        let [x, y, z] = point.position.coords.into();
        let range = x.hypot(y);
        let slope = z.abs() / range;
        let share = y.atan2(x) / std::f32::consts::TAU + 0.5;
        let Some(cell) = cells.get_mut((share * CELLS as f32) as usize) else { continue };
        if slope < STEEPEST && slope < cell.0 {
            *cell = (slope, range, point.time);
        }
    }
    let (ranges, offsets) = cells.into_iter().map(|(_, range, offset)| (range, offset)).unzip();
    Profile { ranges, offsets }
}

/// Rotation of the sensor, counter-clockwise, radians.
fn best_turn(before: &Profile, now: &Profile, costs: &mut Vec<f32>) -> Option<FoundTurn> {
    let cell = std::f32::consts::TAU / CELLS as f32;
    let window = (MAX_TURN / cell) as usize;
    let enough = enough(&before.ranges, &now.ranges);
    costs.clear();
    for shift in 0..=2 * window {
        // Points seen at the rotation angle before are seen straight ahead after the rotation.
        let (a, b) = before.ranges.split_at((CELLS + shift - window) % CELLS);
        costs.push(cost(b.iter().chain(a), now.ranges.iter(), enough));
    }
    let turn = (lowest(costs)? - window as f32) * cell;
    Some(turn_and_shift(before, now, turn).unwrap_or(FoundTurn { turn, offsets: None }))
}

/// Maximum difference of a range in each iteration, metres. The iterations separate the translation of the
/// sensor from its rotation.
const PASSES: [f32; 4] = [0.5, 0.3, 0.15, 0.15];
/// Difference of the ranges of neighbouring cells above which they belong to different surfaces, metres.
const EDGE: f32 = 0.4;

/// Estimates the rotation again, together with the translation of the sensor in its plane: near walls, a
/// translation looks like a rotation.
///
/// A surface whose range grows by `slope` times itself for each radian comes nearer by
/// `x (cos + slope sin) + y (sin - slope cos)` if the sensor shifts by (x, y), and moves away by `slope` times
/// its range for each radian of rotation. The three unknowns are found by least squares.
fn turn_and_shift(before: &Profile, now: &Profile, mut turn: f32) -> Option<FoundTurn> {
    let cell = std::f32::consts::TAU / CELLS as f32;
    let mut shift = [0.0_f32; 2];
    let mut offsets = None;
    for most in PASSES {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        let mut count = 0.0_f32;
        // Sum of the weights of directions (their information about the rotation), and of weight times
        // measurement time.
        let mut sums = [0.0_f32; 3];
        for (i, range) in now.ranges.iter().enumerate() {
            let at = (i as f32 + turn / cell).rem_euclid(CELLS as f32);
            let (index, share) = (at as usize % CELLS, at.fract());
            let (a, b) = (before.ranges[index], before.ranges[(index + 1) % CELLS]);
            let slope = (b - a) / (cell * a);
            let (s, c) = ((i as f32 + 0.5) * cell - std::f32::consts::PI).sin_cos();
            let row = [slope * a, -(c + slope * s), -(s - slope * c)];
            let expected = a + (b - a) * share + row[1] * shift[0] + row[2] * shift[1];
            let difference = range - expected;
            // NaN where a range is missing.
            if !(difference.abs() < most && (b - a).abs() < EDGE) {
                continue;
            }
            let weight = row[0] * row[0];
            sums = [
                sums[0] + weight,
                sums[1] + weight * before.offsets[index],
                sums[2] + weight * now.offsets[i],
            ];
            let row = Vector3::new(row[0], row[1], row[2]).map(f64::from);
            normal += row * row.transpose();
            right += row * f64::from(difference);
            count += 1.0;
        }
        if count < enough(&before.ranges, &now.ranges) {
            return None;
        }
        // Along a bare corridor the translation is not constrained; it is then taken as zero.
        normal[(1, 1)] += f64::from(1e-3 * count);
        normal[(2, 2)] += f64::from(1e-3 * count);
        let change = normal.cholesky()?.solve(&right);
        turn += change.x as f32;
        offsets = (sums[0] > 0.0).then(|| [sums[1] / sums[0], sums[2] / sums[0]]);
        shift = [shift[0] + change.y as f32, shift[1] + change.z as f32];
    }
    (turn.abs() < MAX_TURN).then_some(FoundTurn { turn, offsets })
}

/// Minimum number of beams that both scans see.
fn enough(before: &[f32], now: &[f32]) -> f32 {
    let seen = |profile: &[f32]| profile.iter().filter(|range| range.is_finite()).count() as f32;
    (MIN_OVERLAP * seen(before).min(seen(now))).max(FEWEST)
}

/// Mean difference of two profiles.
fn cost<'a>(before: impl Iterator<Item = &'a f32>, now: impl Iterator<Item = &'a f32>, enough: f32) -> f32 {
    let (mut sum, mut count) = (0.0f32, 0.0f32);
    for (a, b) in before.zip(now) {
        let difference = (a - b).abs();
        if !difference.is_nan() {
            sum += difference.min(MAX_DIFFERENCE);
            count += 1.0;
        }
    }
    if count >= enough { sum / count } else { f32::INFINITY }
}

/// Position of the lowest cost, with a fraction; none at the edge of the compared shifts, or if nothing
/// fits.
fn lowest(costs: &[f32]) -> Option<f32> {
    let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
    if best == 0 || best + 1 >= costs.len() || !costs[best].is_finite() || costs[best] > 0.5 * MAX_DIFFERENCE
    {
        return None;
    }
    let (left, middle, right) = (costs[best - 1], costs[best], costs[best + 1]);
    if !(left.is_finite() && right.is_finite()) {
        return None;
    }
    let curvature = left - 2.0 * middle + right;
    let fraction = if curvature > 0.0 { 0.5 * (left - right) / curvature } else { 0.0 };
    Some(best as f32 + fraction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotation::compare;
    use crate::rotation::tests::{at, heading, turns};
    use portolan_geometry::Point3f;
    use portolan_recording::Header;
    use portolan_sensor::TimedPoint;

    /// Compares the rotations of a robot in a room with those from its scans, where this number of beams of
    /// half a degree see anything.
    fn agreement(beams: std::ops::Range<i32>) -> crate::rotation::Agreement {
        // A room of 8 m by 5 m, seen from (1, 0.5).
        let range = |angle: f64| {
            let (s, c) = angle.sin_cos();
            let x = if c > 0.0 { 3.0 / c } else { -5.0 / c };
            let y = if s > 0.0 { 2.0 / s } else { -3.0 / s };
            x.min(y)
        };
        let mut scans = ScanTurns::default();
        for i in 0..100 {
            let t = 0.2 * f64::from(i);
            let beam = |k: i32| heading(t) + (-90.0 + 0.5 * f64::from(k)).to_radians();
            let seen = |k| if beams.contains(&k) { range(beam(k)) as f32 } else { f32::INFINITY };
            let scan = LaserScan {
                header: Header { stamp: at(t), frame_id: "laser".into() },
                angle_min: -std::f32::consts::FRAC_PI_2,
                angle_max: std::f32::consts::FRAC_PI_2,
                angle_increment: 0.5f32.to_radians(),
                time_increment: 0.0,
                scan_time: 0.0,
                range_min: 0.0,
                range_max: 30.0,
                ranges: (0..360).map(seen).collect(),
                intensities: Vec::new(),
            };
            scans.add(at(t), &scan);
        }
        compare(&turns(0.0, 1.0, 0.05), &scans.turns).unwrap()
    }

    #[test]
    fn rotations_follow_from_scans_in_a_room() {
        let all_around = agreement(0..360);
        assert!((all_around.slope - 1.0).abs() < 0.02 && all_around.lag.abs() < 0.03, "{all_around:?}");
    }

    #[test]
    fn rotations_follow_from_scans_of_60_degrees() {
        let ahead = agreement(120..240);
        assert!((ahead.slope - 1.0).abs() < 0.05 && ahead.lag.abs() < 0.03, "{ahead:?}");
    }

    #[test]
    fn rotations_and_clock_offset_follow_from_clouds() {
        let mut clouds = CloudTurns::default();
        for i in 0..500 {
            let begin = 0.1 * f64::from(i);
            let points = (0..720).map(|k| {
                let time = 0.1 * f64::from(k) / 720.0;
                let azimuth = std::f64::consts::TAU * f64::from(k) / 720.0;
                let (s, c) = (azimuth + heading(begin + time)).sin_cos();
                let x = if c > 0.0 { 3.0 / c } else { -5.0 / c };
                let range = x.min(if s > 0.0 { 2.0 / s } else { -3.0 / s });
                let position =
                    Point3f::new((range * azimuth.cos()) as f32, (range * azimuth.sin()) as f32, 0.1);
                TimedPoint { position, time: (time - 0.1) as f32 }
            });
            clouds.add(&TimedPoints {
                time: at(begin + 0.1),
                points: points.collect(),
                intensities: Vec::new(),
            });
        }
        assert!(clouds.has_times);
        for delay in [0.0, 0.05, -0.05] {
            let agreement = compare(&turns(delay, 1.0, 0.01), &clouds.turns).unwrap();
            assert!((agreement.slope - 1.0).abs() < 0.03, "{agreement:?}");
            assert!((agreement.lag + delay).abs() < 0.008, "{delay}: {agreement:?}");
        }
    }
}
