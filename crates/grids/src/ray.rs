//! Enumerates the cells that a ray passes, in exact integer arithmetic.

/// Calls `visit(column, row)` for every cell met by the segment that joins the *centres* of two
/// subpixels.
///
/// `begin` and `end` are subpixel indices, not negative, `scale` of them to a cell along each axis.
/// Cells come in order of ascending column, within a column along the ray (ascending for a ray within
/// one column), whichever end is given first, each once. Where the ray passes exactly through a corner
/// it steps diagonally.
///
/// In one function, because the two directions of rows share all of its state, and it is the innermost loop
/// of inserting scans.
pub fn for_each_cell_on_ray(begin: [i64; 2], end: [i64; 2], scale: i64, mut visit: impl FnMut(i64, i64)) {
    let (begin, end) = if begin[0] > end[0] { (end, begin) } else { (begin, end) };
    let (mut column, last_column) = (begin[0] / scale, end[0] / scale);
    let mut row = begin[1] / scale;
    if column == last_column {
        let end_row = end[1] / scale;
        (row.min(end_row)..=row.max(end_row)).for_each(|row| visit(column, row));
        return;
    }
    let (dx, dy) = (end[0] - begin[0], end[1] - begin[1]);
    // Height of the ray above the lower edge of the current row at the right edge of the current
    // column, in units in which a cell is `cell` high; all terms are doubled to remain integers.
    let cell = 2 * scale * dx;
    let mut height = (2 * (begin[1] % scale) + 1) * dx + dy * (2 * scale - 2 * (begin[0] % scale) - 1);
    let per_column = 2 * scale * dy;
    let in_last_column = dy * (2 * (end[0] % scale) + 1);
    if dy > 0 {
        loop {
            visit(column, row);
            while height > cell {
                height -= cell;
                row += 1;
                visit(column, row);
            }
            column += 1;
            if height == cell {
                height -= cell;
                row += 1;
            }
            if column == last_column {
                break;
            }
            height += per_column;
        }
        height += in_last_column;
        visit(column, row);
        while height > cell {
            height -= cell;
            row += 1;
            visit(column, row);
        }
    } else {
        loop {
            visit(column, row);
            while height < 0 {
                height += cell;
                row -= 1;
                visit(column, row);
            }
            column += 1;
            if height == 0 {
                height += cell;
                row -= 1;
            }
            if column == last_column {
                break;
            }
            height += per_column;
        }
        height += in_last_column;
        visit(column, row);
        while height < 0 {
            height += cell;
            row -= 1;
            visit(column, row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MapLimits;
    use portolan_geometry::{Vector2, Vector2f};
    use proptest::prelude::*;

    fn cells(begin: [i64; 2], end: [i64; 2], scale: i64) -> Vec<(i64, i64)> {
        let mut cells = Vec::new();
        for_each_cell_on_ray(begin, end, scale, |x, y| cells.push((x, y)));
        cells
    }

    #[test]
    fn rays_on_single_cells() {
        let check = |b, e, expected: &[(i64, i64)]| {
            assert_eq!(cells(b, e, 1), expected);
            assert_eq!(cells(e, b, 1), expected);
        };
        check([1, 1], [1, 1], &[(1, 1)]);
        check([1, 1], [3, 1], &[(1, 1), (2, 1), (3, 1)]);
        check([1, 1], [1, 3], &[(1, 1), (1, 2), (1, 3)]);
        check([1, 1], [3, 3], &[(1, 1), (2, 2), (3, 3)]);
        check([1, 3], [3, 1], &[(1, 3), (2, 2), (3, 1)]);
        check([1, 1], [2, 5], &[(1, 1), (1, 2), (1, 3), (2, 3), (2, 4), (2, 5)]);
        check([1, 1], [2, 4], &[(1, 1), (1, 2), (2, 3), (2, 4)]);
        check([1, 1], [5, 2], &[(1, 1), (2, 1), (3, 1), (3, 2), (4, 2), (5, 2)]);
        check([1, 1], [4, 2], &[(1, 1), (2, 1), (3, 2), (4, 2)]);
    }

    #[test]
    fn finer_subpixels_trace_rays_more_accurately() {
        for scale in (0..14).map(|i| 1i64 << i).chain([20]) {
            let mask = |a: [f32; 2], b: [f32; 2]| {
                let limits = MapLimits::new(0.1, Vector2::new(1.0, 1.0), 20, 20).unwrap();
                let index = |p: [f32; 2]| limits.scaled_index(Vector2f::new(p[0], p[1]), 0.1 / scale as f64);
                cells(index(a), index(b), scale)
            };
            let straight = mask([0.05, 0.05], [0.35, 0.05]);
            assert_eq!(straight, [(9, 6), (9, 7), (9, 8), (9, 9)], "{scale}");
            if scale == 1 {
                assert_eq!(mask([0.01, 0.09], [0.21, 0.19]), [(8, 7), (8, 8), (9, 8), (9, 9)]);
            } else if scale == 20 {
                assert_eq!(mask([0.01, 0.09], [0.21, 0.19]), [(8, 7), (8, 8), (8, 9), (9, 9)]);
            }
        }
    }

    #[test]
    fn rays_equal_the_golden_ones() {
        let mut lcg = crate::testing::Lcg::new(7);
        let mut all = Vec::new();
        for _ in 0..200 {
            let [a0, a1, b0, b1] = [(); 4].map(|()| (lcg.unit() * 40000.0) as i64);
            all.extend(cells([a0, a1], [b0, b1], 1000));
        }
        assert_eq!(all.len(), 5759);
        let bytes: Vec<u8> =
            all.iter().flat_map(|(x, y)| [*x as i32, *y as i32]).flat_map(i32::to_le_bytes).collect();
        assert_eq!(crc32fast::hash(&bytes), 0x1c52_964d);
        assert_eq!(all[0], (9, 36));
    }

    proptest! {
        #[test]
        fn a_ray_is_connected_and_has_both_ends(b in prop::array::uniform2(0..30000i64), e in prop::array::uniform2(0..30000i64)) {
            let ray = cells(b, e, 1000);
            prop_assert!(ray.contains(&(b[0] / 1000, b[1] / 1000)) && ray.contains(&(e[0] / 1000, e[1] / 1000)));
            for pair in ray.windows(2) {
                let (dx, dy) = (pair[1].0 - pair[0].0, (pair[1].1 - pair[0].1).abs());
                prop_assert!((0..=1).contains(&dx) && dy <= 1 && dx + dy > 0);
            }
        }
    }
}
