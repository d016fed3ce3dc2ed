//! Loop closing: the correction found at the end of a loop is distributed over its scans (explicit loop
//! closing heuristic; Sprickerhof, Nüchter, Lingemann and Hertzberg 2009; specification section 3).
//!
//! The fraction that each scan gets follows from how well the links between scans are determined: weak links
//! take more of it. Rotations are distributed by spherical interpolation.

use std::collections::BTreeSet;

use portolan_geometry::{Quaternion, Rigid3, Vector3, nalgebra as na};

use super::global::LinkSums;
use super::{GlobalOptions, Link, ScanCloud};

/// Minimum variance of a link.
const LEAST: f64 = 1e-12;
/// Variance of a link without enough pairs, square metres or square radians.
const WEAK: f64 = 1.0;

/// Cost of a link: variances of the translation along x, y and z (world), and of the rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkCost {
    /// The link.
    pub link: Link,
    /// Variances, square metres (three times) and square radians.
    pub variances: [f64; 4],
}

/// Costs of links from the pairs of their scans at the current poses (metres).
pub fn link_costs(
    scans: &[ScanCloud],
    world_from_scan: &[Rigid3],
    links: &[Link],
    max_distance: f64,
) -> Vec<LinkCost> {
    let options = GlobalOptions { max_distance, max_queries: 2000, ..GlobalOptions::default() };
    let cost = |link: &Link| {
        let statistics = LinkSums::of(scans, world_from_scan, *link, &options).statistics;
        let covariance = statistics
            .difference()
            .and_then(|(_, variance)| Some(statistics.matrix.try_inverse()? * variance))
            .filter(|c| c.diagonal().iter().all(|v| v.is_finite() && *v > 0.0));
        let variances = match covariance {
            // The twist is about the origin of the world; the cost is that of the translation of the scan
            // itself.
            Some(c) => {
                let place = world_from_scan[link.to].translation.vector;
                let lever = -place.cross_matrix();
                let [ss, st, tt] =
                    [(0, 0), (0, 3), (3, 3)].map(|at| c.fixed_view::<3, 3>(at.0, at.1).into_owned());
                let shift =
                    ss + lever * st.transpose() + st * lever.transpose() + lever * tt * lever.transpose();
                [shift[(0, 0)], shift[(1, 1)], shift[(2, 2)], tt.trace()].map(|v| v.clamp(LEAST, WEAK))
            }
            None => [WEAK; 4],
        };
        LinkCost { link: *link, variances }
    };
    links.iter().map(cost).collect()
}

/// The fraction of a correction that each scan gets, 0 to 1: none at `first`, all at `last`. The cheapest
/// path between two scans with known fractions is found repeatedly. Fractions along it grow with its costs,
/// and a branch at a scan gets the fraction of that scan. Scans without any link do not move (fraction 0).
///
/// `costs` are the links (scan, scan) and their variances.
pub fn balance(count: usize, costs: &[(usize, usize, f64)], first: usize, last: usize) -> Vec<f64> {
    let mut shares: Vec<Option<f64>> = vec![None; count];
    if first >= count || last >= count || first == last {
        return vec![0.0; count];
    }
    (shares[first], shares[last]) = (Some(0.0), Some(1.0));
    let mut unused: BTreeSet<usize> = (0..costs.len())
        .filter(|i| costs[*i].0 < count && costs[*i].1 < count && costs[*i].0 != costs[*i].1)
        .collect();
    while let Some(path) = cheapest_path(count, costs, &unused, &shares) {
        let ends = [path.scans.first(), path.scans.last()].map(|s| s.and_then(|s| shares[*s]).unwrap_or(0.0));
        let total = path.distances.last().copied().unwrap_or(1.0);
        for (scan, distance) in path.scans.iter().zip(&path.distances) {
            shares[*scan].get_or_insert(ends[0] + (ends[1] - ends[0]) * distance / total);
        }
        unused.retain(|link| !path.links.contains(link));
    }
    // Branches.
    loop {
        let before = unused.len();
        unused.retain(|i| {
            let (a, b, _) = costs[*i];
            match (shares[a], shares[b]) {
                (Some(share), None) => shares[b] = Some(share),
                (None, Some(share)) => shares[a] = Some(share),
                (Some(_), Some(_)) => {}
                (None, None) => return true,
            }
            false
        });
        if unused.len() == before {
            break;
        }
    }
    shares.into_iter().map(|share| share.unwrap_or(0.0)).collect()
}

