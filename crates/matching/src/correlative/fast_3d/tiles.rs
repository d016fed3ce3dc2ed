//! Stores bytes of cells in 3D in tiles of 4×4×4, and widens windows over them.

use portolan_spatial::DenseIndex;

/// Cells along each edge of a tile; their bytes have x running fastest.
pub(super) type Tile = [u8; 64];
/// Tiles have indices from minus this up to this minus one along each axis.
const TILE_REACH: i32 = 2048;

/// Tiles by their place. Cells without a tile are 0.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    index: DenseIndex,
    /// Places of the tiles, in tiles.
    places: Vec<[i32; 3]>,
    tiles: Vec<Tile>,
}

fn key_of(place: [i32; 3]) -> Option<u64> {
    let possible = place.iter().all(|i| (-TILE_REACH..TILE_REACH).contains(i));
    let [x, y, z] = place.map(|i| u64::from((i + TILE_REACH) as u32));
    // One to one, so that keys do not come in the order of their hashes: grids pass on their cells in the
    // order of the same hash table, and filling a growing one in that order takes time with the square of
    // their number.
    let scattered = (z << 24 | y << 12 | x).wrapping_mul(0x5851_f42d_4c95_7f2d) & ((1 << 36) - 1);
    possible.then_some(scattered)
}

/// Position of a cell in its tile.
#[inline]
pub(super) fn position([x, y, z]: [i32; 3]) -> usize {
    ((z & 3) << 4 | (y & 3) << 2 | (x & 3)) as usize
}

impl Tiles {
    pub fn with_capacity(num_tiles: usize) -> Self {
        Self { index: DenseIndex::with_capacity(num_tiles), places: Vec::new(), tiles: Vec::new() }
    }

    /// The tile at a place, made if there is none. None where there cannot be one.
    fn entry(&mut self, place: [i32; 3]) -> Option<&mut Tile> {
        let key = key_of(place)?;
        let number = self.index.get(key).unwrap_or_else(|| {
            self.index.insert(key, self.tiles.len());
            self.places.push(place);
            self.tiles.push([0; 64]);
            self.tiles.len() - 1
        });
        self.tiles.get_mut(number)
    }

    /// Raises the byte of a cell to at least `byte`.
    pub fn raise(&mut self, cell: [i32; 3], byte: u8) {
        if let Some(tile) = self.entry(cell.map(|i| i >> 2)) {
            let old = &mut tile[position(cell)];
            *old = byte.max(*old);
        }
    }

    fn raise_tile(&mut self, place: [i32; 3], bytes: &Tile) {
        if let Some(tile) = self.entry(place) {
            for (old, new) in tile.iter_mut().zip(bytes) {
                *old = (*old).max(*new);
            }
        }
    }

    /// All tiles with their places, in the order in which they were made.
    pub fn iter(&self) -> impl Iterator<Item = ([i32; 3], &Tile)> {
        self.places.iter().copied().zip(&self.tiles)
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.tiles.len()
    }

    /// Every cell becomes the largest of the eight that are 0 or `shift` cells from it along each axis.
    pub fn widened(&self, shift: u32) -> Self {
        let once = self.widened_along(0, shift);
        once.widened_along(1, shift).widened_along(2, shift)
    }

    fn widened_along(&self, axis: usize, shift: u32) -> Self {
        let (whole, rest) = ((shift / 4) as i32, (shift % 4) as usize);
        let mut wide = Self::with_capacity(self.len() + self.len() / 2);
        for (place, tile) in self.iter() {
            wide.raise_tile(place, tile);
            let back = |tiles: i32| {
                let mut moved = place;
                moved[axis] -= tiles;
                moved
            };
            let [near, far] = split_along(tile, axis, rest);
            if near != [0; 64] {
                wide.raise_tile(back(whole), &near);
            }
            if far != [0; 64] {
                wide.raise_tile(back(whole + 1), &far);
            }
        }
        wide
    }

    /// Cells twice as large: the largest of the eight cells in each.
    pub fn halved(&self) -> Self {
        let mut half = Self::with_capacity(self.len() / 4);
        for (place, tile) in self.iter() {
            let mut eighth = [0u8; 64];
            let corner = [0, 1, 2].map(|a| (place[a] & 1) << 1);
            for (i, byte) in tile.iter().enumerate() {
                let cell = [i as i32 & 3, i as i32 >> 2 & 3, i as i32 >> 4];
                let old = &mut eighth[position([0, 1, 2].map(|a| corner[a] + (cell[a] >> 1)))];
                *old = (*byte).max(*old);
            }
            half.raise_tile(place.map(|i| i >> 1), &eighth);
        }
        half
    }
}

/// A tile moved by `shift` (0 to 3) cells towards the start of an axis: the part remaining in the tile, and
/// the part that moves into the one before.
fn split_along(tile: &Tile, axis: usize, shift: usize) -> [Tile; 2] {
    let (mut near, mut far) = ([0; 64], [0; 64]);
    if shift == 0 {
        return [*tile, far];
    }
    let stride = 1 << (2 * axis);
    for (i, byte) in tile.iter().enumerate() {
        let along = i >> (2 * axis) & 3;
        match along.checked_sub(shift) {
            Some(_) => near[i - shift * stride] = *byte,
            None => far[i + (4 - shift) * stride] = *byte,
        }
    }
    [near, far]
}
