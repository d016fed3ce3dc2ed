//! Computes costs, gradients and normal equations of a problem, in an order that does not depend on the
//! number of threads.

use rayon::prelude::*;

use super::block_system::BlockSystem;
use super::factor_view::{CONSTANT, FactorView};
use super::problem::{FactorId, Problem, ProblemError};

/// Number of factors that one thread evaluates at a time. It determines the order of the sums, so it must not
/// depend on the number of threads.
const CHUNK: usize = 32;
/// Number of chunks that are evaluated before their blocks are summed.
const WAVE: usize = 32;
/// Number of factors from which several threads are faster than one.
const PARALLEL_FROM: usize = 2048;

/// A factor with at least one free variable.
struct ActiveFactor {
    id: FactorId,
    /// Index of its first block offset in [`Linearization::offsets`].
    first_offset: u32,
}

/// The part of a problem that is the same in all evaluations.
pub(crate) struct Linearization {
    /// Position of each variable in the order of elimination, or [`CONSTANT`].
    pub position: Vec<u32>,
    active: Vec<ActiveFactor>,
    /// Offset of each block of each factor in the values of the system.
    offsets: Vec<u32>,
    /// Cost of the factors all of whose variables are constant.
    pub constant_cost: f64,
    buffer: Vec<f64>,
    chunk_size: usize,
    parallel: bool,
}

impl Linearization {
    /// Analyses the structure of the normal equations and creates an empty system for them.
    ///
    /// # Errors
    /// If the problem is too large for its indices, or for memory.
    pub fn new(problem: &Problem) -> Result<(Self, BlockSystem), ProblemError> {
        // The indices of variables saturate at this size when variables are added.
        if u32::try_from(problem.values.len()).is_err() {
            return Err(ProblemError::TooLarge("values"));
        }
        let mut block_of = vec![CONSTANT; problem.variables.len()];
        let mut dimensions = Vec::new();
        for (block, variable) in block_of.iter_mut().zip(&problem.variables) {
            if variable.degrees_of_freedom() > 0 {
                *block = dimensions.len() as u32;
                dimensions.push(variable.degrees_of_freedom() as u32);
            }
        }
        let system = BlockSystem::new(&dimensions, &coupled_pairs(problem, &block_of))?;
        let pattern = &system.pattern;
        let mut linearization = Self {
            position: block_of
                .iter()
                .map(|b| if *b == CONSTANT { CONSTANT } else { pattern.position[*b as usize] })
                .collect(),
            active: Vec::new(),
            offsets: Vec::new(),
            constant_cost: 0.0,
            buffer: Vec::new(),
            chunk_size: 0,
            parallel: false,
        };
        linearization.place_factors(problem, &system)?;
        Ok((linearization, system))
    }

    fn place_factors(&mut self, problem: &Problem, system: &BlockSystem) -> Result<(), ProblemError> {
        let mut largest = 0;
        let mut scratch = Vec::new();
        for (id, factor, loss) in problem.factors() {
            let view = FactorView { problem, values: &problem.values, factor, loss };
            largest = largest.max(view.scratch_size());
            let free: Vec<u32> = factor
                .variables()
                .iter()
                .map(|v| self.position[v.0 as usize])
                .filter(|p| *p != CONSTANT)
                .collect();
            if free.is_empty() {
                scratch.resize(largest, 0.0);
                self.constant_cost += view.cost(&mut scratch).ok_or(ProblemError::NotEvaluable)?;
                continue;
            }
            let first_offset =
                u32::try_from(self.offsets.len()).map_err(|_| ProblemError::TooLarge("couplings"))?;
            for (i, a) in free.iter().enumerate() {
                for b in &free[..=i] {
                    let offset = system.pattern.block_offset(*a.max(b), *a.min(b));
                    self.offsets.push(offset.ok_or(ProblemError::TooLarge("couplings"))?);
                }
            }
            self.active.push(ActiveFactor { id, first_offset });
        }
        self.parallel = self.active.len() >= PARALLEL_FROM && rayon::current_num_threads() > 1;
        self.chunk_size = CHUNK * largest.max(1);
        let chunks = if self.parallel { WAVE } else { 1 };
        self.buffer = vec![0.0; self.chunk_size * chunks];
        Ok(())
    }

