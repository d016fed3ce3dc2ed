//! Point clouds as stored in maps: millimetres in blocks of 1.024 m (`spec/formats.md` §4.3).

use portolan_geometry::Point3f;
use thiserror::Error;

use crate::lround;

/// Edge of the grid to which points are rounded, metres.
const GRID: f32 = 0.001;
/// Bits per coordinate within a block.
const BITS: u32 = 10;
const MASK: i64 = (1 << BITS) - 1;
/// Block indices range from minus to plus this value: 2^23 grid cells.
const MAX_BLOCK: i64 = 1 << (23 - BITS);
/// Number of integers before the points of a block: the count of points and the block's three indices.
const BLOCK_HEADER: usize = 4;

/// A cloud of points rounded to 1 mm, in the order of the format. Intensities are not stored.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CompressedPointCloud {
    /// Number of points.
    pub num_points: i32,
    /// Blocks one after the other: count, block x, y, z, then one integer per point.
    pub point_data: Vec<i32>,
}

/// Why a cloud cannot be compressed or read.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CompressedPointCloudError {
    /// The format covers coordinates up to 8388 m.
    #[error(
        "point {index} at ({x}, {y}, {z}) m is beyond the 8388 m that a compressed cloud can hold: limit max_range or remove it"
    )]
    OutOfBounds {
        /// Position in the input.
        index: usize,
        /// Metres.
        x: f32,
        /// Metres.
        y: f32,
        /// Metres.
        z: f32,
    },
    /// The count is an `i32`.
    #[error("{0} points are more than a compressed cloud can count (2147483647)")]
    TooManyPoints(usize),
    /// Negative number of points.
    #[error("damaged point cloud: it claims {0} points")]
    NegativeCount(i32),
    /// Fewer data than claimed.
    #[error("damaged point cloud: {claimed} points are claimed but the data end after {found}")]
    Truncated {
        /// Number of points according to the message.
        claimed: i32,
        /// Number of points that are present.
        found: usize,
    },
    /// A block that no writer can have made.
    #[error("damaged point cloud: bad block at integer {0} of its data")]
    BadBlock(usize),
    /// A point that no writer can have made.
    #[error("damaged point cloud: bad point at integer {0} of its data")]
    BadPoint(usize),
}

use CompressedPointCloudError as Error;

impl CompressedPointCloud {
    /// Compresses points in metres; the error per axis is at most half a millimetre.
    ///
    /// # Errors
    /// If a point is beyond the bounds of the format, 8388 m, or there are more points than it can count.
    pub fn compress(points: &[Point3f]) -> Result<Self, Error> {
        let mut cells = Vec::with_capacity(points.len());
        for (index, point) in points.iter().enumerate() {
            let out_of_bounds = || Error::OutOfBounds { index, x: point.x, y: point.y, z: point.z };
            cells.push(Cell::of(point).ok_or_else(out_of_bounds)?);
        }
        Self::from_cells(cells)
    }

    /// Like [`CompressedPointCloud::compress`], but leaves out points beyond the bounds of the format and
    /// returns their number.
    ///
    /// # Errors
    /// If there are more points than the format can count.
    pub fn compress_within_bounds(points: &[Point3f]) -> Result<(Self, usize), Error> {
        let cells: Vec<Cell> = points.iter().filter_map(Cell::of).collect();
        let left_out = points.len() - cells.len();
        Ok((Self::from_cells(cells)?, left_out))
    }

    fn from_cells(mut cells: Vec<Cell>) -> Result<Self, Error> {
        let num_points = i32::try_from(cells.len()).map_err(|_| Error::TooManyPoints(cells.len()))?;
        // Stable: within a block the points keep their order.
        cells.sort_by_key(|c| c.order);
        let mut point_data = Vec::with_capacity(cells.len() + cells.len() / 4);
        for block in cells.chunk_by(|a, b| a.order == b.order) {
            let Some(first) = block.first() else { continue };
            point_data.push(block.len() as i32);
            point_data.extend(first.block);
            point_data.extend(block.iter().map(|c| c.word));
        }
        Ok(Self { num_points, point_data })
    }

