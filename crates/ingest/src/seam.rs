//! Whether clouds without times of points had the motion of their sensor taken out already.
//!
//! A turn of a spinning lidar ends where it began. If the sensor moved meanwhile, a raw cloud has a step there,
//! because its two ends were seen from different places, and the end of one cloud fits to the beginning of the
//! next one, which was seen right after it. A cloud whose motion was taken out fits together with itself, and
//! not with the next one. Beams near that seam vote; a sensor that stands gets no votes.

use std::f32::consts::{PI, TAU};

use portolan_geometry::Point3f;

/// Rows of elevation, a degree each, the lowest first.
const ROWS: usize = 60;
const LOWEST_DEGREES: f32 = -40.0;
/// Cells on either side of the seam, a degree each, beyond the first one: beams do not all begin at the same
/// azimuth.
const CELLS: usize = 5;
const SKIPPED_DEGREES: f32 = 1.0;
/// A row votes if one of the two fits is so much worse than the other …
const RATIO: f32 = 1.5;
/// … and worse than noise, metres.
const NOISE: f32 = 0.03;
/// So many votes, and such a majority, decide.
const ENOUGH_VOTES: u64 = 40;
const MAJORITY: f64 = 0.65;
/// Neighbouring points farther apart than this are of other beams, radians.
const SAME_TURN: f32 = 0.1;

/// Ranges near the seam, one row for each elevation; NaN where nothing was seen.
type Side = [[f32; CELLS]; ROWS];

/// Votes of clouds.
#[derive(Clone, Debug, Default)]
pub(crate) struct SeamVotes {
    last_end: Option<Box<Side>>,
    last_start: Option<Box<Side>>,
    fits_itself: u64,
    fits_next: u64,
}

impl SeamVotes {
    /// Takes the points of the next cloud, in its order.
    pub fn add(&mut self, points: &[Point3f]) {
        let Some((start, end)) = sides(points) else { return };
        if let (Some(last_start), Some(last_end)) = (&self.last_start, &self.last_end) {
            for row in 0..ROWS {
                let (itself, next) =
                    (misfit(&last_end[row], &last_start[row]), misfit(&last_end[row], &start[row]));
                if let (Some(itself), Some(next)) = (itself, next) {
                    self.fits_itself += u64::from(next > NOISE && next > RATIO * itself);
                    self.fits_next += u64::from(itself > NOISE && itself > RATIO * next);
                }
            }
        }
        (self.last_start, self.last_end) = (Some(start), Some(end));
    }

    /// Whether motion was taken out; none as long as that cannot be told.
    pub fn is_compensated(&self) -> Option<bool> {
        let votes = self.fits_itself + self.fits_next;
        let share = self.fits_itself as f64 / votes.max(1) as f64;
        let is_clear = votes >= ENOUGH_VOTES && (share - 0.5).abs() >= MAJORITY - 0.5;
        is_clear.then_some(share > 0.5)
    }
}

/// The way in which azimuths of neighbouring points go most often: 1 counter-clockwise, −1 clockwise.
pub(super) fn sense_of_turn<'a>(points: impl Iterator<Item = &'a Point3f>) -> f32 {
    let (mut forward, mut last) = (0_i64, None);
    for azimuth in points.map(|p| p.y.atan2(p.x)) {
        let step = last.replace(azimuth).map_or(0.0, |last| wrapped(azimuth - last));
        // Larger steps are between rings, or gaps.
        if step.abs() < SAME_TURN {
            forward += if step > 0.0 { 1 } else { -i64::from(step < 0.0) };
        }
    }
    if forward >= 0 { 1.0 } else { -1.0 }
}

