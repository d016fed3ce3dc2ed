//! Ray casting through a uniform grid of shapes.
//!
//! A ray visits the cells along it in order (Amanatides and Woo, "A fast voxel traversal algorithm
//! for ray tracing", 1987) and stops in the first cell that holds a hit.

use portolan_geometry::Vector2;

use super::shape::{Hit, Material, Outline, Ray, Shape, cross};

/// Maximum number of panes that are reported before a solid hit; further ones count as perfectly clear.
const MAX_PANES: usize = 6;

/// Maximum number of cells; cells are larger where there would be more.
const MAX_CELLS: f64 = 4e6;

/// Distance from a cell up to which shapes count as inside it, metres, so that no hit is lost by rounding
/// along cell borders.
const BORDER: f64 = 1e-6;

/// Hits of a ray: at most one solid surface, and the panes before it in ascending order of range.
#[derive(Clone, Copy, Debug, Default)]
pub struct Crossings {
    /// The nearest surface that is not glass.
    pub solid: Option<Hit>,
    panes: [Option<Hit>; MAX_PANES],
}

impl Crossings {
    /// Glass before the solid hit, nearest first.
    pub fn panes(&self) -> impl Iterator<Item = Hit> + '_ {
        let limit = self.solid.map_or(f64::INFINITY, |hit| hit.range);
        self.panes.iter().map_while(|pane| *pane).take_while(move |pane| pane.range < limit)
    }

    /// Adds a hit. The same pane may be hit again from another cell.
    fn add(&mut self, hit: Hit) {
        if hit.material != Material::Glass {
            if self.solid.is_none_or(|solid| hit.range < solid.range) {
                self.solid = Some(hit);
            }
            return;
        }
        let mut carried = Some(hit);
        for slot in &mut self.panes {
            match (*slot, carried) {
                (Some(there), Some(new)) if there.range == new.range => return,
                (Some(there), Some(new)) if there.range < new.range => {}
                _ => std::mem::swap(slot, &mut carried),
            }
            if carried.is_none() {
                return;
            }
        }
    }
}

/// Shapes sorted into square cells.
#[derive(Clone, Debug)]
pub struct ShapeGrid {
    minimum: Vector2,
    cell_size: f64,
    columns: usize,
    rows: usize,
    /// Index in `members` at which the shapes of a cell start; one entry more than there are cells.
    starts: Vec<u32>,
    members: Vec<u32>,
    shapes: Vec<Shape>,
}

impl ShapeGrid {
    /// Sorts the shapes into cells of about `cell_size` metres. Shapes that are not finite are left out.
    pub fn new(mut shapes: Vec<Shape>, cell_size: f64) -> Self {
        shapes.retain(|shape| (shape.bounds().1 - shape.bounds().0).norm().is_finite());
        let (mut minimum, mut maximum) = (Vector2::zeros(), Vector2::zeros());
        for (i, (low, high)) in shapes.iter().map(Shape::bounds).enumerate() {
            (minimum, maximum) = if i == 0 { (low, high) } else { (minimum.inf(&low), maximum.sup(&high)) };
        }
        let margin = Vector2::new(0.01, 0.01);
        (minimum, maximum) = (minimum - margin, maximum + margin);
        let extent = maximum - minimum;
        let cell_size = cell_size.max(1e-3).max(extent.x.max(extent.y) / MAX_CELLS.sqrt());
        let columns = ((maximum.x - minimum.x) / cell_size).ceil() as usize;
        let rows = ((maximum.y - minimum.y) / cell_size).ceil() as usize;
        let mut grid =
            Self { minimum, cell_size, columns, rows, starts: Vec::new(), members: Vec::new(), shapes };
        grid.sort_into_cells();
        grid
    }

    /// All shapes.
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Lower left and upper right corner of the grid, metres.
    pub fn bounds(&self) -> (Vector2, Vector2) {
        let size = Vector2::new(self.columns as f64, self.rows as f64) * self.cell_size;
        (self.minimum, self.minimum + size)
    }

