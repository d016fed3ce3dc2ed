//! Draws submaps as images: two bytes per pixel, in the format of front ends.

use portolan_geometry::Rigid3;

use super::value::log_odds_byte;
use super::{CellBox, CellIndex, Grid2d, ProbabilityGrid, Tsdf2d};

/// An image of a submap.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Edge of a pixel, metres.
    pub resolution: f64,
    /// (value, alpha) of every pixel, row by row. Value is brightness taken away (occupied), alpha
    /// darkness; (0, 0) is unknown.
    pub value_alpha: Vec<u8>,
    /// The pose of the image in the submap: its corner with the largest coordinates.
    pub submap_from_slice: Rigid3,
}

impl Texture {
    /// The known part of a 2D submap whose grid is in the local map frame.
    pub fn of_grid(grid: &Grid2d, local_from_submap: &Rigid3) -> Self {
        let part = grid.known_cells_box().unwrap_or(CellBox::of(CellIndex::default()));
        let mut value_alpha =
            Vec::with_capacity(2 * part.num_x_cells() as usize * part.num_y_cells() as usize);
        for cell in part.cells() {
            value_alpha.extend(match grid {
                Grid2d::Probability(g) => probability_pixel(g, cell),
                Grid2d::Tsdf(g) => tsdf_pixel(g, cell),
            });
        }
        let corner = grid.limits().cropped(part).max();
        Self {
            width: part.num_x_cells(),
            height: part.num_y_cells(),
            resolution: grid.limits().resolution(),
            value_alpha,
            submap_from_slice: local_from_submap.inverse() * Rigid3::translation(corner.x, corner.y, 0.0),
        }
    }
}

/// The pixel of a probability.
pub(crate) fn pixel_of_probability(probability: f32) -> [u8; 2] {
    pixel_of_delta(128 - i32::from(log_odds_byte(probability)))
}

/// Positive differences from grey become value, negative ones alpha; a known pixel is never (0, 0).
fn pixel_of_delta(delta: i32) -> [u8; 2] {
    let byte = |v: i32| v.clamp(0, 255) as u8;
    let (value, alpha) = (byte(delta), byte(-delta));
    [value, if value == 0 && alpha == 0 { 1 } else { alpha }]
}

fn probability_pixel(grid: &ProbabilityGrid, cell: CellIndex) -> [u8; 2] {
    if grid.is_known(cell) { pixel_of_probability(grid.probability(cell)) } else { [0, 0] }
}

fn tsdf_pixel(grid: &Tsdf2d, cell: CellIndex) -> [u8; 2] {
    if !grid.is_known(cell) {
        return [0, 0];
    }
    let distance = (grid.signed_distance(cell).abs() / grid.truncation_distance()).sqrt();
    let weight = grid.weight(cell) / grid.max_weight();
    pixel_of_delta((weight * (distance * 255.0 - 128.0)).round() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{default_inserter, room_limits, room1};

    #[test]
    fn the_texture_of_a_room_equals_the_golden_one() {
        let mut grid = ProbabilityGrid::new(room_limits());
        (0..5).for_each(|_| assert!(default_inserter().insert(&room1(), &mut grid).is_ok()));
        let local_from_submap = Rigid3::translation(f64::from(0.3f32), f64::from(-0.2f32), 0.0);
        for grid in [Grid2d::from(grid.clone()), Grid2d::from(grid.cropped())] {
            let texture = Texture::of_grid(&grid, &local_from_submap);
            assert_eq!((texture.width, texture.height, texture.value_alpha.len()), (160, 200, 64000));
            assert_eq!(crc32fast::hash(&texture.value_alpha), 0x6828_9e54);
            let corner = texture.submap_from_slice.translation;
            assert!((corner.x - 5.70000008).abs() < 1e-8 && (corner.y - 5.20000008).abs() < 1e-8);
        }
    }

    #[test]
    fn an_unknown_grid_is_one_clear_pixel() {
        let grid = Grid2d::from(ProbabilityGrid::new(room_limits()));
        let texture = Texture::of_grid(&grid, &Rigid3::identity());
        assert_eq!((texture.width, texture.height, &texture.value_alpha[..]), (1, 1, &[0u8, 0][..]));
    }

    #[test]
    fn distance_fields_are_light_at_a_distance_and_dark_at_the_surface() {
        let mut tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
        for (x, distance) in [(0, 0.0), (1, 0.3)] {
            tsdf.set(CellIndex::new(x, 0), distance, 10.0);
        }
        tsdf.finish_update();
        let texture = Texture::of_grid(&tsdf.into(), &Rigid3::identity());
        assert_eq!(texture.value_alpha[..2], [0, 128]);
        assert_eq!(texture.value_alpha[2..], [127, 0]);
    }
}
