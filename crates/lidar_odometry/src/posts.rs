//! Trunks, poles, corners: what stands over the ground.
//!
//! Among trees hardly anything but the ground is flat, and planes of the rings in which beams meet it move with the
//! scanner. Where nothing measures how it goes, points of what stands are brought to the nearest ones of the sweeps
//! before, too (point to point, as Vizzo et al., "KISS-ICP: In Defense of Point-to-Point ICP", 2023), horizontally
//! alone: neighbouring beams meet a trunk at different heights. Where they stand in a row, as on a wall, they tell
//! nothing along it: nearest points are as near there wherever the scanner is (Segal, Haehnel and Thrun,
//! "Generalized-ICP", 2009, express that by covariances).

use nalgebra as na;
use portolan_geometry::{Point3f, Quaternion};
use portolan_sensor::voxel_filter_indices;

use crate::matcher::sums::{Accumulator, POINTS_PER_INDEPENDENT_ONE};
use crate::matcher::{Part, SweptPoint, parts_of};
use crate::way::{StraightPieces, Way};
use portolan_matching::grid::LeafIndex;

/// Edge of the columns that are compared with the height of what is in them, metres.
const COLUMN: f32 = 0.5;
/// What stands reaches so high in its column, metres; ground at 45° does not.
const HEIGHT: f32 = 0.5;
/// The ground around what stands reaches so high, metres.
const FOOT: f32 = 0.3;
/// Spacing of the points, metres.
const SPACING: f32 = 0.2;
/// So many points at most, evenly in time: more outweigh planes, which are known far better. With all 11 500 of a street
/// seen by 64 beams it came out 0.053 m off instead of 0.032. Where all together weigh no more than 500, one of six
/// walks among trees was 1 m off.
const MOST_POINTS: usize = 1000;
/// What is seen in three by three cells of this edge (metres) is a row if it spreads so far, metres (standard
/// deviation), and so many times farther than across.
const NEIGHBOURHOOD: f32 = 0.35;
const LONG: f32 = 0.15;
const LONG_AND_NARROW: f32 = 3.0;
/// Points farther off than this are not paired, metres.
const REACH: f32 = 0.4;
/// Differences of height count so much when the nearest point is looked for.
const HEIGHT_SHARE: f32 = 0.5;
/// The scale of the loss at the end, and the noise of pairs: both have met the same trunk, not the same spot, metres.
const FINAL_SCALE: f64 = 0.2;
const NOISE: f32 = 0.1;
/// Points that moved farther are paired anew, metres.
const SLACK: f32 = 0.02;

/// A point of something that stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PostPoint {
    /// As it was measured.
    pub swept: SweptPoint,
    /// The direction of the row in which it stands, a unit vector in the frame of the scanner; none if what is seen
    /// there is as wide as it is long.
    pub row: Option<na::Vector3<f32>>,
}

impl PostPoint {
    /// Points of what stands, in the order of their times, of a sweep that comes to its end by `to_end`.
    pub fn of_sweep(
        sweep: impl Iterator<Item = SweptPoint>,
        to_end: &StraightPieces,
        level_from_end: &Quaternion,
    ) -> Vec<Self> {
        let turn = level_from_end.cast::<f32>();
        let leveled = |p: SweptPoint| (p, turn * to_end.moved(&p.position, p.offset));
        let all: Vec<(SweptPoint, Point3f)> = sweep.map(leveled).collect();
        let standing = over_others(&all);
        let rows = Rows::of(&standing);
        let back = turn.inverse();
        let kept = voxel_filter_indices(&standing, |(_, place)| *place, SPACING).into_iter();
        let point = |(swept, place): &(SweptPoint, Point3f)| {
            let row = rows.along(place).map(|d| back * na::Vector3::new(d.x, d.y, 0.0));
            Self { swept: *swept, row }
        };
        let mut points: Vec<&(SweptPoint, Point3f)> = kept.filter_map(|i| standing.get(i as usize)).collect();
        points.sort_by(|(a, _), (b, _)| a.offset.total_cmp(&b.offset));
        let number = points.len().min(MOST_POINTS);
        (0..number).map(|i| point(points[i * points.len() / number])).collect()
    }
}

/// Those points that lie over others of their column.
fn over_others(all: &[(SweptPoint, Point3f)]) -> Vec<(SweptPoint, Point3f)> {
    let mut columns = Cells::new(COLUMN, [f32::INFINITY, f32::NEG_INFINITY]);
    for (_, place) in all {
        let [lowest, highest] = columns.at_mut(columns.horizontal(place));
        (*lowest, *highest) = (lowest.min(place.z), highest.max(place.z));
    }
    let stands = |(_, place): &&(SweptPoint, Point3f)| {
        let column = columns.at(columns.horizontal(place));
        column.is_some_and(|[lowest, highest]| highest - lowest > HEIGHT && place.z > lowest + FOOT)
    };
    all.iter().filter(stands).copied().collect()
}

