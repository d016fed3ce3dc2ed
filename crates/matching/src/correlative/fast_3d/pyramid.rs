//! Pyramid of the largest byte in every cube of cells, for cubes of 1, 2, 3, 4, 6, 8, 12, … cells.

use portolan_grids::HybridGrid;
use portolan_grids::value::{CODE_COUNT, MIN_PROBABILITY, PROBABILITY_CODE};

use super::tiles::{Tile, Tiles};
use crate::correlative::byte_score::ByteScore;
use crate::correlative::max_pyramid::MaxPyramid;

/// Tiles along each edge of a node, cells along each edge.
const NODE_BITS: u32 = 3;
const NODE_CELL_BITS: u32 = NODE_BITS + 2;
const NODE_TILES: usize = 1 << (3 * NODE_BITS);
/// Largest index along any axis of cells that are searched, so that windows around them exist.
const SEARCHED_REACH: i32 = 7900;
/// Maximum number of entries of an index of everything; above it the known cells are scattered, and the
/// smaller reach below applies.
const MAX_ROOTS: usize = 1 << 22;
/// The same as [`SEARCHED_REACH`] if the known cells are scattered.
const SEARCHED_REACH_IF_SCATTERED: i32 = 2400;
/// Maximum number of blocks of 4×4×4 cells with known ones in a grid: surfaces of 400 m by 400 m in cells of
/// 10 cm. Pyramids of so many take up to 2 GB.
const MAX_TILES: usize = 1 << 20;

/// For widths w, powers of two and one and a half times that, `max over the cube of w cells at (x, y, z)`.
/// Cubes of 2^`full_resolution_depth` cells and more are kept for every 2nd, 4th, … place only, each then
/// large enough for all places up to the next.
#[derive(Clone, Debug)]
pub(super) struct MaxPyramid3d {
    levels: Vec<Level>,
}

/// All cubes of one width: an index of nodes, nodes of 8×8×8 tiles, tiles of 4×4×4 bytes. Node 0 and tile 0
/// are empty and stand for everything that is not there.
#[derive(Clone, Debug)]
pub(super) struct Level {
    stride_bits: u32,
    /// First node along each axis, one before the first that is not empty.
    first: [i32; 3],
    /// Nodes along each axis, one more at both ends than are not empty.
    size: [i32; 3],
    roots: Vec<u32>,
    nodes: Vec<[u32; NODE_TILES]>,
    tiles: Vec<Tile>,
}

impl MaxPyramid3d {
    /// The bytes of a grid in cubes up to 2^`max_exponent` cells.
    /// None if its known cells are spread over more blocks than any scanner reaches.
    pub fn new(
        grid: &HybridGrid,
        score: &ByteScore,
        max_exponent: u32,
        full_resolution_depth: u32,
    ) -> Option<Self> {
        let table: Vec<u8> = (0..CODE_COUNT as u16)
            .map(|code| score.byte(PROBABILITY_CODE.decode(code, MIN_PROBABILITY)))
            .collect();
        let tiles_within = |reach: i32| {
            let mut tiles = Tiles::with_capacity(grid.num_cells() / 16);
            grid.cells().for_each(|cell, code| {
                let byte = table[usize::from(code) % CODE_COUNT];
                if byte > 0 && cell.iter().all(|i| i.abs() <= reach) {
                    tiles.raise(cell, byte);
                }
            });
            tiles
        };
        let mut tiles = tiles_within(SEARCHED_REACH);
        if Level::num_roots(&tiles) > MAX_ROOTS {
            tiles = tiles_within(SEARCHED_REACH_IF_SCATTERED);
        }
        (tiles.len() <= MAX_TILES).then(|| Self::from_tiles(tiles, max_exponent, full_resolution_depth))
    }

    fn from_tiles(tiles: Tiles, max_exponent: u32, full_resolution_depth: u32) -> Self {
        let mut levels = vec![Level::new(&tiles, 0)];
        let (mut power, mut stride_bits) = (tiles, 0);
        for exponent in 0..max_exponent {
            // `power` has cubes of 2^exponent cells now.
            let in_strides = |cells: u32| cells.div_ceil(1 << stride_bits);
            if exponent > 0 {
                let between = power.widened(in_strides(1 << (exponent - 1)));
                levels.push(Level::new(&between, stride_bits));
            }
            power = power.widened(in_strides(1 << exponent));
            if exponent + 1 >= full_resolution_depth {
                power = power.halved();
                stride_bits += 1;
            }
            levels.push(Level::new(&power, stride_bits));
        }
        Self { levels }
    }

