//! Pyramid of the largest byte in every window of a grid, for windows of 1, 2, 3, 4, 6, 8, 12, … cells.

/// For each width w, powers of two and one and a half times that, the grid of `max over [x, x+w) × [y, y+w)`
/// of a grid of bytes, with one byte for all cells outside.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MaxPyramid {
    levels: Vec<Level>,
}

/// All windows of one width that touch the grid. Window (x, y) is at column `x + w − 1`, row
/// `y + w − 1`; one more column and row stand for everything outside.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Level {
    window: i32,
    num_columns: u32,
    num_rows: u32,
    outside: u8,
    bytes: Vec<u8>,
}

impl MaxPyramid {
    /// From `num_x`×`num_y` bytes, x running fastest, with windows up to 2^`max_exponent` cells.
    pub fn new(bytes: &[u8], num_x: usize, num_y: usize, max_exponent: u32, outside: u8) -> Self {
        debug_assert_eq!(bytes.len(), num_x * num_y);
        let mut base = Level::filled(1, num_x, num_y, outside);
        for (row, source) in base.bytes.chunks_exact_mut(num_x + 1).zip(bytes.chunks_exact(num_x.max(1))) {
            row[..num_x].copy_from_slice(source);
        }
        let mut levels = vec![base];
        for exponent in 0..max_exponent {
            let last = &levels[levels.len() - 1];
            let power = if exponent == 0 { last } else { &levels[2 * exponent as usize - 1] };
            let next = power.widened(power.window);
            let between = (exponent > 0).then(|| power.widened(power.window / 2));
            levels.extend(between);
            levels.push(next);
        }
        Self { levels }
    }

    /// Index of the narrowest windows of at least `width` cells: widths 1, 2, 3, 4, 6, 8, 12, ….
    pub fn level_for(width: u32) -> usize {
        let power = width.next_power_of_two();
        let index = 2 * power.trailing_zeros() as usize;
        match index {
            0 => 0,
            2 => 1,
            _ if width <= power / 4 * 3 => index - 2,
            _ => index - 1,
        }
    }

    /// Memory that it takes, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.levels.iter().map(|level| level.bytes.len()).sum()
    }

    /// Number of widths.
    pub fn num_levels(&self) -> usize {
        self.levels.len()
    }

    /// Windows by their index in ascending order of width; the widest for any larger index.
    pub fn level(&self, index: usize) -> &Level {
        &self.levels[index.min(self.levels.len() - 1)]
    }

    /// The largest byte in the window of any power of two.
    pub fn window_max(&self, x: i32, y: i32, exponent: u32) -> u8 {
        let level = self.level(Self::level_for(1u32 << exponent.min(30)));
        if level.window >> exponent.min(30) != 0 {
            return level.at(x, y);
        }
        let (width, num_x, num_y) = (level.window, level.num_columns as i32, level.num_rows as i32);
        let (num_x, num_y) = (num_x - width + 1, num_y - width + 1);
        let end = |first: i32| first.saturating_add(1i32 << exponent.min(30));
        let is_inside = x >= 0 && y >= 0 && end(x) <= num_x && end(y) <= num_y;
        let outside = if is_inside { 0 } else { level.outside };
        // Only the parts that touch the grid need to be visited.
        let starts = |first: i32, size: i32| {
            let (from, to) = (first.max(1 - width), (end(first) - width).min(size - 1));
            (from..to).step_by(width as usize).chain((from <= to).then_some(to))
        };
        let cells = starts(y, num_y).flat_map(|y| starts(x, num_x).map(move |x| (x, y)));
        cells.map(|(x, y)| level.at(x, y)).max().unwrap_or(0).max(outside)
    }
}

impl Level {
    fn filled(window: i32, num_columns: usize, num_rows: usize, outside: u8) -> Self {
        let bytes = vec![outside; (num_columns + 1) * (num_rows + 1)];
        Self { window, num_columns: num_columns as u32, num_rows: num_rows as u32, outside, bytes }
    }

    /// Windows wider by `more` cells, at most their width: the larger of two overlapping windows, first
    /// along rows, then along columns. Element by element, whatever the width.
    fn widened(&self, more: i32) -> Self {
        let shift = more as usize;
        let (columns, rows) = (self.num_columns as usize, self.num_rows as usize);
        let mut wide = Self::filled(self.window + more, columns + shift, rows + shift, self.outside);
        let (stride, wide_stride) = (columns + 1, columns + shift + 1);
        for (target, source) in
            wide.bytes.chunks_exact_mut(wide_stride).zip(self.bytes.chunks_exact(stride)).take(rows)
        {
            target[..columns].copy_from_slice(&source[..columns]);
            raise(&mut target[..shift.min(columns)], [self.outside].iter().cycle());
            raise(&mut target[shift..shift + columns], source.iter());
        }
        // From the last row on, so that the rows above are still those of the first step.
        for row in (0..rows + shift).rev() {
            let (above, below) = wide.bytes.split_at_mut(row * wide_stride);
            let target = &mut below[..columns + shift];
            match row.checked_sub(shift) {
                Some(source) => raise(target, above[source * wide_stride..].iter()),
                None => raise(target, [self.outside].iter().cycle()),
            }
        }
        wide
    }

    /// The largest byte of window (x, y).
    #[inline]
    pub fn at(&self, x: i32, y: i32) -> u8 {
        let column = (x.wrapping_add(self.window - 1) as u32).min(self.num_columns);
        let row = (y.wrapping_add(self.window - 1) as u32).min(self.num_rows);
        let index = row as usize * (self.num_columns as usize + 1) + column as usize;
        self.bytes.get(index).copied().unwrap_or(self.outside)
    }

