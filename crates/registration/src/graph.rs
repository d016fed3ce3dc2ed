//! Determines which scans are matched with each other.

use std::borrow::Borrow;

use portolan_geometry::{Rigid3, nalgebra as na};
use rayon::prelude::*;

use super::ScanCloud;

/// Two scans that are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Link {
    /// The earlier scan.
    pub from: usize,
    /// The later scan.
    pub to: usize,
}

/// Links neighbours, and scans with indices more than `min_loop` apart whose positions are within
/// `max_distance` metres of each other.
pub fn links_by_distance(world_from_scan: &[Rigid3], min_loop: usize, max_distance: f64) -> Vec<Link> {
    let mut links = Vec::new();
    for (from, a) in world_from_scan.iter().enumerate() {
        for (to, b) in world_from_scan.iter().enumerate().skip(from + 1) {
            let near = (a.translation.vector - b.translation.vector).norm() < max_distance;
            if to == from + 1 || (to - from > min_loop && near) {
                links.push(Link { from, to });
            }
        }
    }
    links
}

/// Links scans with more than `min_pairs` points of the later one within `max_distance` metres of a point of
/// the earlier one. Each two scans are linked at most once.
pub fn links_by_overlap<S: Borrow<ScanCloud> + Sync>(
    scans: &[S],
    world_from_scan: &[Rigid3],
    min_pairs: usize,
    max_distance: f64,
) -> Vec<Link> {
    let candidates: Vec<Link> =
        (0..scans.len()).flat_map(|from| (from + 1..scans.len()).map(move |to| Link { from, to })).collect();
    let overlapping: Vec<Option<Link>> = candidates
        .into_par_iter()
        .map(|link| {
            let (Some(a), Some(b)) = (world_from_scan.get(link.from), world_from_scan.get(link.to)) else {
                return None;
            };
            let a_from_b = a.inverse() * b;
            let mut count = 0;
            let (earlier, points) = (scans[link.from].borrow(), scans[link.to].borrow().points());
            for (i, p) in points.iter().enumerate() {
                if count + (points.len() - i) <= min_pairs {
                    return None;
                }
                let x = a_from_b * na::Point3::from(p.map(f64::from));
                let query = [x.x as f32, x.y as f32, x.z as f32];
                count += usize::from(earlier.has_within(query, max_distance as f32));
                if count > min_pairs {
                    return Some(link);
                }
            }
            None
        })
        .collect();
    overlapping.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loops_and_overlaps_are_linked_once() {
        let place = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        let poses = [place(0.0), place(5.0), place(9.0), place(0.5)];
        let near = links_by_distance(&poses, 1, 1.0);
        assert_eq!(near.len(), 4);
        assert!(near.contains(&Link { from: 0, to: 3 }));
        let scan = || ScanCloud::new((0..100).map(|i| [i as f32 * 0.01, 0.0, 0.0]).collect());
        let scans: Vec<ScanCloud> = (0..4).map(|_| scan()).collect();
        assert_eq!(links_by_overlap(&scans, &poses, 20, 0.1), [Link { from: 0, to: 3 }]);
    }
}