    /// Index of the narrowest cubes of at least `width` cells.
    pub fn level_for(width: u32) -> usize {
        MaxPyramid::level_for(width)
    }

    /// Number of widths.
    pub fn num_levels(&self) -> usize {
        self.levels.len()
    }

    /// Cubes by their index in ascending order of width.
    pub fn level(&self, index: usize) -> &Level {
        &self.levels[index]
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.levels.iter().map(Level::memory_bytes).sum()
    }
}

/// Position of one coordinate: the parts that it adds to the positions in roots, node and tile.
#[derive(Clone, Copy)]
struct Part {
    root: u32,
    tile: u32,
    byte: u32,
}

impl Level {
    /// Smallest and largest node along each axis.
    fn node_bounds(tiles: &Tiles) -> [[i32; 3]; 2] {
        let node = |place: [i32; 3]| place.map(|i| i >> NODE_BITS);
        let start = tiles.iter().next().map_or([0; 3], |(place, _)| node(place));
        tiles.iter().fold([start; 2], |[low, high], (place, _)| {
            let n = node(place);
            [[0, 1, 2].map(|a| low[a].min(n[a])), [0, 1, 2].map(|a| high[a].max(n[a]))]
        })
    }

    fn size_of([low, high]: [[i32; 3]; 2]) -> [i32; 3] {
        [0, 1, 2].map(|a| high[a] - low[a] + 3)
    }

    fn num_roots(tiles: &Tiles) -> usize {
        Self::size_of(Self::node_bounds(tiles)).iter().map(|n| *n as usize).product()
    }

    fn new(tiles: &Tiles, stride_bits: u32) -> Self {
        let bounds = Self::node_bounds(tiles);
        let size = Self::size_of(bounds);
        let mut level = Self {
            stride_bits,
            first: bounds[0].map(|i| i - 1),
            size,
            roots: vec![0; size.iter().map(|n| *n as usize).product()],
            nodes: vec![[0; NODE_TILES]],
            tiles: Vec::with_capacity(tiles.len() + 1),
        };
        level.tiles.push([0; 64]);
        for (place, tile) in tiles.iter() {
            let parts = [0, 1, 2].map(|axis| level.part(place[axis] << 2, axis));
            let root = parts.iter().map(|p| p.root as usize).sum::<usize>();
            if level.roots[root] == 0 {
                level.roots[root] = level.nodes.len() as u32;
                level.nodes.push([0; NODE_TILES]);
            }
            let node = level.roots[root] as usize;
            let in_node = parts.iter().map(|p| p.tile as usize).sum::<usize>();
            level.nodes[node][in_node] = level.tiles.len() as u32;
            level.tiles.push(*tile);
        }
        level
    }

    /// The parts of a coordinate, in cells of this level.
    #[inline(always)]
    fn part(&self, cell: i32, axis: usize) -> Part {
        // Beyond the ends all nodes are empty.
        let node = ((cell >> NODE_CELL_BITS) - self.first[axis]).clamp(0, self.size[axis] - 1);
        let root_stride = match axis {
            0 => 1,
            1 => self.size[0],
            _ => self.size[0] * self.size[1],
        };
        let tile = (cell >> 2 & ((1 << NODE_BITS) - 1)) as u32;
        Part {
            root: (node * root_stride) as u32,
            tile: tile << (NODE_BITS * axis as u32),
            byte: ((cell & 3) as u32) << (2 * axis),
        }
    }

    #[inline(always)]
    fn byte(&self, x: Part, y: Part, z: Part) -> u32 {
        let node = self.roots[(x.root + y.root + z.root) as usize] as usize;
        let tile = self.nodes[node][(x.tile + y.tile + z.tile) as usize % NODE_TILES] as usize;
        u32::from(self.tiles[tile][(x.byte + y.byte + z.byte) as usize % 64])
    }

