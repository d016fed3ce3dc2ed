use super::*;
use proptest::prelude::*;

fn brute(points: &[[f32; 3]], query: [f32; 3]) -> Vec<Neighbour> {
    let mut all: Vec<Neighbour> = points
        .iter()
        .enumerate()
        .map(|(i, p)| Neighbour {
            index: i as u32,
            squared_distance: squared_norm(std::array::from_fn(|k| p[k] - query[k])),
        })
        .collect();
    all.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.index.cmp(&b.index)));
    all
}

/// Few distinct coordinates, so that ties and equal splits are frequent.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![(-8i32..8).prop_map(|v| v as f32 * 0.5), -4.0f32..4.0]
}

proptest! {
    #[test]
    fn agrees_with_brute_force(
        points in prop::collection::vec([coordinate(), coordinate(), coordinate()], 0..300),
        query in [coordinate(), coordinate(), coordinate()],
        k in 1usize..20, radius in 0.1f32..3.0,
    ) {
        let tree = KdTree::new(&points);
        let all = brute(&points, query);
        prop_assert_eq!(tree.nearest(query, f32::INFINITY), all.first().copied());
        for (index, position) in points.iter().enumerate().take(9) {
            let near = Neighbour::of(query, index as u32, *position);
            prop_assert_eq!(tree.nearest_from(query, radius, near), tree.nearest(query, radius));
        }
        let mut found = Vec::new();
        tree.k_nearest(query, k, f32::INFINITY, &mut found);
        prop_assert_eq!(&found[..], &all[..k.min(all.len())]);
        let mut near = Vec::new();
        tree.within(query, radius, |n| near.push(n));
        near.sort_by(|a, b| a.squared_distance.total_cmp(&b.squared_distance).then(a.index.cmp(&b.index)));
        prop_assert_eq!(tree.has_within(query, radius), !near.is_empty());
        let expected: Vec<_> = all.into_iter().filter(|n| n.squared_distance <= radius * radius).collect();
        prop_assert_eq!(near, expected);
    }
}

#[test]
fn conditions_and_limits_are_kept() {
    let points: Vec<[f32; 3]> = (0..1000).map(|i| [i as f32 * 0.125, 0.0, 0.0]).collect();
    let tree = KdTree::new(&points);
    let odd = tree.nearest_where([62.5, 0.0, 0.0], 1.0, |i| i % 2 == 1).unwrap();
    assert_eq!(odd.index, 499);
    assert!(tree.nearest([62.5, 2.0, 0.0], 1.0).is_none());
    assert!(KdTree::new(&[]).nearest([0.0; 3], 1.0).is_none());
    assert_eq!(KdTree::new(&[[f32::NAN; 3], [1.0; 3]]).len(), 1);
}

#[test]
fn threads_do_not_change_the_tree() {
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 1e6
    };
    let points: Vec<[f32; 3]> = (0..60_000).map(|_| [random(), random(), random()]).collect();
    let order = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| KdTree::new(&points)).entries.iter().map(|e| e.index).collect::<Vec<_>>()
    };
    assert_eq!(order(1), order(4));
    assert!(KdTree::new(&points).memory_bytes() <= 18 * points.len());
}

proptest! {
    #[test]
    fn many_points_at_few_places_agree_with_brute_force(
        places in prop::collection::vec([coordinate(), coordinate(), coordinate()], 1..4),
        choice in prop::collection::vec(0usize..4, 1..300),
        query in [coordinate(), coordinate(), coordinate()],
        k in 1usize..40,
    ) {
        let points: Vec<[f32; 3]> = choice.iter().map(|i| places[i % places.len()]).collect();
        let tree = KdTree::new(&points);
        let all = brute(&points, query);
        prop_assert_eq!(tree.nearest(query, f32::INFINITY), all.first().copied());
        let mut found = Vec::new();
        tree.k_nearest(query, k, f32::INFINITY, &mut found);
        prop_assert_eq!(&found[..], &all[..k.min(all.len())]);
        let (nearest, second) = tree.nearest_two(query, 100.0).unwrap();
        prop_assert_eq!(nearest, all[0]);
        prop_assert_eq!(second, all.get(1).map_or(1e4, |n| n.squared_distance).sqrt());
        let odd = tree.nearest_where(query, f32::INFINITY, |i| i % 2 == 1);
        prop_assert_eq!(odd, all.iter().find(|n| n.index % 2 == 1).copied());
        prop_assert_eq!(tree.count_within(query, 100.0, 50), all.len().min(50));
    }
}

#[test]
fn of_many_points_at_one_place_few_are_looked_at() {
    let tree = KdTree::new(&vec![[1.0, 2.0, 3.0]; 100_000]);
    let looked_at = |first: usize| {
        let mut count = 0;
        tree.visit([1.0, 2.0, 3.0], f32::INFINITY, first, |_, _| count += 1);
        count
    };
    assert!(looked_at(1) <= 16 && looked_at(30) <= 64, "{} {}", looked_at(1), looked_at(30));
    assert_eq!(looked_at(usize::MAX), 100_000);
}