/// A path between two scans with known fractions.
struct Path {
    scans: Vec<usize>,
    /// Costs from the first scan to each.
    distances: Vec<f64>,
    links: Vec<usize>,
}

/// The cheapest path through unused links from one scan with a fraction to another, via scans without one
/// (Dijkstra from all scans with a fraction at once).
fn cheapest_path(
    count: usize,
    costs: &[(usize, usize, f64)],
    unused: &BTreeSet<usize>,
    shares: &[Option<f64>],
) -> Option<Path> {
    let mut at: Vec<Vec<usize>> = vec![Vec::new(); count];
    for link in unused {
        at[costs[*link].0].push(*link);
        at[costs[*link].1].push(*link);
    }
    // Cost, source and link by which each scan was reached.
    let mut reached: Vec<Option<(f64, usize, Option<usize>)>> =
        shares.iter().enumerate().map(|(i, share)| share.map(|_| (0.0, i, None))).collect();
    let mut done = vec![false; count];
    while let Some(scan) = nearest_open(&reached, &done) {
        done[scan] = true;
        let Some((cost, source, _)) = reached[scan] else { break };
        for link in &at[scan] {
            let (a, b, step) = costs[*link];
            let (other, through) = (if a == scan { b } else { a }, cost + step.max(LEAST));
            if reached[other].is_none_or(|(known, ..)| through < known) {
                reached[other] = Some((through, source, Some(*link)));
            }
        }
    }
    // The cheapest link on which two sources meet.
    let meeting = |link: &usize| {
        let (a, b, step) = costs[*link];
        let ((to_a, source_a, _), (to_b, source_b, _)) = (reached[a]?, reached[b]?);
        (source_a != source_b).then_some((to_a + step.max(LEAST) + to_b, *link))
    };
    let (total, middle) =
        unused.iter().filter_map(meeting).min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)))?;
    let (a, b, _) = costs[middle];
    let back = |mut scan: usize| {
        let (mut scans, mut links) = (vec![scan], Vec::new());
        while let Some((_, _, Some(link))) = reached[scan] {
            scan = if costs[link].0 == scan { costs[link].1 } else { costs[link].0 };
            scans.push(scan);
            links.push(link);
        }
        (scans, links)
    };
    let cost_of = |scan: usize| reached[scan].map_or(0.0, |(cost, ..)| cost);
    let ((mut scans, mut links), (rest, more)) = (back(a), back(b));
    scans.reverse();
    links.reverse();
    let mut distances: Vec<f64> = scans.iter().map(|s| cost_of(*s)).collect();
    distances.extend(rest.iter().map(|s| total - cost_of(*s)));
    scans.extend(rest);
    links.push(middle);
    links.extend(more);
    Some(Path { scans, distances, links })
}

fn nearest_open(reached: &[Option<(f64, usize, Option<usize>)>], done: &[bool]) -> Option<usize> {
    let open = (0..reached.len()).filter(|i| !done[*i] && reached[*i].is_some());
    let cost = |i: &usize| reached[*i].map_or(f64::INFINITY, |(cost, ..)| cost);
    open.min_by(|a, b| cost(a).total_cmp(&cost(b)))
}