/// The key of a cell by twelve bits of each index: cells kilometres apart may share one.
fn key_of(cell: [i32; 3]) -> u64 {
    cell.iter().fold(0, |key, index| key << 12 | (*index as u64 & 0xfff))
}

/// Values of cells that are made when they are needed.
#[derive(Clone, Debug)]
struct Cells<T> {
    edge: f32,
    index: LeafIndex,
    values: Vec<T>,
    empty: T,
}

impl<T: Clone> Cells<T> {
    fn new(edge: f32, empty: T) -> Self {
        Self { edge, index: LeafIndex::with_capacity(0), values: Vec::new(), empty }
    }

    /// Indices of the cell around a point.
    fn around(&self, place: &Point3f) -> [i32; 3] {
        [place.x, place.y, place.z].map(|v| (v / self.edge).floor() as i32)
    }

    /// The key of the column around a point.
    fn horizontal(&self, place: &Point3f) -> u64 {
        let [x, y, _] = self.around(place);
        key_of([x, y, 0])
    }

    fn at(&self, key: u64) -> Option<&T> {
        self.values.get(self.index.get(key)?)
    }

    fn at_mut(&mut self, key: u64) -> &mut T {
        let number = self.index.get(key).unwrap_or_else(|| {
            self.index.insert(key, self.values.len());
            self.values.push(self.empty.clone());
            self.values.len() - 1
        });
        &mut self.values[number]
    }
}

/// How many points a cell has, their sum and the sum of their outer products.
type Moments = (f32, na::Vector2<f32>, na::Matrix2<f32>);

/// How points spread horizontally.
struct Rows(Cells<Moments>);

impl Rows {
    fn of(points: &[(SweptPoint, Point3f)]) -> Self {
        let mut cells = Cells::new(NEIGHBOURHOOD, Moments::default());
        for (_, place) in points {
            let (count, sum, products) = cells.at_mut(cells.horizontal(place));
            *count += 1.0;
            *sum += place.coords.xy();
            *products += place.coords.xy() * place.coords.xy().transpose();
        }
        Self(cells)
    }

    /// The direction of the row around a place, if there is one.
    fn along(&self, place: &Point3f) -> Option<na::Vector2<f32>> {
        let [x, y, _] = self.0.around(place);
        let around =
            (-1..=1).flat_map(|i| (-1..=1).map(move |j| [x.saturating_add(i), y.saturating_add(j), 0]));
        let cells = around.filter_map(|cell| self.0.at(key_of(cell)));
        let (count, sum, products) =
            cells.fold(Moments::default(), |all, cell| (all.0 + cell.0, all.1 + cell.1, all.2 + cell.2));
        let mean = sum / count;
        let eigen = na::SymmetricEigen::new(products / count - mean * mean.transpose());
        let (long, narrow) = (eigen.eigenvalues.imax(), eigen.eigenvalues.imin());
        let [long_variance, narrow_variance] = [long, narrow].map(|i| eigen.eigenvalues[i]);
        let is_row = long_variance > LONG * LONG
            && narrow_variance * LONG_AND_NARROW * LONG_AND_NARROW < long_variance;
        is_row.then(|| eigen.eigenvectors.column(long).into_owned())
    }
}

/// What stands around, by its points.
#[derive(Clone, Debug)]
pub struct PostMap {
    cells: Cells<Vec<na::Vector3<f32>>>,
}

impl PostMap {
    /// Of points in metres, in a frame whose z axis points up.
    pub fn new(points: impl Iterator<Item = Point3f>) -> Self {
        let mut cells = Cells::new(2.0 * REACH, Vec::new());
        for point in points {
            let cell = cells.around(&point);
            cells.at_mut(key_of(cell)).push(point.coords);
        }
        Self { cells }
    }

    /// The nearest point that is near enough.
    fn nearest(&self, place: &na::Vector3<f32>) -> Option<na::Vector3<f32>> {
        let cell = self.cells.around(&Point3f::from(*place));
        // What is near enough lies in this cell or in the neighbours across its nearest sides.
        let side = |axis: usize| {
            let share = place[axis] / self.cells.edge - cell[axis] as f32;
            cell[axis].saturating_add(if share > 0.5 { 1 } else { -1 })
        };
        let [x, y, z] = [0, 1, 2].map(|axis| [cell[axis], side(axis)]);
        let (mut nearest, mut least) = (None, REACH * REACH);
        for i in 0..8 {
            let key = key_of([x[i & 1], y[i >> 1 & 1], z[i >> 2]]);
            for point in self.cells.at(key).into_iter().flatten() {
                let off = point - place;
                let squared = off.xy().norm_squared() + HEIGHT_SHARE * off.z * off.z;
                if squared < least {
                    (nearest, least) = (Some(*point), squared);
                }
            }
        }
        nearest
    }
}