    fn sort_into_cells(&mut self) {
        let mut cells: Vec<Vec<u32>> = vec![Vec::new(); self.columns * self.rows];
        for (index, shape) in self.shapes.iter().enumerate() {
            let (low, high) = shape.bounds();
            let (first_column, first_row) = self.cell_of(&(low - Vector2::new(BORDER, BORDER)));
            let (last_column, last_row) = self.cell_of(&(high + Vector2::new(BORDER, BORDER)));
            for row in first_row..=last_row {
                for column in first_column..=last_column {
                    if self.touches(shape, column, row) {
                        cells[row * self.columns + column].push(index as u32);
                    }
                }
            }
        }
        self.starts.push(0);
        for cell in cells {
            self.members.extend(cell);
            self.starts.push(self.members.len() as u32);
        }
    }

    /// Column and row of the cell around a point; the nearest cell for points outside.
    fn cell_of(&self, point: &Vector2) -> (usize, usize) {
        let cell = (point - self.minimum) / self.cell_size;
        ((cell.x as usize).min(self.columns - 1), (cell.y as usize).min(self.rows - 1))
    }

    fn touches(&self, shape: &Shape, column: usize, row: usize) -> bool {
        let half = 0.5 * self.cell_size + BORDER;
        let centre = self.minimum + Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * self.cell_size;
        match shape.outline {
            // Separating axes of a box and a segment: x, y (by the loop over the bounds), its normal.
            Outline::Segment { start, along } => {
                cross(&along, &(centre - start)).abs() <= half * (along.x.abs() + along.y.abs())
            }
            Outline::Circle { centre: middle, radius } => {
                let offset = (centre - middle).abs();
                let nearest = (offset - Vector2::new(half, half)).sup(&Vector2::zeros());
                let farthest = offset + Vector2::new(half, half);
                nearest.norm() <= radius && farthest.norm() >= radius
            }
        }
    }

    /// The hits of a ray up to `max_range` metres.
    pub fn cast(&self, ray: &Ray, max_range: f64) -> Crossings {
        let mut found = Crossings::default();
        let Some((entry, exit)) = self.clip(ray) else { return found };
        let end = exit.min(max_range);
        if entry > end {
            return found;
        }
        let (mut column, mut row) = self.cell_of(&(ray.origin + ray.direction * entry));
        let mut along_x = Axis::new(ray.origin.x, ray.direction.x, self.minimum.x, self.cell_size, column);
        let mut along_y = Axis::new(ray.origin.y, ray.direction.y, self.minimum.y, self.cell_size, row);
        loop {
            let cell = row * self.columns + column;
            let members = self.starts[cell] as usize..self.starts[cell + 1] as usize;
            for &index in &self.members[members] {
                if let Some(hit) = self.shapes[index as usize].intersect(ray)
                    && hit.range <= max_range
                {
                    found.add(hit);
                }
            }
            let leaves_at = along_x.next.min(along_y.next);
            if leaves_at > end || found.solid.is_some_and(|hit| hit.range <= leaves_at) {
                return found;
            }
            let inside = if along_x.next < along_y.next {
                along_x.advance(&mut column, self.columns)
            } else {
                along_y.advance(&mut row, self.rows)
            };
            if !inside {
                return found;
            }
        }
    }

    /// Ranges at which the ray enters and leaves the grid, metres; none if it misses the grid.
    fn clip(&self, ray: &Ray) -> Option<(f64, f64)> {
        let (low, high) = self.bounds();
        let (mut entry, mut exit) = (0.0_f64, f64::INFINITY);
        for axis in 0..2 {
            let (origin, direction) = (ray.origin[axis], ray.direction[axis]);
            if direction == 0.0 {
                if origin < low[axis] || origin > high[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low[axis] - origin) / direction, (high[axis] - origin) / direction);
            entry = entry.max(a.min(b));
            exit = exit.min(a.max(b));
        }
        (entry <= exit).then_some((entry, exit))
    }
}

