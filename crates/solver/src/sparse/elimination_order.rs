//! The order in which the blocks of a sparse symmetric matrix are eliminated, so that its factor stays sparse.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::simplicial;

use portolan_numeric::Lcg64;

use super::ProblemError;

/// From so many multiplications of blocks on other orders are tried, too: the best of several is some percent
/// better, in memory and in every factorisation, and costs less than one of these.
const WORTH_TRYING: u64 = 2_000_000;
/// How many others are tried.
const TRIALS: u64 = 12;

/// Which blocks are coupled (both numbers, each pair once), by columns of the upper triangle.
struct Couplings {
    starts: Vec<u32>,
    rows: Vec<u32>,
}

impl Couplings {
    /// Of `n` blocks that got the numbers `number_of`.
    fn new(n: usize, pairs: &[(u32, u32)], number_of: impl Fn(u32) -> u32) -> Self {
        let mut starts = vec![0u32; n + 1];
        let place = |(a, b): &(u32, u32)| {
            let (a, b) = (number_of(*a), number_of(*b));
            (a.min(b), a.max(b))
        };
        for pair in pairs {
            starts[place(pair).1 as usize + 1] += 1;
        }
        for i in 0..n {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut rows = vec![0u32; pairs.len()];
        for pair in pairs {
            let (row, column) = place(pair);
            rows[next[column as usize] as usize] = row;
            next[column as usize] += 1;
        }
        for column in 0..n {
            rows[starts[column] as usize..starts[column + 1] as usize].sort_unstable();
        }
        Self { starts, rows }
    }

    fn matrix(&self) -> SymbolicSparseColMatRef<'_, u32> {
        let n = self.starts.len() - 1;
        SymbolicSparseColMatRef::new_checked(n, n, &self.starts, None, &self.rows)
    }
}

/// An order of elimination, `order[new] = old`. Approximate minimum degree decides ties by the numbers of the
/// blocks, which means nothing: for large systems the best of several numberings is taken.
pub(super) fn elimination_order(n: usize, pairs: &[(u32, u32)]) -> Result<Vec<u32>, ProblemError> {
    let mut best = minimum_degree(n, &Couplings::new(n, pairs, |block| block))?;
    let mut least = work(n, pairs, &best)?;
    if least < WORTH_TRYING {
        return Ok(best);
    }
    for seed in 1..=TRIALS {
        let block_of = shuffled(n, seed);
        let number_of = inverse(&block_of);
        let couplings = Couplings::new(n, pairs, |block| number_of[block as usize]);
        let numbers = minimum_degree(n, &couplings)?;
        let order: Vec<u32> = numbers.iter().map(|number| block_of[*number as usize]).collect();
        let found = work(n, pairs, &order)?;
        if found < least {
            (best, least) = (order, found);
        }
    }
    Ok(best)
}

/// Approximate minimum degree.
fn minimum_degree(n: usize, couplings: &Couplings) -> Result<Vec<u32>, ProblemError> {
    let (mut order, mut inverse) = (vec![0u32; n], vec![0u32; n]);
    if n == 0 {
        return Ok(order);
    }
    let request = amd::order_scratch::<u32>(n, couplings.rows.len());
    let mut memory = MemBuffer::try_new(request).map_err(|_| ProblemError::OutOfMemory)?;
    let control = amd::Control::default();
    amd::order(&mut order, &mut inverse, couplings.matrix(), control, MemStack::new(&mut memory))
        .map_err(|_| ProblemError::TooLarge("couplings"))?;
    Ok(order)
}

/// Multiplications of blocks that a factorisation in this order takes: the squares of the column heights.
fn work(n: usize, pairs: &[(u32, u32)], order: &[u32]) -> Result<u64, ProblemError> {
    let position = inverse(order);
    let couplings = Couplings::new(n, pairs, |block| position[block as usize]);
    let request = simplicial::prefactorize_symbolic_cholesky_scratch::<u32>(n, couplings.rows.len());
    let mut memory = MemBuffer::try_new(request).map_err(|_| ProblemError::OutOfMemory)?;
    let (mut tree, mut heights) = (vec![0i32; n], vec![0u32; n]);
    simplicial::prefactorize_symbolic_cholesky(
        &mut tree,
        &mut heights,
        couplings.matrix(),
        MemStack::new(&mut memory),
    );
    Ok(heights.iter().map(|height| u64::from(*height).pow(2)).sum())
}

fn inverse(order: &[u32]) -> Vec<u32> {
    let mut position = vec![0; order.len()];
    for (new, old) in order.iter().enumerate() {
        position[*old as usize] = new as u32;
    }
    position
}

/// A permutation that is the same everywhere (Fisher and Yates, with a linear congruential generator).
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
            let order = elimination_order(n, &pairs).unwrap();
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert!(sorted.iter().enumerate().all(|(i, block)| i as u32 == *block));
            let plain = minimum_degree(n, &Couplings::new(n, &pairs, |block| block)).unwrap();
            let (found, known) = (work(n, &pairs, &order).unwrap(), work(n, &pairs, &plain).unwrap());
            assert!(found <= known, "{found} {known}");
            assert_eq!(known >= WORTH_TRYING, edge == 120, "{known}");
        }
        assert_eq!(elimination_order(0, &[]).unwrap(), [] as [u32; 0]);
    }
}