/// A point that was paired: where it was then, and what was nearest.
#[derive(Clone, Copy)]
struct Pair {
    looked_up_at: na::Vector3<f32>,
    nearest: Option<na::Vector3<f32>>,
}

/// Points of what stands in a sweep, and what they belong to.
pub(super) struct Posts<'a> {
    map: &'a PostMap,
    points: &'a [PostPoint],
    parts: Vec<Part>,
    pairs: Vec<Pair>,
}

impl<'a> Posts<'a> {
    pub fn new(map: &'a PostMap, points: &'a [PostPoint], way: &Way) -> Self {
        let nowhere = Pair { looked_up_at: na::Vector3::repeat(f32::INFINITY), nearest: None };
        let parts = parts_of(points, |p| p.swept.offset, way);
        Self { map, points, parts, pairs: vec![nowhere; points.len()] }
    }

    /// Adds what they say on a way. What they say of shifts and turns alone: `JᵀWJ` of both.
    pub fn add_to(
        &mut self,
        all: &mut Accumulator,
        way: &StraightPieces,
        scale: f64,
    ) -> [na::Matrix3<f64>; 2] {
        let mut told = [na::Matrix3::<f32>::zeros(); 2];
        let squared_scale = scale.max(FINAL_SCALE).powi(2) as f32;
        for part in &self.parts {
            for i in part.points.clone() {
                let (PostPoint { swept, row }, pair) = (&self.points[i], &mut self.pairs[i]);
                let (turned, from) = way.seen(&swept.position, swept.offset);
                let place = turned + from;
                if (place - pair.looked_up_at).norm_squared() > SLACK * SLACK {
                    *pair = Pair { looked_up_at: place, nearest: self.map.nearest(&place) };
                }
                let Some(nearest) = pair.nearest else { continue };
                let off = place - nearest;
                let robust = squared_scale / (squared_scale + off.xy().norm_squared());
                let weight = robust * robust / (NOISE * NOISE);
                let row = row.map(|row| way.seen(&(swept.position + row), swept.offset).0 - turned);
                for direction in told_by(row).into_iter().flatten() {
                    let lever = turned.cross(&direction);
                    for (sum, v) in told.iter_mut().zip([direction, lever]) {
                        *sum += v * v.transpose() * weight;
                    }
                    let [n, l] = [direction, lever].map(|v| [v.x, v.y, v.z]);
                    all.add([n[0], n[1], n[2], l[0], l[1], l[2], direction.dot(&off), 0.0], weight, 0.0);
                }
            }
            all.end_part(part.bows);
        }
        told.map(|sum| sum.cast() / POINTS_PER_INDEPENDENT_ONE)
    }
}

