//! Normals and planarity of points from their neighbours.

use portolan_geometry::Vector3;
use rayon::prelude::*;

use crate::{KdTree, Moments, Neighbour};

/// The local surface around a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalSurface {
    /// Unit normal; its sign is arbitrary.
    pub normal: [f32; 3],
    /// Standard deviation across the surface, metres.
    pub thickness: f32,
    /// `(λ₂ − λ₁) / λ₃` of the covariance of the neighbourhood: 1 for a plane, 0 for a line or a ball.
    pub planarity: f32,
}

/// Fits a plane to the `count` nearest neighbours of each point within `max_distance` (metres; the point
/// itself included). `None` if there are fewer than four or they are collinear.
pub fn local_surfaces(
    points: &[[f32; 3]],
    tree: &KdTree,
    count: usize,
    max_distance: f32,
) -> Vec<Option<LocalSurface>> {
    let surface = |found: &mut Vec<Neighbour>, query: &[f32; 3]| {
        tree.k_nearest(*query, count, max_distance, found);
        surface_of(points, *query, found)
    };
    points.par_iter().map_init(Vec::new, surface).collect()
}

/// The surface around any position, computed as [`local_surfaces`] does around points.
pub fn local_surface(
    points: &[[f32; 3]],
    tree: &KdTree,
    place: [f32; 3],
    count: usize,
    max_distance: f32,
) -> Option<LocalSurface> {
    let mut found = Vec::with_capacity(count);
    tree.k_nearest(place, count, max_distance, &mut found);
    surface_of(points, place, &found)
}

fn surface_of(points: &[[f32; 3]], place: [f32; 3], found: &[Neighbour]) -> Option<LocalSurface> {
    let mut moments = Moments::default();
    for neighbour in found {
        let p = points[neighbour.index as usize];
        moments.add(&Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k] - place[k]))));
    }
    let plane = moments.plane().filter(|plane| found.len() >= 4 && plane.variances[1] > 1e-12)?;
    let [across, middle, along] = plane.variances;
    Some(LocalSurface {
        normal: [plane.normal.x as f32, plane.normal.y as f32, plane.normal.z as f32],
        thickness: across.sqrt() as f32,
        planarity: ((middle - across) / along.max(f64::MIN_POSITIVE)) as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_have_normals_and_lines_have_none() {
        let wall: Vec<[f32; 3]> =
            (0..400).map(|i| [2.0, (i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1]).collect();
        let surfaces = local_surfaces(&wall, &KdTree::new(&wall), 12, 1.0);
        assert!(surfaces.iter().all(|s| s.is_some_and(|s| s.normal[0].abs() > 0.999 && s.thickness < 1e-3)));
        let line: Vec<[f32; 3]> = (0..40).map(|i| [i as f32 * 0.1, 0.0, 0.0]).collect();
        assert!(local_surfaces(&line, &KdTree::new(&line), 8, 1.0).iter().all(Option::is_none));
    }
}