    /// The cost at `values`; `None` if some factor cannot be evaluated.
    pub fn cost(&mut self, problem: &Problem, values: &[f64]) -> Option<f64> {
        let chunk_cost = |buffer: &mut [f64], chunk: &[ActiveFactor]| -> Option<f64> {
            chunk.iter().map(|active| FactorView::new(problem, values, active.id)?.cost(buffer)).sum()
        };
        let mut cost = self.constant_cost;
        let wave_size = self.buffer.len() / self.chunk_size.max(1) * CHUNK;
        for wave in self.active.chunks(wave_size.max(1)) {
            if self.parallel {
                let mut costs = [Some(0.0); WAVE];
                let buffers = self.buffer.par_chunks_mut(self.chunk_size);
                let work = buffers.zip(wave.par_chunks(CHUNK)).zip(costs.par_iter_mut());
                work.for_each(|((buffer, chunk), cost)| *cost = chunk_cost(buffer, chunk));
                for chunk in costs.iter().take(wave.len().div_ceil(CHUNK)) {
                    cost += (*chunk)?;
                }
            } else {
                cost += chunk_cost(&mut self.buffer, wave)?;
            }
        }
        Some(cost)
    }

    /// Computes the normal equations and the gradient at `values`; false if some factor cannot be evaluated.
    pub fn linearize(
        &mut self,
        problem: &Problem,
        values: &[f64],
        system: &mut BlockSystem,
        gradient: &mut [f64],
    ) -> bool {
        system.clear();
        gradient.fill(0.0);
        let position = &self.position;
        let evaluate = |buffer: &mut [f64], chunk: &[ActiveFactor]| {
            let mut rest = buffer;
            chunk.iter().all(|active| {
                let Some(view) = FactorView::new(problem, values, active.id) else { return false };
                let (own, after) = std::mem::take(&mut rest).split_at_mut(view.scratch_size());
                rest = after;
                view.normal_blocks(position, own)
            })
        };
        let wave_size = self.buffer.len() / self.chunk_size.max(1) * CHUNK;
        for wave in self.active.chunks(wave_size.max(1)) {
            let good = if self.parallel {
                let buffers = self.buffer.par_chunks_mut(self.chunk_size);
                buffers
                    .zip(wave.par_chunks(CHUNK))
                    .map(|(b, chunk)| evaluate(b, chunk))
                    .reduce(|| true, |a, b| a && b)
            } else {
                evaluate(&mut self.buffer, wave)
            };
            if !good {
                return false;
            }
            // Sequentially in the order of the factors: the sums are the same for any number of threads.
            for (mut rest, chunk) in self.buffer.chunks(self.chunk_size).zip(wave.chunks(CHUNK)) {
                for active in chunk {
                    let Some(view) = FactorView::new(problem, values, active.id) else { return false };
                    let (own, after) = rest.split_at(view.scratch_size());
                    let offsets = &self.offsets[active.first_offset as usize..];
                    view.add_to(own, offsets, position, system, gradient);
                    rest = after;
                }
            }
        }
        gradient.iter().sum::<f64>().is_finite() && system.values.iter().sum::<f64>().is_finite()
    }
}

/// Unique pairs of free blocks that share a factor, smaller first, sorted.
fn coupled_pairs(problem: &Problem, block_of: &[u32]) -> Vec<(u32, u32)> {
    let mut pairs = Vec::with_capacity(problem.factor_count());
    for (_, factor, _) in problem.factors() {
        let variables = factor.variables();
        for (i, a) in variables.iter().enumerate() {
            for b in &variables[..i] {
                let (a, b) = (block_of[a.0 as usize], block_of[b.0 as usize]);
                if a != CONSTANT && b != CONSTANT {
                    pairs.push((a.min(b), a.max(b)));
                }
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}
