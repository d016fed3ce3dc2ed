//! Place index of a 3D map: vertical structures projected onto the ground plane.

use std::collections::BTreeMap;

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid2, Rigid3, Vector2, Vector3, embed_3d, normalize_angle};
use portolan_grids::{CellIndex, Grid2d, GridError, MapLimits, ProbabilityGrid};
use portolan_matching::{
    FastCorrelativeMatcher2d, FastCorrelativeOptions2d, MatcherOptionError, PlaceIndex2d, SeveralPlaces,
    WantedPlaces,
};
use portolan_sensor::{PointCloud, voxel_filter_points};
use thiserror::Error;

use crate::ProposedPlaces;

/// Edge of a column, metres.
const COLUMN: f32 = 0.3;
/// Height of the slices of a column, metres.
const COLUMN_SLICE: f32 = 0.2;
/// Minimum number of occupied slices of an upright column of the map.
const UPRIGHT_IN_MAP: usize = 3;
/// Minimum number of slices with a point of an upright column of sparse scans.
const UPRIGHT_IN_SCANS: usize = 2;
/// Edge of the voxels to which columns of scans are thinned, metres.
const THINNED: f32 = 0.2;
/// Maximum number of columns of scans.
const MOST_COLUMNS: usize = 320;
/// Maximum number of cells of the projected grid: 1.2 km by 1.2 km; larger maps get larger cells.
const MAX_CELLS: f64 = (1 << 24) as f64;
/// Probability of a cell with an upright structure.
const STANDS: f32 = 0.9;
/// Half edge of the square around a cell, metres, in which the density of upright cells determines the
/// information of a hit.
const SURROUNDINGS: f64 = 6.0;
/// Maximum information of a hit, nats.
const MAX_INFORMATION: f64 = 3.0;
/// Proposals of the search of the projected grid: minimum score, and minimum fraction of the best score.
const PROPOSALS: SeveralPlaces = SeveralPlaces {
    min_score: 0.3,
    share_of_best: 0.7,
    separation: (1.0, 0.2),
    most: 24,
    lookups: 75_000_000,
};
/// Proposals of the search in which each column is weighted by its information: its score, as a fraction of
/// the maximum information of all points, is smaller.
const INFORMATIVE: WantedPlaces = WantedPlaces {
    min_score: 0.15,
    share_of_best: PROPOSALS.share_of_best,
    separation: PROPOSALS.separation,
    most: PROPOSALS.most,
    most_points: MOST_COLUMNS,
    beam: 65_536,
    lookups: 0,
};
/// Look-ups charged for both searches, whose look-ups are not counted: so that a walker who makes a node each
/// 0.15 m is searched once per metre. Charging the maximum of the first search would make that once in five
/// metres.
const CHARGED_LOOKUPS: u64 = 15_000_000;
/// Maximum distance from a place, metres, of nodes whose heights the scanner may have there.
const NODES_AROUND: f64 = 10.0;
/// Height difference from which nodes are on different storeys, metres.
const STOREY: f64 = 1.0;

/// Error of making an index of upright structures.
#[derive(Debug, Error)]
pub enum FromAboveError {
    /// There are no upright columns.
    #[error("nothing in the map stands upright")]
    Empty,
    /// A grid cannot be made.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A matcher cannot be made.
    #[error(transparent)]
    Matcher(#[from] MatcherOptionError),
}

/// Index of places of a 3D map by their upright structures.
pub struct SeenFromAbove {
    /// All columns have the same weight.
    alike: FastCorrelativeMatcher2d,
    /// Columns are weighted by their information.
    informative: PlaceIndex2d,
    /// Positions of nodes in the map, metres.
    nodes: Vec<Vector3>,
}

impl SeenFromAbove {
    /// From occupied points and the positions of nodes: metres in the map, whose z axis points up.
    ///
    /// # Errors
    /// If there are no upright columns, or the projected grid cannot be made.
    pub fn new(solid: impl Iterator<Item = Point3f>, nodes: Vec<Vector3>) -> Result<Self, FromAboveError> {
        let (picture, informative) = from_above(solid, &nodes)?;
        let alike = FastCorrelativeMatcher2d::new(&picture, &FastCorrelativeOptions2d::default())?;
        Ok(Self { alike, informative, nodes })
    }