    /// For the eight boxes of shifts that start at `shift` and `width` cells on along each axis (bit 0 of
    /// the position along x): the sum over the points of the largest byte in the cube at the shifted cell.
    pub fn eight_sums(&self, cells: &[[i16; 3]], shift: [i32; 3], width: i32) -> [u32; 8] {
        let mut sums = [0; 8];
        let bits = self.stride_bits;
        for cell in cells {
            let at = |axis: usize| i32::from(cell[axis]) + shift[axis];
            let near = |axis: usize| self.part(at(axis) >> bits, axis);
            let far = |axis: usize| self.part((at(axis) + width) >> bits, axis);
            // Written out: this is the innermost loop of the search.
            let (x, y, z) = ([near(0), far(0)], [near(1), far(1)], [near(2), far(2)]);
            sums[0] += self.byte(x[0], y[0], z[0]);
            sums[1] += self.byte(x[1], y[0], z[0]);
            sums[2] += self.byte(x[0], y[1], z[0]);
            sums[3] += self.byte(x[1], y[1], z[0]);
            sums[4] += self.byte(x[0], y[0], z[1]);
            sums[5] += self.byte(x[1], y[0], z[1]);
            sums[6] += self.byte(x[0], y[1], z[1]);
            sums[7] += self.byte(x[1], y[1], z[1]);
        }
        sums
    }

    fn memory_bytes(&self) -> usize {
        self.roots.len() * size_of::<u32>()
            + self.nodes.len() * size_of::<[u32; NODE_TILES]>()
            + self.tiles.len() * size_of::<Tile>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    /// Every cube bounds the cells in it, and is no larger than its stride makes it.
    #[test]
    fn cubes_hold_the_largest_byte() {
        let (mut grid, mut lcg) = (HybridGrid::new(2.0).unwrap(), Lcg::new(77));
        for _ in 0..1000 {
            let cell = [0; 3].map(|_| lcg.symmetric(25.0).round() as i32);
            grid.set_probability(cell, 0.5 + lcg.symmetric(0.4));
        }
        let score = ByteScore::new(0.1, 0.9);
        let byte = |cell: [i32; 3]| u32::from(score.byte(grid.probability(cell)));
        let largest = |cell: [i32; 3], width: i32| {
            let all = |a: usize| cell[a]..cell[a] + width;
            all(2).flat_map(|z| all(1).flat_map(move |y| all(0).map(move |x| [x, y, z]))).map(byte).max()
        };
        for depth in [1, 3, 5] {
            let pyramid = MaxPyramid3d::new(&grid, &score, 4, depth).unwrap();
            for (index, width) in [1, 2, 3, 4, 6, 8, 12, 16].into_iter().enumerate() {
                assert_eq!(MaxPyramid3d::level_for(width as u32), index);
                let level = pyramid.level(index);
                let stride = 1 << level.stride_bits;
                assert!(stride == 1 || width >= 1 << (depth - 1), "{width} {stride}");
                for _ in 0..200 {
                    let cell = [0; 3].map(|_| lcg.symmetric(45.0).round() as i32);
                    let found = level.eight_sums(&[cell.map(|i| i as i16)], [0; 3], 0)[0];
                    let exact = largest(cell, width).unwrap();
                    if stride == 1 {
                        assert_eq!(found, exact, "{cell:?} {width}");
                    } else {
                        let around = largest(cell.map(|i| i - stride - 1), width + 2 * stride + width / 2);
                        assert!(found >= exact && Some(found) <= around, "{cell:?} {width}");
                    }
                }
            }
            assert!(pyramid.memory_bytes() > 0);
        }
    }

    #[test]
    fn eight_boxes_are_eight_cubes() {
        let grid = crate::testing::drawn_cloud_b(0.45, 2);
        let pyramid = MaxPyramid3d::new(&grid, &ByteScore::new(0.1, 0.9), 5, 3).unwrap();
        let mut lcg = Lcg::new(5);
        let cells: Vec<[i16; 3]> = (0..40).map(|_| [0; 3].map(|_| lcg.symmetric(30.0) as i16)).collect();
        for index in 0..pyramid.num_levels() {
            let level = pyramid.level(index);
            let sums = level.eight_sums(&cells, [3, -4, 1], 4);
            for (i, sum) in sums.into_iter().enumerate() {
                let shift = [3 + 4 * (i & 1) as i32, -4 + 4 * (i >> 1 & 1) as i32, 1 + 4 * (i >> 2) as i32];
                assert_eq!(level.eight_sums(&cells, shift, 0)[0], sum);
            }
        }
    }
}