    #[inline(always)]
    fn byte(&self, index: usize) -> u32 {
        match self.bytes.get(index) {
            Some(byte) => u32::from(*byte),
            None => u32::from(self.outside),
        }
    }

    /// Sum over `cells` of the windows that start at each cell moved by (`x`, `y`).
    #[cfg(test)]
    pub fn sum(&self, cells: &[[i32; 2]], x: i32, y: i32) -> u32 {
        cells.iter().map(|c| u32::from(self.at(c[0].wrapping_add(x), c[1].wrapping_add(y)))).sum()
    }

    /// The four sums at (`x`, `y`), (`x`, `y + step`), (`x + step`, `y`) and (`x + step`, `y + step`).
    #[inline]
    pub fn four_sums(&self, cells: &[[i32; 2]], x: i32, y: i32, step: i32) -> [u32; 4] {
        let stride = self.num_columns as usize + 1;
        let (x, y) = (x.wrapping_add(self.window - 1), y.wrapping_add(self.window - 1));
        let (last_column, last_row) = (self.num_columns, self.num_rows);
        // Plain statements: this is where searches spend their time, in builds without much inlining, too.
        let mut sums = [0; 4];
        for cell in cells {
            let (column, row) = (cell[0].wrapping_add(x), cell[1].wrapping_add(y));
            let left = (column as u32).min(last_column) as usize;
            let right = (column.wrapping_add(step) as u32).min(last_column) as usize;
            let top = (row as u32).min(last_row) as usize * stride;
            let bottom = (row.wrapping_add(step) as u32).min(last_row) as usize * stride;
            sums[0] += self.byte(top + left);
            sums[1] += self.byte(bottom + left);
            sums[2] += self.byte(top + right);
            sums[3] += self.byte(bottom + right);
        }
        sums
    }
}

/// Raises every byte to at least that of `floor`.
fn raise<'a>(bytes: &mut [u8], floor: impl Iterator<Item = &'a u8>) {
    for (byte, floor) in bytes.iter_mut().zip(floor) {
        *byte = (*byte).max(*floor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    fn check(num_x: usize, num_y: usize, exponents: &[u32], max_exponent: u32, outside: u8) {
        let mut lcg = Lcg::new(5);
        let bytes: Vec<u8> =
            (0..num_x * num_y).map(|_| (lcg.unit() * lcg.unit() * lcg.unit() * 256.0) as u8).collect();
        let pyramid = MaxPyramid::new(&bytes, num_x, num_y, max_exponent, outside);
        for exponent in exponents {
            let width = 1i32 << exponent;
            for y in -width - 1..num_y as i32 + 2 {
                for x in -width - 1..num_x as i32 + 2 {
                    let byte = |x: i32, y: i32| match (usize::try_from(x), usize::try_from(y)) {
                        (Ok(x), Ok(y)) if x < num_x && y < num_y => bytes[y * num_x + x],
                        _ => outside,
                    };
                    let cells = (y..y + width).flat_map(|y| (x..x + width).map(move |x| (x, y)));
                    let expected = cells.map(|(x, y)| byte(x, y)).max().unwrap();
                    assert_eq!(pyramid.window_max(x, y, *exponent), expected, "{x} {y} {width}");
                }
            }
        }
    }

    #[test]
    fn every_window_has_its_maximum() {
        for outside in [0, 100] {
            check(31, 17, &[0, 1, 2, 3, 4, 5, 6], 3, outside);
            check(4, 4, &[0, 1, 5], 2, outside);
            check(1, 1, &[0, 3], 0, outside);
        }
    }

    #[test]
    fn windows_between_the_powers_of_two_have_their_maximum() {
        let bytes: Vec<u8> = (0..143u32).map(|i| (i * 89 % 251) as u8).collect();
        let pyramid = MaxPyramid::new(&bytes, 13, 11, 4, 0);
        assert_eq!(pyramid.num_levels(), 8);
        for (index, width) in [1i32, 2, 3, 4, 6, 8, 12, 16].into_iter().enumerate() {
            assert_eq!(MaxPyramid::level_for(width as u32), index);
            assert_eq!(MaxPyramid::level_for(width as u32 + 1), index + 1);
            for (x, y) in (-17..14).flat_map(|x| (-17..12).map(move |y| (x, y))) {
                let range = |first: i32, size: i32| first.max(0)..(first + width).min(size).max(first.max(0));
                let cells = range(y, 11).flat_map(|y| range(x, 13).map(move |x| y * 13 + x));
                let expected = cells.map(|i| bytes[i as usize]).max().unwrap_or(0);
                assert_eq!(pyramid.level(index).at(x, y), expected, "{x} {y} {width}");
            }
        }
    }

    #[test]
    fn byte_sums_equal_their_definition() {
        let bytes: Vec<u8> = (0..60).collect();
        let pyramid = MaxPyramid::new(&bytes, 10, 6, 2, 0);
        let cells = [[0, 0], [3, 4], [-7, 2], [9, 5], [100, -100]];
        for index in 0..4 {
            let level = pyramid.level(index);
            let sums = level.four_sums(&cells, -1, 1, 2);
            for (i, (dx, dy)) in [(0, 0), (0, 2), (2, 0), (2, 2)].into_iter().enumerate() {
                assert_eq!(sums[i], level.sum(&cells, dx - 1, dy + 1));
            }
        }
    }
}
