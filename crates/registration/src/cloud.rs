//! Prepares a scan for matching.

use portolan_spatial::{KdTree, LocalSurface, Neighbour, local_surfaces};

/// Points of a scan in its own frame (metres), with a search tree and, if requested, surfaces.
#[derive(Clone, Debug)]
pub struct ScanCloud {
    points: Vec<[f32; 3]>,
    tree: KdTree,
    surfaces: Vec<Option<LocalSurface>>,
    low: [f32; 3],
    high: [f32; 3],
}

impl ScanCloud {
    /// A scan for point-to-point matching.
    pub fn new(points: Vec<[f32; 3]>) -> Self {
        let tree = KdTree::new(&points);
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for k in 0..3 {
            for value in points.iter().map(|p| p[k]).filter(|v| v.is_finite()) {
                (low[k], high[k]) = (low[k].min(value), high[k].max(value));
            }
        }
        Self { points, tree, surfaces: Vec::new(), low, high }
    }

    /// A scan for matching with planes: normals from the `count` nearest points within `max_distance` metres.
    pub fn with_surfaces(points: Vec<[f32; 3]>, count: usize, max_distance: f32) -> Self {
        let mut cloud = Self::new(points);
        cloud.surfaces = local_surfaces(&cloud.points, &cloud.tree, count, max_distance);
        cloud
    }

    /// Orients all normals towards a viewpoint (metres, frame of the scan), so that the two sides of a wall
    /// can be distinguished.
    pub fn with_normals_towards(mut self, viewpoint: [f32; 3]) -> Self {
        for (point, surface) in self.points.iter().zip(&mut self.surfaces) {
            if let Some(surface) = surface {
                let towards: f32 = (0..3).map(|k| surface.normal[k] * (viewpoint[k] - point[k])).sum();
                if towards < 0.0 {
                    surface.normal = surface.normal.map(|v| -v);
                }
            }
        }
        self
    }

    /// The points.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// The search tree.
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// The nearest point within `max_distance` metres.
    pub fn nearest(&self, query: [f32; 3], max_distance: f32) -> Option<Neighbour> {
        if self.is_outside(query, max_distance) {
            return None;
        }
        self.tree.nearest(query, max_distance)
    }

    /// Whether there is a point within `max_distance` metres.
    pub fn has_within(&self, query: [f32; 3], max_distance: f32) -> bool {
        !self.is_outside(query, max_distance) && self.tree.has_within(query, max_distance)
    }

    /// The nearest point within `max_distance` metres of those that `accept` (by index).
    pub fn nearest_where(
        &self,
        query: [f32; 3],
        max_distance: f32,
        accept: impl FnMut(u32) -> bool,
    ) -> Option<Neighbour> {
        if self.is_outside(query, max_distance) {
            return None;
        }
        self.tree.nearest_where(query, max_distance, accept)
    }

    /// The nearest point within `max_distance` metres, and a lower bound of the distance of all others.
    pub fn nearest_two(&self, query: [f32; 3], max_distance: f32) -> Option<(Neighbour, f32)> {
        if self.is_outside(query, max_distance) {
            return None;
        }
        self.tree.nearest_two(query, max_distance)
    }

    /// Whether a query is farther than this from the bounding box, and so from every point.
    fn is_outside(&self, query: [f32; 3], max_distance: f32) -> bool {
        (0..3).any(|k| query[k] < self.low[k] - max_distance || query[k] > self.high[k] + max_distance)
    }

    /// Least and greatest coordinates, metres; the first above the second without points.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        [self.low, self.high]
    }

    /// Number of points that have a surface.
    pub fn surface_count(&self) -> usize {
        self.surfaces.iter().flatten().count()
    }

    /// The surface at a point, if it was computed and there is one.
    pub fn surface(&self, index: usize) -> Option<&LocalSurface> {
        self.surfaces.get(index)?.as_ref()
    }
}
