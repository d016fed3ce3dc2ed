use super::*;

/// Boxes whose bounds all exceed any score; each is split into two, for ever.
struct Endless {
    lookups: usize,
}

impl Branching for Endless {
    type Placement = u32;

    fn roots(&mut self, best: &mut Best<u32>, emit: &mut dyn FnMut(Node<u32>)) {
        best.offer(7, 0.5);
        emit(Node { bound: 1.0, exponent: 0, first: 0 });
    }

    fn split(&mut self, node: &Node<u32>, best: &mut Best<u32>, emit: &mut dyn FnMut(Node<u32>)) {
        if best.charge(self.lookups) {
            (0..2).for_each(|i| emit(Node { first: node.first.wrapping_add(i), ..*node }));
        }
    }
}

/// Numbers below 2¹⁰ with the scores `score`; the bound of a box is its best score.
struct Line<F>(F, usize);

impl<F: Fn(u32) -> f32> Line<F> {
    fn node(&mut self, first: u32, exponent: u32, best: &mut Best<u32>) -> Option<Node<u32>> {
        self.1 += 1;
        let bound = (first..first + (1 << exponent)).map(&self.0).fold(0.0, f32::max);
        if exponent == 0 {
            best.offer(first, bound);
        }
        (exponent > 0).then_some(Node { bound, exponent, first })
    }
}

impl<F: Fn(u32) -> f32> Branching for Line<F> {
    type Placement = u32;

    fn roots(&mut self, best: &mut Best<u32>, emit: &mut dyn FnMut(Node<u32>)) {
        self.node(0, 10, best).into_iter().for_each(emit);
    }

    fn split(&mut self, node: &Node<u32>, best: &mut Best<u32>, emit: &mut dyn FnMut(Node<u32>)) {
        let exponent = node.exponent - 1;
        for first in [node.first, node.first + (1 << exponent)] {
            self.node(first, exponent, best).into_iter().for_each(&mut *emit);
        }
    }
}

#[test]
fn everything_nearly_as_good_is_found() {
    let score = |i: u32| match i {
        700 => 0.9,
        20 | 300 => 0.8,
        _ => 0.3,
    };
    let all = best_first_several(&mut Line(score, 0), Best::several_above(0.1, 0.7, 1 << 20));
    assert_eq!(all, [(0.9, 700), (0.8, 20), (0.8, 300)]);
}

/// Takes this number of placements, none within 10 of another.
struct Spaced(usize, Vec<(f32, u32)>);

impl Taker<u32> for Spaced {
    fn is_needless(&self, node: &Node<u32>) -> bool {
        let last = node.first + (1 << node.exponent) - 1;
        self.1.iter().any(|(_, taken)| taken.abs_diff(node.first) < 10 && taken.abs_diff(last) < 10)
    }

    fn take(&mut self, score: f32, placement: u32) -> Option<f32> {
        self.1.push((score, placement));
        (self.1.len() < self.0).then_some(0.5 * self.1[0].0)
    }
}

#[test]
fn separated_placements_come_in_descending_order() {
    let score = |i: u32| match i {
        700 => 0.9,
        695..705 => 0.85,
        20 | 300 => 0.8,
        _ => 0.3,
    };
    let (mut line, mut taken) = (Line(score, 0), Spaced(9, Vec::new()));
    assert!(best_first_in_order(&mut line, Best::in_order_above(0.1, 1 << 20), vec![], &mut taken) > 0);
    assert_eq!(taken.1, [(0.9, 700), (0.8, 20), (0.8, 300)], "the rest is below half of the best");
    let (mut line, mut taken) = (Line(score, 0), Spaced(2, Vec::new()));
    assert!(best_first_in_order(&mut line, Best::in_order_above(0.1, 1 << 20), vec![], &mut taken) > 0);
    assert_eq!(taken.1, [(0.9, 700), (0.8, 20)]);
    assert!(line.1 < 120, "{} of 1024 were looked at", line.1);
}

#[test]
fn an_endless_search_is_given_up() {
    assert_eq!(best_first(&mut Endless { lookups: 1 << 28 }, Best::above(0.1)), (0.5, vec![]));
}
