//! Joins cells that touch to regions with outlines.

use std::collections::{BTreeMap, BTreeSet};

/// Cells that touch each other, at corners at least.
#[derive(Clone, Debug)]
pub(crate) struct Region {
    /// Flat indices.
    pub cells: BTreeSet<usize>,
    /// Corners of cells (column, row) where outlines turn. The outer ring comes first and turns from columns
    /// to rows; holes turn the other way.
    pub rings: Vec<Vec<[i64; 2]>>,
}

/// The regions that cells form in a grid with this number of columns, in the order of their first cells.
pub(crate) fn regions(cells: &BTreeSet<usize>, columns: usize) -> Vec<Region> {
    let mut left: BTreeSet<[i64; 2]> =
        cells.iter().map(|i| [(i % columns) as i64, (i / columns) as i64]).collect();
    let mut regions = Vec::new();
    while let Some(first) = left.iter().next().copied() {
        left.remove(&first);
        let (mut region, mut open) = (BTreeSet::from([first]), vec![first]);
        while let Some([x, y]) = open.pop() {
            let around = (-1..=1).flat_map(|j| (-1..=1).map(move |i| [x + i, y + j]));
            for cell in around.filter(|cell| left.remove(cell)).collect::<Vec<_>>() {
                region.insert(cell);
                open.push(cell);
            }
        }
        let flat = |[x, y]: &[i64; 2]| *y as usize * columns + *x as usize;
        regions.push(Region {
            cells: region.iter().map(flat).collect(),
            rings: rings(&without_pinches(region)),
        });
    }
    regions.sort_by_key(|region| region.cells.first().copied());
    regions
}

/// Fills one cell wherever two cells touch at a corner alone, so that outlines never touch themselves.
fn without_pinches(cells: BTreeSet<[i64; 2]>) -> BTreeSet<[i64; 2]> {
    let mut cells = cells;
    let mut open: Vec<[i64; 2]> = cells.iter().copied().collect();
    while let Some([x, y]) = open.pop() {
        for (i, j) in [(-1, -1), (-1, 1), (1, -1), (1, 1)] {
            let is_pinch = cells.contains(&[x + i, y + j])
                && !cells.contains(&[x + i, y])
                && !cells.contains(&[x, y + j]);
            if is_pinch {
                cells.insert([x + i, y]);
                open.push([x + i, y]);
            }
        }
    }
    cells
}

/// Outlines of cells that are connected along edges, the outer one first.
fn rings(cells: &BTreeSet<[i64; 2]>) -> Vec<Vec<[i64; 2]>> {
    // Boundary edges of cells, from corner to corner around each cell; no corner has two.
    let mut edges: BTreeMap<[i64; 2], [i64; 2]> = BTreeMap::new();
    for [x, y] in cells {
        let [a, b, c, d] = [[*x, *y], [x + 1, *y], [x + 1, y + 1], [*x, y + 1]];
        let sides = [(a, b, [*x, y - 1]), (b, c, [x + 1, *y]), (c, d, [*x, y + 1]), (d, a, [x - 1, *y])];
        for (from, to, _) in sides.into_iter().filter(|(.., behind)| !cells.contains(behind)) {
            edges.insert(from, to);
        }
    }
    let mut rings = Vec::new();
    while let Some((start, _)) = edges.first_key_value() {
        let start = *start;
        let mut ring = Vec::new();
        let mut at = start;
        while let Some(next) = edges.remove(&at) {
            ring.push(at);
            at = next;
        }
        rings.push(turning_points(&ring));
    }
    rings
}

/// A ring without the corners at which it goes straight on.
fn turning_points(ring: &[[i64; 2]]) -> Vec<[i64; 2]> {
    let before = ring.iter().cycle().skip(ring.len().saturating_sub(1));
    let after = ring.iter().cycle().skip(1);
    let turns = |([ax, ay], [bx, by], [cx, cy]): (&[i64; 2], &[i64; 2], &[i64; 2])| {
        (bx - ax, by - ay) != (cx - bx, cy - by)
    };
    let around = before.zip(ring).zip(after).map(|((before, at), after)| (before, at, after));
    around.filter(|corners| turns(*corners)).map(|(_, at, _)| *at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(picture: &[&str]) -> BTreeSet<usize> {
        let columns = picture[0].len();
        let all = picture
            .iter()
            .enumerate()
            .flat_map(|(y, row)| row.bytes().enumerate().map(move |(x, c)| (x, y, c)));
        all.filter(|(_, _, c)| *c == b'#').map(|(x, y, _)| y * columns + x).collect()
    }

    /// Twice the area that a ring goes around, positive as the outer ring goes.
    fn area(ring: &[[i64; 2]]) -> i64 {
        let pairs = ring.iter().zip(ring.iter().cycle().skip(1));
        pairs.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
    }

    #[test]
    fn a_ring_of_cells_has_an_outline_and_a_hole() {
        let found = regions(&cells(&["........", ".####...", ".#..#..#", ".####...", "........"]), 8);
        assert_eq!(found.len(), 2);
        assert_eq!(found[0].cells.len(), 10);
        assert_eq!(found[0].rings[0], [[1, 1], [5, 1], [5, 4], [1, 4]]);
        assert_eq!((found[0].rings.len(), area(&found[0].rings[0]), area(&found[0].rings[1])), (2, 24, -4));
        assert_eq!(found[1].rings, [vec![[7, 2], [8, 2], [8, 3], [7, 3]]]);
    }

    #[test]
    fn a_diagonal_is_one_region_whose_outline_does_not_touch_itself() {
        let found = regions(&cells(&["#...", ".#..", "..#.", ".#.#"]), 4);
        assert_eq!((found.len(), found[0].cells.len()), (1, 5));
        let ring = &found[0].rings[0];
        let corners: BTreeSet<_> = ring.iter().collect();
        assert_eq!((found[0].rings.len(), corners.len()), (1, ring.len()), "{ring:?}");
    }
}