/// Progress of a ray along one axis of the grid.
struct Axis {
    /// Range at which the ray leaves the current cell, metres.
    next: f64,
    /// Distance along the ray per cell, metres.
    step: f64,
    forward: bool,
}

impl Axis {
    fn new(origin: f64, direction: f64, minimum: f64, cell_size: f64, cell: usize) -> Self {
        if direction == 0.0 {
            return Self { next: f64::INFINITY, step: f64::INFINITY, forward: true };
        }
        let forward = direction > 0.0;
        let border = minimum + (cell as f64 + if forward { 1.0 } else { 0.0 }) * cell_size;
        Self { next: (border - origin) / direction, step: cell_size / direction.abs(), forward }
    }

    /// Goes to the next cell; false when that is outside.
    fn advance(&mut self, cell: &mut usize, count: usize) -> bool {
        self.next += self.step;
        if self.forward {
            *cell += 1;
            *cell < count
        } else {
            let inside = *cell > 0;
            *cell = cell.saturating_sub(1);
            inside
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn clutter(seed: u64, count: usize) -> Vec<Shape> {
        let mut random = Random::new(seed, "clutter", 0);
        (0..count)
            .map(|i| {
                let material = if i % 5 == 0 { Material::Glass } else { Material::Wall };
                let at = Vector2::new(random.between(-8.0, 12.0), random.between(-3.0, 9.0));
                match i % 3 {
                    0 => Shape::circle(at, random.between(0.02, 0.8), material),
                    1 => {
                        // Aligned with cell borders now and then.
                        let at = at.map(f64::round);
                        Shape::segment(
                            at,
                            at + Vector2::new(0.0, random.between(-4.0, 4.0).round()),
                            material,
                        )
                    }
                    _ => {
                        let to = Vector2::new(random.between(-4.0, 4.0), random.between(-4.0, 4.0));
                        Shape::segment(at, at + to, material)
                    }
                }
            })
            .collect()
    }

    fn brute_force(shapes: &[Shape], ray: &Ray, max_range: f64) -> (Option<f64>, Vec<f64>) {
        let hits = || shapes.iter().filter_map(|s| s.intersect(ray)).filter(|h| h.range <= max_range);
        let solid = hits().filter(|h| h.material != Material::Glass).map(|h| h.range).min_by(f64::total_cmp);
        let mut panes: Vec<f64> = hits()
            .filter(|h| h.material == Material::Glass && solid.is_none_or(|s| h.range < s))
            .map(|h| h.range)
            .collect();
        panes.sort_by(f64::total_cmp);
        // Coinciding panes count as one.
        panes.dedup();
        panes.truncate(MAX_PANES);
        (solid, panes)
    }

    #[test]
    fn the_grid_agrees_with_brute_force() {
        for seed in 0..20 {
            let shapes = clutter(seed, 60);
            let grid = ShapeGrid::new(shapes.clone(), 0.5);
            let mut random = Random::new(seed, "rays", 0);
            for i in 0..500 {
                let (sine, cosine) = match i % 10 {
                    0 => (0.0, 1.0),
                    1 => (-1.0, 0.0),
                    _ => libm::sincos(random.between(-4.0, 4.0)),
                };
                let origin = Vector2::new(random.between(-10.0, 14.0), random.between(-5.0, 11.0));
                let ray = Ray { origin, direction: Vector2::new(cosine, sine) };
                let max_range = random.between(1.0, 30.0);
                let found = grid.cast(&ray, max_range);
                let (solid, panes) = brute_force(&shapes, &ray, max_range);
                assert_eq!(found.solid.map(|h| h.range), solid, "seed {seed} ray {i}");
                assert_eq!(found.panes().map(|h| h.range).collect::<Vec<_>>(), panes, "seed {seed} ray {i}");
            }
        }
    }

    #[test]
    fn an_empty_world_has_no_hits() {
        let grid = ShapeGrid::new(Vec::new(), 0.5);
        let ray = Ray { origin: Vector2::zeros(), direction: Vector2::x() };
        assert!(grid.cast(&ray, 10.0).solid.is_none());
    }
}
