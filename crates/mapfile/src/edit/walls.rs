//! Finds the direction of the walls of a building.

use portolan_geometry::NearFrame;
use portolan_geometry::nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use super::{EditError, MapDraft};
use crate::load_textures::{MapTextures, load_placed_textures};
use crate::paint::PlacedTexture;
use portolan_pbstream::MapReader;
use portolan_pbstream::submap_poses;

/// Maximum number of wall points; more are thinned out.
const MAX_POINTS: usize = 100_000;
/// Width of the stripes in which points are counted, metres.
const STRIPE: f64 = 0.1;
/// Angular steps of the search, degrees.
const COARSE_STEP: f64 = 0.5;
const FINE_STEP: f64 = 0.05;
/// Minimum ratio of the score of the best direction to the mean score; dimensionless.
const MIN_CONTRAST: f64 = 1.08;
/// Minimum alpha of a pixel of a wall.
const MIN_ALPHA: u8 = 24;

/// Common direction of the walls (parallel or at right angles to it).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Walls {
    /// Angle of the walls to the x axis, radians, above −π/4 and up to π/4.
    pub angle: f64,
    /// Ratio of the score of this direction to the mean score.
    pub contrast: f64,
}

impl MapDraft {
    /// Textures of all submaps at their current poses.
    ///
    /// # Errors
    /// If the files cannot be read.
    pub fn textures(&self) -> Result<MapTextures, EditError> {
        let poses = submap_poses(&self.graph);
        let mut all = MapTextures::default();
        for source in &self.sources {
            let failed = |error| EditError::File { path: source.path.clone(), source: error };
            let mut reader = MapReader::open_with(&source.path, self.limits).map_err(failed)?;
            let placement = |(trajectory, index)| {
                let id = (*source.ids.get(&trajectory)?, index);
                poses.get(&id).map(|pose| (id, Some(*pose)))
            };
            let mut found = load_placed_textures(&mut reader, &placement).map_err(failed)?;
            all.textures.append(&mut found.textures);
            all.skipped.append(&mut found.skipped);
        }
        all.textures.sort_by_key(|t| t.id);
        Ok(all)
    }

    /// The direction of the walls in the current map.
    ///
    /// # Errors
    /// If the files cannot be read, or if there is no distinct direction.
    pub fn walls(&self) -> Result<Walls, EditError> {
        find_walls(&self.textures()?.textures).ok_or(EditError::NoWalls)
    }
}

/// Finds the direction in which occupied space forms straight lines. Projected along it, the points of walls
/// fall into few stripes, so that the squares of their counts are large. None if there is no distinct
/// direction.
pub fn find_walls(textures: &[PlacedTexture]) -> Option<Walls> {
    let points = wall_points(textures);
    if points.len() < 50 {
        return None;
    }
    let count = (90.0 / COARSE_STEP) as usize;
    let angles: Vec<f64> = (0..count).map(|i| i as f64 * COARSE_STEP).collect();
    let coarse = scores(&points, &angles);
    let mean = coarse.iter().sum::<f64>() / coarse.len() as f64;
    let (best, _) = best(&angles, &coarse)?;
    let steps = (COARSE_STEP / FINE_STEP).round() as i32;
    let fine_angles: Vec<f64> = (-steps..=steps).map(|i| best + f64::from(i) * FINE_STEP).collect();
    let fine = scores(&points, &fine_angles);
    let (_, at) = self::best(&fine_angles, &fine)?;
    let degrees = fine_angles.get(at)? + FINE_STEP * vertex_of_parabola(&fine, at);
    let contrast = fine.get(at)? / mean;
    let wrapped = if degrees > 45.0 { degrees - 90.0 } else { degrees };
    (contrast >= MIN_CONTRAST).then_some(Walls { angle: wrapped.to_radians(), contrast })
}