pub(super) fn wrapped(angle: f32) -> f32 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// What lies after the beginning and before the end of a turn; both count cells away from the seam.
fn sides(points: &[Point3f]) -> Option<(Box<Side>, Box<Side>)> {
    let first = points.iter().find(|p| p.coords.norm_squared() > 0.0)?;
    let (begin, sense) = (first.y.atan2(first.x), sense_of_turn(points.iter()));
    let mut start: Box<Side> = Box::new([[f32::NAN; CELLS]; ROWS]);
    let mut end = start.clone();
    for point in points {
        let range = point.coords.norm();
        let degrees = (sense * wrapped(point.y.atan2(point.x) - begin)).to_degrees();
        let row = (point.z / range).asin().to_degrees() - LOWEST_DEGREES;
        let cell = degrees.abs() - SKIPPED_DEGREES;
        if !(row >= 0.0 && cell >= 0.0) {
            continue;
        }
        let side = if degrees > 0.0 { &mut start } else { &mut end };
        if let Some(value) = side.get_mut(row as usize).and_then(|r| r.get_mut(cell as usize)) {
            // Of several points the nearest, whatever their order.
            *value = value.min(range);
        }
    }
    Some((start, end))
}

/// Root mean square of what is left of the ranges on both sides after a parabola through all of them; none if
/// some are missing.
fn misfit(end: &[f32; CELLS], start: &[f32; CELLS]) -> Option<f32> {
    let at = |cell: usize| SKIPPED_DEGREES + 0.5 + cell as f32;
    let ends = end.iter().enumerate().map(|(i, r)| (-at(i), *r));
    let samples = ends.chain(start.iter().enumerate().map(|(i, r)| (at(i), *r)));
    // Positions are symmetric, so odd and even parts of the parabola are independent.
    let (mut s0, mut s2, mut s4, mut y0, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (x, y) in samples.clone() {
        if y.is_nan() {
            return None;
        }
        let (x, y) = (f64::from(x), f64::from(y));
        (s0, s2, s4) = (s0 + 1.0, s2 + x * x, s4 + x.powi(4));
        (y0, y1, y2) = (y0 + y, y1 + x * y, y2 + x * x * y);
    }
    let slope = y1 / s2;
    let curve = (s0 * y2 - s2 * y0) / (s0 * s4 - s2 * s2);
    let level = (y0 - curve * s2) / s0;
    let square = |(x, y): (f32, f32)| {
        let x = f64::from(x);
        (f64::from(y) - level - slope * x - curve * x * x).powi(2)
    };
    Some((samples.map(square).sum::<f64>() / s0).sqrt() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A turn from behind, clockwise, in a street of 8 m width, driving along it at a slant; raw or with the
    /// motion taken out.
    fn turn(index: usize, speed: f32, is_raw: bool) -> Vec<Point3f> {
        let mut points = Vec::new();
        for row in -15..15 {
            for column in 0..720 {
                let share = column as f32 / 720.0;
                let azimuth = -PI + 0.05 - share * TAU;
                let time = if is_raw { index as f32 + share } else { index as f32 };
                let (s, c) = azimuth.sin_cos();
                let side = speed * 0.1 * time;
                let wall = if s > 0.0 { (4.0 - side) / s } else { (-4.0 - side) / s };
                let ahead = if c > 0.0 { (30.0 - side) / c } else { (-12.0 - side) / c };
                let distance = wall.min(ahead);
                points.push(Point3f::new(
                    c * distance,
                    s * distance,
                    distance * (row as f32 + 0.5).to_radians().tan(),
                ));
            }
        }
        points
    }

    #[test]
    fn seams_tell_whether_motion_was_taken_out() {
        for (speed, is_raw, expected) in
            [(5.0, true, Some(false)), (5.0, false, Some(true)), (0.0, true, None), (0.0, false, None)]
        {
            let mut votes = SeamVotes::default();
            (0..15).for_each(|i| votes.add(&turn(i, speed, is_raw)));
            let found = (votes.fits_itself, votes.fits_next);
            assert_eq!(votes.is_compensated(), expected, "{speed} {is_raw} {found:?}");
        }
    }

    #[test]
    fn clouds_of_any_kind_do_no_harm() {
        let mut votes = SeamVotes::default();
        for points in
            [vec![], vec![Point3f::origin(); 3], vec![Point3f::new(f32::NAN, 1.0, f32::INFINITY); 9]]
        {
            votes.add(&points);
        }
        assert_eq!(votes.is_compensated(), None);
    }
}