/// Distributes a correction over all scans. `world_correction` moves scan `last` (and the scans matched
/// together with it) onto scan `first`; `costs` are those of all links so far. The first of all scans is not
/// moved.
pub fn close_loop(
    world_from_scan: &mut [Rigid3],
    costs: &[LinkCost],
    first: usize,
    last: usize,
    world_correction: &Rigid3,
) {
    let count = world_from_scan.len();
    let Some(world_from_first) = world_from_scan.get(first).copied() else { return };
    let shares: [Vec<f64>; 4] = std::array::from_fn(|k| {
        let costs: Vec<_> = costs.iter().map(|c| (c.link.from, c.link.to, c.variances[k])).collect();
        balance(count, &costs, first, last)
    });
    // In axes of the world, as the costs, about the first scan of the loop.
    let about = world_from_first.translation;
    let correction = about.inverse() * world_correction * about;
    let shift = correction.translation.vector;
    let part = |i: usize| {
        let turn = Quaternion::identity()
            .try_slerp(&correction.rotation, shares[3][i], 1e-12)
            .unwrap_or(correction.rotation);
        let shift = Vector3::from_fn(|k, _| shares[k][i] * shift[k]);
        about * Rigid3::from_parts(na::Translation3::from(shift), turn) * about.inverse()
    };
    let gauge = part(0).inverse();
    for (i, pose) in world_from_scan.iter_mut().enumerate() {
        *pose = gauge * part(i) * *pose;
        pose.rotation.renormalize();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_grow_along_the_loop_and_branches_follow() {
        // A chain 0 … 5 with the loop from 1 to 4; 6 is linked to 2 only.
        let costs = [(0, 1, 1.0), (1, 2, 1.0), (2, 3, 2.0), (3, 4, 1.0), (4, 5, 1.0), (2, 6, 9.0)];
        let shares = balance(8, &costs, 1, 4);
        assert_eq!(shares, [0.0, 0.0, 0.25, 0.75, 1.0, 1.0, 0.25, 0.0]);
        // A second path with higher costs between scans of the first one.
        let more: Vec<_> = costs.into_iter().chain([(2, 7, 5.0), (7, 3, 5.0)]).collect();
        assert!((balance(8, &more, 1, 4)[7] - 0.5).abs() < 1e-12);
        assert_eq!(balance(3, &[], 0, 2), [0.0, 0.0, 1.0]);
        assert_eq!(balance(2, &[(0, 1, 1.0)], 1, 1), [0.0, 0.0]);
    }

    #[test]
    fn a_drifting_round_is_closed() {
        let count = 13;
        let truth: Vec<Rigid3> = (0..count)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 12.0)
            .map(|a| Rigid3::new(Vector3::new(10.0 * a.cos(), 10.0 * a.sin(), 0.0), Vector3::z() * a))
            .collect();
        // Each step rotates and climbs a little too much.
        let drift = Rigid3::new(Vector3::new(0.0, 0.0, 0.02), Vector3::z() * 0.004);
        let mut poses = vec![truth[0]];
        for pair in truth.windows(2) {
            let last = poses[poses.len() - 1];
            poses.push(last * (pair[0].inverse() * pair[1]) * drift);
        }
        let error = |poses: &[Rigid3]| {
            let squares = poses
                .iter()
                .zip(&truth)
                .map(|(p, t)| (p.translation.vector - t.translation.vector).norm_squared());
            (squares.sum::<f64>() / f64::from(count)).sqrt()
        };
        let before = error(&poses);
        let links = (0..12).map(|i| LinkCost { link: Link { from: i, to: i + 1 }, variances: [1e-4; 4] });
        let correction = truth[12] * poses[12].inverse();
        close_loop(&mut poses, &links.collect::<Vec<_>>(), 0, 12, &correction);
        assert!((poses[0].to_homogeneous() - truth[0].to_homogeneous()).norm() < 1e-12);
        assert!((poses[12].to_homogeneous() - truth[12].to_homogeneous()).norm() < 1e-9);
        assert!(error(&poses) < 0.5 * before, "{} from {before}", error(&poses));
    }
}
