//! Values of cells that are created on demand.

use portolan_geometry::Point3f;
use portolan_spatial::DenseIndex;

/// The key of a cell from twelve bits of each index; cells kilometres apart may share one.
#[inline]
pub(super) fn key_of([x, y, z]: [i32; 3]) -> u64 {
    let bits = |index: i32| index as u64 & 0xfff;
    bits(x) << 24 | bits(y) << 12 | bits(z)
}

/// The largest integer that is not larger than the value, or the nearest integer for a value out of range.
/// Without the function call that `floor` is on some targets.
#[inline]
fn whole(value: f32) -> i32 {
    let toward_zero = value as i32;
    toward_zero.saturating_sub(i32::from(toward_zero as f32 > value))
}

/// Values of cubic cells.
#[derive(Clone, Debug)]
pub(super) struct Cells<T> {
    pub edge: f32,
    index: DenseIndex,
    values: Vec<T>,
    empty: T,
}

impl<T: Clone> Cells<T> {
    /// Cells with an edge in metres, each `empty` at first.
    pub fn new(edge: f32, empty: T) -> Self {
        Self { edge, index: DenseIndex::with_capacity(0), values: Vec::new(), empty }
    }

    /// Indices of the cell around a point.
    pub fn around(&self, place: &Point3f) -> [i32; 3] {
        [place.x, place.y, place.z].map(|v| whole(v / self.edge))
    }

    /// The key of the column around a point.
    #[inline]
    pub fn column(&self, place: &Point3f) -> u64 {
        key_of([whole(place.x / self.edge), whole(place.y / self.edge), 0])
    }

    /// The number of a cell, which is created if it is missing.
    #[inline]
    pub fn number_of(&mut self, key: u64) -> usize {
        self.index.get(key).unwrap_or_else(|| {
            self.index.insert(key, self.values.len());
            self.values.push(self.empty.clone());
            self.values.len() - 1
        })
    }

    /// The value of a cell by its number.
    pub fn value(&self, number: usize) -> &T {
        &self.values[number]
    }

    /// The value of a cell by its number, mutable.
    pub fn value_mut(&mut self, number: usize) -> &mut T {
        &mut self.values[number]
    }

    /// The value of a cell, if it exists.
    pub fn at(&self, key: u64) -> Option<&T> {
        self.values.get(self.index.get(key)?)
    }

    /// The value of a cell, mutable; the cell is created if it is missing.
    pub fn at_mut(&mut self, key: u64) -> &mut T {
        let number = self.number_of(key);
        self.value_mut(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_numbered_downward() {
        let values =
            [0.0, -0.0, 0.5, -0.5, -1.0, 2.0, -7.25, 1e9, -1e9, 1e30, -1e30, f32::NAN, f32::INFINITY];
        assert_eq!(values.map(whole), values.map(|v| v.floor() as i32));
    }
}