    /// Poses at which the columns of scans fit, in an area (its middle, and metres to each side) or anywhere,
    /// at any heading, at the heights of the storeys there. Returns the best poses with equal weights of all
    /// columns, and the best with columns weighted by information. Most columns are where the map is dense,
    /// and the first search may never leave it. Poses are level.
    pub fn find(&self, columns: &PointCloud, area: Option<(&Vector2, f64)>) -> ProposedPlaces {
        let alike = || match area {
            Some((middle, metres)) => self.alike.match_several_within(columns, &PROPOSALS, middle, metres),
            None => self.alike.match_several(columns, &PROPOSALS),
        };
        let informative = || match area {
            Some((middle, metres)) => self.informative.find_within(columns, &INFORMATIVE, middle, metres),
            None => self.informative.find(columns, &INFORMATIVE),
        };
        let (alike, informative) = rayon::join(alike, informative);
        let (metres, radians) = PROPOSALS.separation;
        let mut places: Vec<Rigid2> = Vec::new();
        for place in alike.into_iter().chain(informative.places).map(|found| found.pose) {
            let is_near = |other: &Rigid2| {
                (other.translation - place.translation).norm() < metres
                    && normalize_angle(other.angle - place.angle).abs() < radians
            };
            if !places.iter().any(is_near) {
                places.push(place);
            }
        }
        let poses = places.iter().flat_map(|place| self.lifted(&embed_3d(place))).collect();
        ProposedPlaces { poses, lookups: CHARGED_LOOKUPS }
    }

    /// The poses over a 2D pose at the heights of the storeys there.
    fn lifted(&self, pose: &Rigid3) -> Vec<Rigid3> {
        let place = pose.translation.vector;
        let off = |node: &Vector3| (node.xy() - place.xy()).norm();
        let mut near: Vec<(f64, f64)> =
            self.nodes.iter().filter(|n| off(n) < NODES_AROUND).map(|n| (off(n), n.z)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        // The nearest node at each height: stairs and ramps join storeys, so that no gap is between them.
        let mut heights: Vec<f64> = Vec::new();
        for (_, height) in near {
            if heights.iter().all(|other| (height - other).abs() >= STOREY) {
                heights.push(height);
            }
        }
        heights.into_iter().map(|z| Rigid3::translation(0.0, 0.0, z) * pose).collect()
    }
}

/// Upright columns of scans, projected: points at height 0, thinned. Points are in a level frame, metres.
pub fn columns_of_scans(points: impl Iterator<Item = Point3f>) -> PointCloud {
    let thinned = voxel_filter_points(&upright_columns(points, UPRIGHT_IN_SCANS), THINNED);
    let stride = thinned.len().div_ceil(MOST_COLUMNS).max(1);
    PointCloud::new(thinned.into_iter().step_by(stride).collect())
}

/// Columns with points in at least `slices` slices, as points at height 0 in their middle, in order.
fn upright_columns(points: impl Iterator<Item = Point3f>, slices: usize) -> Vec<Point3f> {
    let mut columns: BTreeMap<[i32; 2], Vec<i32>> = BTreeMap::new();
    for p in points.filter(|p| p.coords.iter().all(|v| v.is_finite())) {
        let [x, y] = [p.x, p.y].map(|v| (v / COLUMN).floor() as i32);
        let (column, slice) = (columns.entry([x, y]).or_default(), (p.z / COLUMN_SLICE).floor() as i32);
        if !column.contains(&slice) {
            column.push(slice);
        }
    }
    let upright = columns.into_iter().filter(|(_, found)| found.len() >= slices);
    let middle = |v: i32| (v as f32 + 0.5) * COLUMN;
    upright.map(|([x, y], _)| Point3f::new(middle(x), middle(y), 0.0)).collect()
}

/// Upright columns, projected: as a grid in which all columns are alike, and as an index in which each is
/// weighted by its information.
fn from_above(
    solid: impl Iterator<Item = Point3f>,
    nodes: &[Vector3],
) -> Result<(Grid2d, PlaceIndex2d), FromAboveError> {
    let columns = upright_columns(solid, UPRIGHT_IN_MAP);
    let limits = limits_of(&columns)?;
    let cells: Vec<CellIndex> = columns.iter().map(|column| limits.cell_index(column.xy().coords)).collect();
    let mut picture = ProbabilityGrid::new(limits);
    cells.iter().for_each(|cell| {
        picture.set_probability(*cell, STANDS);
    });
    let crowd = Crowd::new(&limits, &cells);
    let information: Vec<(CellIndex, f32)> =
        cells.iter().map(|cell| (*cell, crowd.self_information(*cell))).collect();
    let index = PlaceIndex2d::of_cells(limits, &information, &around(nodes, &limits));
    Ok((Grid2d::Probability(picture), index))
}

/// Whether a node is near each cell.
fn around(nodes: &[Vector3], limits: &MapLimits) -> Vec<bool> {
    let mut is_near = vec![false; limits.num_cells()];
    let reach = (NODES_AROUND / limits.resolution()).ceil() as i32;
    for node in nodes {
        let middle = limits.cell_index(node.xy().cast::<f32>());
        for (x, y) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
            let cell = CellIndex::new(middle.x.saturating_add(x), middle.y.saturating_add(y));
            if let Some(near) = limits.flat_index(cell).and_then(|index| is_near.get_mut(index)) {
                *near = true;
            }
        }
    }
    is_near
}

fn limits_of(columns: &[Point3f]) -> Result<MapLimits, FromAboveError> {
    let first = columns.first().ok_or(FromAboveError::Empty)?;
    let (low, high) =
        columns.iter().fold((first.coords, first.coords), |(l, h), p| (l.inf(&p.coords), h.sup(&p.coords)));
    let size: na::Vector3<f64> = (high - low).cast();
    let mut resolution = f64::from(COLUMN);
    let cells = |length: f64, resolution: f64| (length / resolution).ceil() + 3.0;
    while cells(size.x, resolution) * cells(size.y, resolution) > MAX_CELLS {
        resolution *= 2.0;
    }
    let max = Vector2::new(f64::from(high.x) + 1.5 * resolution, f64::from(high.y) + 1.5 * resolution);
    let count = |length: f64| cells(length, resolution) as u32;
    Ok(MapLimits::new(resolution, max, count(size.y), count(size.x))?)
}

/// Number of upright cells in squares around cells, from a summed-area table.
struct Crowd {
    width: usize,
    height: usize,
    reach: usize,
    sums: Vec<u32>,
}

impl Crowd {
    fn new(limits: &MapLimits, cells: &[CellIndex]) -> Self {
        let (width, height) = (limits.num_x_cells() as usize, limits.num_y_cells() as usize);
        let mut sums = vec![0_u32; (width + 1) * (height + 1)];
        for cell in cells {
            let (x, y) = (cell.x.max(0) as usize, cell.y.max(0) as usize);
            if let Some(sum) = sums.get_mut((y + 1) * (width + 1) + x + 1).filter(|_| x < width) {
                *sum = 1;
            }
        }
        let mut above = vec![0; width + 1];
        for row in sums.chunks_exact_mut(width + 1) {
            let mut of_row = 0;
            for (sum, above) in row.iter_mut().zip(&mut above) {
                of_row += *sum;
                *sum = of_row + *above;
                *above = *sum;
            }
        }
        Self { width, height, reach: (SURROUNDINGS / limits.resolution()).round() as usize, sums }
    }