/// The horizontal directions in which a point tells where it is: across the row in which it stands.
fn told_by(row: Option<na::Vector3<f32>>) -> [Option<na::Vector3<f32>>; 2] {
    match row {
        Some(row) => [na::Vector3::new(-row.y, row.x, 0.0).try_normalize(1e-3), None],
        None => [Some(na::Vector3::x()), Some(na::Vector3::y())],
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::TAU;

    use portolan_geometry::{Duration, Rigid3, Time};

    use super::*;
    use crate::testing::Lcg;
    use crate::{Sigmas, SurfaceMap, SurfaceMatcher, SurfaceMatcherOptions, WayCorrection, WayPrior};

    const TRUNKS: [[f32; 2]; 12] = [
        [6.0, 2.0],
        [-3.0, 7.0],
        [-8.0, -4.0],
        [5.0, -6.0],
        [9.0, 5.0],
        [-7.0, 3.0],
        [2.0, -9.0],
        [-4.0, -7.0],
        [11.0, -3.0],
        [3.0, 6.0],
        [-10.0, 1.0],
        [8.0, -8.0],
    ];

    /// What a scanner at `place` meets: the side of trunks that faces it, ground around it that meets its beams at the
    /// same distances wherever it is, and a wall at y = 9 if that is wanted.
    fn seen_from(place: &Point3f, with_wall: bool, lcg: &mut Lcg) -> Vec<SweptPoint> {
        let mut hits = Vec::new();
        for [x, y] in TRUNKS {
            let bearing = (place.y - y).atan2(place.x - x);
            for i in 0..40 {
                let angle = bearing + lcg.symmetric(1.2);
                let height = -0.9 + 0.5 * (i % 6) as f32;
                hits.push(Point3f::new(x + 0.2 * angle.cos(), y + 0.2 * angle.sin(), height));
            }
        }
        for i in 0..6000 {
            let ring = 2.0 + 0.2 * (i % 20) as f32;
            let (sin, cos) = (TAU * i as f32 / 6000.0).sin_cos();
            hits.push(Point3f::new(place.x + ring * cos, place.y + ring * sin, -1.0 + lcg.symmetric(0.01)));
        }
        if with_wall {
            let wall = |i: usize, lcg: &mut Lcg| Point3f::new(lcg.symmetric(6.0), 9.0, 0.4 * (i % 5) as f32);
            hits.extend((0..600).map(|i| wall(i, lcg)));
        }
        hits.iter().map(|hit| SweptPoint { offset: 0.0, position: Point3f::from(hit - place) }).collect()
    }

    /// As if the scanner stood at the origin.
    fn standing() -> Way {
        let start = Time::from_ticks(0);
        Way::new(start, start + Duration::from_seconds(0.1), |_| Rigid3::identity())
    }

    fn posts_of(sweep: &[SweptPoint]) -> Vec<PostPoint> {
        let to_end = standing().bent_to_end(&WayCorrection::default());
        PostPoint::of_sweep(sweep.iter().copied(), &to_end, &Quaternion::identity())
    }

    #[test]
    fn trunks_and_walls_stand_and_ground_does_not() {
        let posts = posts_of(&seen_from(&Point3f::origin(), true, &mut Lcg::new(1)));
        let (walls, trunks): (Vec<_>, Vec<_>) = posts.iter().partition(|p| p.swept.position.y > 8.5);
        let is_by_a_trunk = |p: &&&PostPoint| {
            TRUNKS.iter().any(|[x, y]| (p.swept.position.x - x).hypot(p.swept.position.y - y) < 0.21)
        };
        assert!(posts.iter().all(|p| p.swept.position.z > -0.8) && trunks.iter().all(|p| is_by_a_trunk(&p)));
        assert!(trunks.len() > 120 && trunks.iter().all(|p| p.row.is_none()), "{trunks:?}");
        let in_rows = walls.iter().filter(|p| p.row.is_some_and(|row| row.x.abs() > 0.99)).count();
        assert!(walls.len() > 100 && in_rows > walls.len() * 9 / 10, "{in_rows} of {}", walls.len());
    }

    #[test]
    fn sweeps_have_no_more_points_of_posts_than_are_needed() {
        let forest =
            (0..40_000).map(|i| Point3f::new((i % 40) as f32, (i / 40 % 40) as f32, (i / 1600) as f32));
        let sweep: Vec<SweptPoint> = forest.map(|position| SweptPoint { offset: 0.0, position }).collect();
        assert_eq!(posts_of(&sweep).len(), MOST_POINTS);
        assert_eq!(posts_of(&[]), []);
        let nowhere = Point3f::new(f32::NAN, f32::INFINITY, -1e30);
        assert_eq!(posts_of(&[SweptPoint { offset: 0.0, position: nowhere }; 9]), []);
    }

    #[test]
    fn who_leaves_among_trees_is_not_held_by_rings_on_the_ground() {
        let mut lcg = Lcg::new(2);
        let (first, went) = (seen_from(&Point3f::origin(), true, &mut lcg), Point3f::new(0.15, 0.05, 0.0));
        let mut surfaces = SurfaceMap::new(1.0);
        first.iter().for_each(|p| surfaces.insert(&p.position));
        let map = PostMap::new(posts_of(&first).iter().map(|p| p.swept.position));
        let second = seen_from(&went, true, &mut lcg);
        let points = posts_of(&second);
        let prior = WayPrior {
            start: Sigmas { shift: 0.01, turn: 0.01 },
            bend: Sigmas { shift: 0.3, turn: 0.05 },
            is_felt: false,
        };
        let ground: Vec<SweptPoint> =
            second.iter().filter(|p| p.position.z < -0.8).step_by(6).copied().collect();
        let matcher = SurfaceMatcher::new(SurfaceMatcherOptions::default());
        let off = |posts| {
            let found = matcher.match_sweep(&surfaces, &ground, &standing(), &prior, 0.3, posts).unwrap();
            (found.pose.translation.vector - went.coords.cast::<f64>()).norm()
        };
        let (by_posts, by_ground) = (off(Some((&map, &points[..]))), off(None));
        assert!(by_posts < 0.03 && by_ground > 0.1, "{by_posts} {by_ground}");
    }
}