    /// The points in metres, in the order of the format, not that of the original cloud. Data after the last
    /// counted point are ignored, as the format specifies.
    ///
    /// # Errors
    /// If the data are damaged.
    pub fn decompress(&self) -> Result<Vec<Point3f>, Error> {
        let wanted = usize::try_from(self.num_points).map_err(|_| Error::NegativeCount(self.num_points))?;
        // Memory is allocated for the data present, not for the claimed count.
        let mut points = Vec::with_capacity(wanted.min(self.point_data.len()));
        let mut position = 0;
        while points.len() < wanted {
            let truncated = Error::Truncated { claimed: self.num_points, found: points.len() };
            let rest = self.point_data.get(position..).unwrap_or_default();
            let Some((header, words)) = rest.split_at_checked(BLOCK_HEADER) else {
                return Err(truncated);
            };
            let (count, block) = parse_header(header).ok_or(Error::BadBlock(position))?;
            let count = count.min(wanted - points.len());
            for (i, word) in words.iter().take(count).enumerate() {
                let point = decode(block, *word).ok_or(Error::BadPoint(position + BLOCK_HEADER + i))?;
                points.push(point);
            }
            if words.len() < count {
                return Err(Error::Truncated { claimed: self.num_points, found: points.len() });
            }
            position += BLOCK_HEADER + count;
        }
        Ok(points)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.num_points == 0
    }
}

/// A point on the grid.
#[derive(Clone, Copy)]
struct Cell {
    /// Sort key of the block in the order of the format.
    order: u64,
    block: [i32; 3],
    word: i32,
}

impl Cell {
    fn of(point: &Point3f) -> Option<Self> {
        let scaled = point.coords.map(|c| c / GRID);
        if !scaled.iter().all(|q| q.abs() < (MAX_BLOCK << BITS) as f32) {
            return None;
        }
        let [x, y, z] = scaled.map(lround).data.0[0];
        let block = [x >> BITS, y >> BITS, z >> BITS];
        let word = ((z & MASK) << (2 * BITS)) + ((y & MASK) << BITS) + (x & MASK);
        Some(Self { order: block_order(block), block: block.map(|b| b as i32), word: word as i32 })
    }
}

/// Blocks are ordered as the cells of nested grids with three levels: z before y before x, the coarsest level
/// first, with 64 blocks and 8 blocks to the two finer levels.
fn block_order([x, y, z]: [i64; 3]) -> u64 {
    let coarse = |b: i64| ((b >> 6) + MAX_BLOCK) as u64;
    let middle = |b: i64| ((b >> 3) & 7) as u64;
    let fine = |b: i64| (b & 7) as u64;
    let mut order = 0;
    for axis in [z, y, x] {
        order = order << 14 | coarse(axis);
    }
    for axis in [z, y, x] {
        order = order << 3 | middle(axis);
    }
    for axis in [z, y, x] {
        order = order << 3 | fine(axis);
    }
    order
}

fn parse_header(header: &[i32]) -> Option<(usize, [i32; 3])> {
    let [count, x, y, z] = *header else { return None };
    let within = |b: i32| (-MAX_BLOCK..=MAX_BLOCK).contains(&i64::from(b));
    (within(x) && within(y) && within(z)).then_some((usize::try_from(count).ok()?, [x, y, z]))
}

fn decode(block: [i32; 3], word: i32) -> Option<Point3f> {
    if !(0..1 << (3 * BITS)).contains(&word) {
        return None;
    }
    let mask = MASK as i32;
    let coordinate = |block: i32, cell: i32| ((block << BITS) + cell) as f32 * GRID;
    let [x, y, z] = block;
    Some(Point3f::new(
        coordinate(x, word & mask),
        coordinate(y, (word >> BITS) & mask),
        coordinate(z, word >> (2 * BITS)),
    ))
}

#[cfg(test)]
mod tests;
