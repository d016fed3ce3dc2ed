//! The order in which the blocks of a sparse symmetric matrix are eliminated, so that its factor stays sparse.

use portolan_numeric::Lcg64;

use super::fill::{factor_rows, postorder};
use super::minimum_degree::minimum_degree;

/// Number of block multiplications from which other orders are tried, too. The best of several orders is some
/// percent better, in memory and in every factorisation, and the search costs less than one factorisation.
const WORTH_TRYING: u64 = 2_000_000;
/// Number of other orders that are tried.
const TRIALS: u64 = 12;

/// An order of elimination, `order[new] = old`. Approximate minimum degree breaks ties by the numbers of the
/// blocks, which are arbitrary: for large systems the best of several numberings is used.
pub(super) fn elimination_order(n: usize, pairs: &[(u32, u32)]) -> Vec<u32> {
    let mut best = Order::of(n, pairs, minimum_degree(neighbours(n, pairs, |block| block)));
    if best.work >= WORTH_TRYING {
        for seed in 1..=TRIALS {
            let block_of = shuffled(n, seed);
            let number_of = inverse(&block_of);
            let numbers = minimum_degree(neighbours(n, pairs, |block| number_of[block as usize]));
            let order = numbers.iter().map(|number| block_of[*number as usize]).collect();
            let found = Order::of(n, pairs, order);
            if found.work < best.work {
                best = found;
            }
        }
    }
    best.order
}

struct Order {
    order: Vec<u32>,
    /// Number of block multiplications of a factorisation: the sum of the squares of the column heights.
    work: u64,
}

impl Order {
    /// This order in postorder, so that columns of the factor with the same rows are adjacent.
    fn of(n: usize, pairs: &[(u32, u32)], order: Vec<u32>) -> Self {
        let position = inverse(&order);
        let coupled = neighbours(n, pairs, |block| position[block as usize]);
        let rows = factor_rows(n, |column| &coupled[column]);
        let work = rows.iter().map(|rows| (rows.len() as u64 + 1).pow(2)).sum();
        let order = postorder(&rows).iter().map(|column| order[*column as usize]).collect();
        Self { order, work }
    }
}

/// For each of `n` blocks, numbered by `number_of`, the blocks it is coupled with, ascending.
fn neighbours(n: usize, pairs: &[(u32, u32)], number_of: impl Fn(u32) -> u32) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); n];
    for (a, b) in pairs {
        let (a, b) = (number_of(*a), number_of(*b));
        lists[a as usize].push(b);
        lists[b as usize].push(a);
    }
    lists.iter_mut().for_each(|list| list.sort_unstable());
    lists
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut position = vec![0; order.len()];
    for (new, old) in order.iter().enumerate() {
        position[*old as usize] = new as u32;
    }
    position
}

/// A reproducible permutation (Fisher and Yates, with a linear congruential generator).
fn shuffled(n: usize, seed: u64) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut random = Lcg64::new(seed);
    for i in (1..n).rev() {
        order.swap(i, ((random.bits() >> 33) % (i as u64 + 1)) as usize);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A torus of blocks.
    fn torus(edge: u32) -> Vec<(u32, u32)> {
        let mut pairs = Vec::new();
        for y in 0..edge {
            for x in 0..edge {
                let here = y * edge + x;
                for there in [y * edge + (x + 1) % edge, (y + 1) % edge * edge + x] {
                    pairs.push((here.min(there), here.max(there)));
                }
            }
        }
        pairs.sort_unstable();
        pairs
    }

    #[test]
    fn every_block_is_eliminated_once_and_the_best_order_is_taken() {
        for edge in [3, 120] {
            let pairs = torus(edge);
            let n = (edge * edge) as usize;
            let order = elimination_order(n, &pairs);
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert!(sorted.iter().enumerate().all(|(i, block)| i as u32 == *block));
            let plain = minimum_degree(neighbours(n, &pairs, |block| block));
            let [found, known] = [order, plain].map(|order| Order::of(n, &pairs, order).work);
            assert!(found <= known, "{found} {known}");
            assert_eq!(known >= WORTH_TRYING, edge == 120, "{known}");
        }
        assert_eq!(elimination_order(0, &[]), [] as [u32; 0]);
    }
}