/// Positions of occupied pixels in a near frame.
fn wall_points(textures: &[PlacedTexture]) -> Vec<[f64; 2]> {
    let is_wall = |p: &[u8; 2]| p[1] >= MIN_ALPHA;
    let count = |t: &PlacedTexture| t.texture.pixels().iter().filter(|p| is_wall(p)).count();
    let total: usize = textures.par_iter().map(count).sum();
    let stride = total.div_ceil(MAX_POINTS).max(1);
    let frame = NearFrame::around(textures.iter().map(|placed| placed.map_from_submap.translation.vector));
    let mut points = Vec::with_capacity(total / stride + 1);
    let mut seen = 0;
    for placed in textures {
        let texture = &placed.texture;
        let near_from_slice = frame.near(&placed.map_from_submap) * texture.submap_from_slice;
        for (index, _) in texture.pixels().iter().enumerate().filter(|(_, p)| is_wall(p)) {
            seen += 1;
            if seen % stride != 0 {
                continue;
            }
            let (row, column) = (index / texture.width.max(1), index % texture.width.max(1));
            let metres = |i: usize| -(i as f64 + 0.5) * texture.resolution;
            let p = near_from_slice * Point3::new(metres(row), metres(column), 0.0);
            if p.x.is_finite() && p.y.is_finite() && p.x.abs() < 1e5 && p.y.abs() < 1e5 {
                points.push([p.x, p.y]);
            }
        }
    }
    points
}

fn scores(points: &[[f64; 2]], degrees: &[f64]) -> Vec<f64> {
    degrees.par_iter().map(|d| score(points, d.to_radians())).collect()
}

/// Sum of the squared counts in stripes along and across a direction.
fn score(points: &[[f64; 2]], angle: f64) -> f64 {
    let (s, c) = angle.sin_cos();
    stripes(points, |[x, y]| c * x + s * y) + stripes(points, |[x, y]| c * y - s * x)
}

fn stripes(points: &[[f64; 2]], project: impl Fn([f64; 2]) -> f64) -> f64 {
    let values: Vec<f64> = points.iter().map(|p| project(*p) / STRIPE).collect();
    let (min, max) =
        values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
    if min > max {
        return 0.0;
    }
    // Each point is shared between neighbouring stripes, so that the borders do not matter. Positions are
    // below 1e5 m.
    let mut counts = vec![0.0_f64; (max - min) as usize + 2];
    for value in values {
        let (index, part) = ((value - min) as usize, (value - min).fract());
        if let Some([a, b]) = counts.get_mut(index..index + 2) {
            *a += 1.0 - part;
            *b += part;
        }
    }
    counts.iter().map(|c| c * c).sum()
}

fn best(angles: &[f64], scores: &[f64]) -> Option<(f64, usize)> {
    let (index, _) = scores.iter().enumerate().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    Some((*angles.get(index)?, index))
}

/// Position of the maximum of the parabola through a value and its neighbours, relative to the value, in steps.
fn vertex_of_parabola(values: &[f64], at: usize) -> f64 {
    let (Some(before), Some(value), Some(after)) =
        (at.checked_sub(1).and_then(|i| values.get(i)), values.get(at), values.get(at + 1))
    else {
        return 0.0;
    };
    let curvature = before - 2.0 * value + after;
    if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::texture::SubmapTexture;
    use portolan_geometry::{Rigid3, Vector3};

    /// A room of 10 m by 6 m, rotated by `degrees`.
    fn room(degrees: f64) -> PlacedTexture {
        let (width, height) = (120, 200);
        let wall = |i: usize| {
            let (row, column) = (i / width, i % width);
            row < 2 || column < 2 || row + 2 >= height || column + 2 >= width
        };
        let pixels = (0..width * height).map(|i| if wall(i) { [0, 100] } else { [60, 0] }).collect();
        let texture =
            SubmapTexture { pixels, width, height, resolution: 0.05, submap_from_slice: Rigid3::identity() };
        let turn = Vector3::z() * degrees.to_radians();
        PlacedTexture {
            id: (0, 0),
            map_from_submap: Rigid3::new(Vector3::new(3.0, -2.0, 0.0), turn),
            texture: texture.into(),
        }
    }

    #[test]
    fn the_walls_of_a_room_are_found() {
        for degrees in [0.0, 7.3, 44.0, -30.0, 83.0] {
            let walls = find_walls(&[room(degrees)]).unwrap();
            let off = (walls.angle.to_degrees() - degrees).rem_euclid(90.0);
            assert!(off.min(90.0 - off) < 0.05, "{degrees}: {walls:?}");
        }
    }

    #[test]
    fn the_walls_of_a_room_far_from_the_origin_are_found() {
        let mut room = room(7.3);
        room.map_from_submap =
            portolan_geometry::moved(&room.map_from_submap, &Vector3::new(5e5, 5.4e6, 0.0));
        assert!((find_walls(&[room]).unwrap().angle.to_degrees() - 7.3).abs() < 0.05);
    }

    #[test]
    fn an_empty_map_has_no_walls() {
        assert_eq!(find_walls(&[]), None);
    }
}
