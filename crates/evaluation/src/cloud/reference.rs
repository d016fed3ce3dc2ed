//! Ground truth from a more accurate cloud, for example of a terrestrial laser scanner.

use portolan_geometry::Vector3;
use portolan_spatial::KdTree;
use portolan_spatial::Moments;

/// Number of points of the reference that define the local surface.
const NEIGHBOURS: usize = 12;
/// Limit of the distance along the surface from the nearest reference point, in multiples of the mean
/// distance of its neighbours. Beyond it a point is beside the reference, and its distance to the nearest
/// point is used instead of that to the plane.
const BESIDE: f64 = 2.0;

/// The points of a reference cloud with a search tree.
#[derive(Clone, Debug)]
pub struct ReferenceCloud {
    origin: [f64; 3],
    points: Vec<[f32; 3]>,
    tree: KdTree,
}

impl ReferenceCloud {
    /// Builds the search tree of points (metres). `None` if fewer than three are finite.
    pub fn new(points: &[[f64; 3]]) -> Option<Self> {
        let origin = *points.iter().find(|p| p.iter().all(|v| v.is_finite()))?;
        let points: Vec<[f32; 3]> =
            points.iter().map(|p| std::array::from_fn(|k| (p[k] - origin[k]) as f32)).collect();
        let tree = KdTree::new(&points);
        (tree.len() >= 3).then_some(Self { origin, points, tree })
    }

    /// Distance of a point to the surface, metres: to the plane through the neighbours of the nearest
    /// reference point where these are planar, otherwise to the nearest point.
    pub(crate) fn distance(&self, point: [f64; 3], found: &mut Vec<portolan_spatial::Neighbour>) -> f64 {
        let query: [f32; 3] = std::array::from_fn(|k| (point[k] - self.origin[k]) as f32);
        let Some(nearest) = self.tree.nearest(query, f32::INFINITY) else { return f64::INFINITY };
        let centre = self.points[nearest.index as usize];
        let to_nearest = f64::from(nearest.squared_distance).sqrt();
        self.tree.k_nearest(centre, NEIGHBOURS, f32::INFINITY, found);
        let mut moments = Moments::default();
        let mut spacing = 0.0;
        for neighbour in found.iter() {
            let p = self.points[neighbour.index as usize];
            moments.add(&Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(p[k] - centre[k]))));
            spacing += f64::from(neighbour.squared_distance).sqrt();
        }
        spacing /= found.len() as f64;
        let Some(plane) = moments.plane() else { return to_nearest };
        let [across, middle, _] = plane.variances;
        let from_centre =
            Vector3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(query[k] - centre[k])));
        let height = plane.normal.dot(&(from_centre - plane.mean)).abs();
        let along = (from_centre.norm_squared() - plane.normal.dot(&from_centre).powi(2)).max(0.0).sqrt();
        let is_surface = across < 0.1 * middle && along <= BESIDE * spacing;
        if is_surface { height.min(to_nearest) } else { to_nearest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plane_counts_between_points_and_the_point_beside_them() {
        let wall: Vec<[f64; 3]> =
            (0..400).map(|i| [5e6, f64::from(i % 20) * 0.1, f64::from(i / 20) * 0.1]).collect();
        let reference = ReferenceCloud::new(&wall).unwrap();
        let mut found = Vec::new();
        let between = reference.distance([5e6 + 0.03, 0.95, 0.95], &mut found);
        assert!((between - 0.03).abs() < 1e-6, "{between}");
        let beside = reference.distance([5e6, -1.0, 0.0], &mut found);
        assert!((beside - 1.0).abs() < 1e-6, "{beside}");
        assert!(ReferenceCloud::new(&[[f64::NAN; 3]; 9]).is_none());
    }
}