    /// Self-information of a cell: −ln of the fraction of upright cells around it, as a fraction of the
    /// maximum.
    fn self_information(&self, cell: CellIndex) -> f32 {
        let span = |middle: i32, size: usize| {
            let middle = middle.max(0) as usize;
            (middle.saturating_sub(self.reach), (middle + self.reach + 1).min(size))
        };
        let ((left, right), (low, high)) = (span(cell.x, self.width), span(cell.y, self.height));
        let before = |x: usize, y: usize| self.sums.get(y * (self.width + 1) + x).copied().unwrap_or(0);
        let standing = (before(right, high) + before(left, low)) - (before(left, high) + before(right, low));
        let side = 2.0 * self.reach as f64 + 1.0;
        let information = -(f64::from(standing.max(1)) / (side * side)).ln();
        (information.clamp(0.0, MAX_INFORMATION) / MAX_INFORMATION) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floors_are_no_columns() {
        let floor = (-40..40)
            .flat_map(|x| (-40..40).map(move |y| Point3f::new(0.3 * x as f32, 0.3 * y as f32, -1.0)));
        let wall = (-40..40)
            .flat_map(|x| (0..8).map(move |z| Point3f::new(0.3 * x as f32, 5.05, 0.3 * z as f32 - 0.9)));
        let columns = upright_columns(floor.chain(wall), UPRIGHT_IN_MAP);
        assert!(columns.len() > 50 && columns.iter().all(|p| (p.y - 5.05).abs() < 0.3), "{columns:?}");
    }

    #[test]
    fn an_isolated_post_has_more_information_than_one_in_a_wood() {
        let limits = MapLimits::new(0.3, Vector2::new(30.0, 30.0), 200, 200).unwrap();
        let wood = (30..90).flat_map(|x| (30..90).map(move |y| CellIndex::new(x, y)));
        let post = CellIndex::new(150, 150);
        let cells: Vec<CellIndex> = wood.filter(|cell| (cell.x + cell.y) % 3 == 0).chain([post]).collect();
        let crowd = Crowd::new(&limits, &cells);
        let [alone, among_others] = [post, CellIndex::new(60, 60)].map(|cell| crowd.self_information(cell));
        assert!((alone - 1.0).abs() < 1e-6, "{alone}");
        // A third of all cells: ln 3 of 3 nats.
        assert!((among_others - 3f32.ln() / 3.0).abs() < 0.01, "{among_others}");
    }
}
