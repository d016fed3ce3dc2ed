//! Costs, gradients and normal equations of a problem, in a fixed order whatever the number of threads.

use rayon::prelude::*;

use super::block_system::BlockSystem;
use super::factor::{Factor, MAX_FACTOR_VARIABLES};
use super::problem::{FactorId, Problem, Variable, VariableId};
use super::{ProblemError, products};
use crate::Loss;
use crate::loss::Correction;

/// Factors evaluated by one thread at a time; part of the definition of the sums, so not to be changed by
/// the number of threads.
const CHUNK: usize = 32;
/// Chunks evaluated before their blocks are added up.
const WAVE: usize = 32;
/// Below so many factors threads cost more than they give.
const PARALLEL_FROM: usize = 256;

/// Marks variables that do not take part.
pub(crate) const CONSTANT: u32 = u32::MAX;

/// A factor with at least one free variable.
struct ActiveFactor {
    id: FactorId,
    /// First of its block offsets in [`Linearization::offsets`].
    first_offset: u32,
}

/// The fixed part of all evaluations of one problem.
pub(crate) struct Linearization {
    /// Position of each variable in the order of elimination, or [`CONSTANT`].
    pub position: Vec<u32>,
    active: Vec<ActiveFactor>,
    /// Where each block of each factor goes in the values of the system.
    offsets: Vec<u32>,
    /// Cost of the factors all of whose variables are constant.
    pub constant_cost: f64,
    buffer: Vec<f64>,
    chunk_size: usize,
    parallel: bool,
}

/// Blocks of the normal equations: all pairs of free variables of a factor, the first with itself, then
/// the second with the first and with itself, and so on.
fn pair_count(free: usize) -> usize {
    free * (free + 1) / 2
}

impl Linearization {
    /// Finds the structure of the normal equations and an empty system for them.
    pub fn new(problem: &Problem) -> Result<(Self, BlockSystem), ProblemError> {
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

    /// The cost at `values`; `None` where some factor cannot be evaluated.
    pub fn cost(&mut self, problem: &Problem, values: &[f64]) -> Option<f64> {
        let chunk_cost = |buffer: &mut [f64], chunk: &[ActiveFactor]| -> Option<f64> {
            chunk.iter().map(|active| FactorView::new(problem, values, active.id)?.cost(buffer)).sum()
        };
        let mut cost = self.constant_cost;
        let wave_size = self.buffer.len() / self.chunk_size.max(1) * CHUNK;
        for wave in self.active.chunks(wave_size.max(1)) {
            if self.parallel {
                let buffers = self.buffer.par_chunks_mut(self.chunk_size);
                let costs: Vec<Option<f64>> =
                    buffers.zip(wave.par_chunks(CHUNK)).map(|(b, chunk)| chunk_cost(b, chunk)).collect();
                for chunk in costs {
                    cost += chunk?;
                }
            } else {
                cost += chunk_cost(&mut self.buffer, wave)?;
            }
        }
        Some(cost)
    }

    /// Fills the normal equations and the gradient at `values`; false where some factor cannot be evaluated.
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
        let evaluate = |buffer: &mut [f64], chunk: &[ActiveFactor]| -> bool {
            let mut rest = buffer;
            for active in chunk {
                let Some(view) = FactorView::new(problem, values, active.id) else { return false };
                let (own, after) = rest.split_at_mut(view.scratch_size());
                if !view.normal_blocks(position, own) {
                    return false;
                }
                rest = after;
            }
            true
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
            for (buffer, chunk) in self.buffer.chunks(self.chunk_size).zip(wave.chunks(CHUNK)) {
                let mut rest = buffer;
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

impl Problem {
    /// The cost of each factor at the current values, in the order of evaluation; `None` where one cannot be
    /// evaluated.
    pub fn factor_costs(&self) -> impl Iterator<Item = (FactorId, Option<f64>)> {
        let mut scratch = Vec::new();
        self.factors().map(move |(id, factor, loss)| {
            let view = FactorView { problem: self, values: &self.values, factor, loss };
            scratch.resize(view.scratch_size().max(scratch.len()), 0.0);
            (id, view.cost(&mut scratch))
        })
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

/// One factor at certain values of its variables.
struct FactorView<'a> {
    problem: &'a Problem,
    values: &'a [f64],
    factor: &'a dyn Factor,
    loss: &'a Loss,
}

impl<'a> FactorView<'a> {
    fn new(problem: &'a Problem, values: &'a [f64], id: FactorId) -> Option<Self> {
        problem.factor(id).map(|(factor, loss)| Self { problem, values, factor, loss })
    }

    fn variable(&self, id: VariableId) -> &'a Variable {
        &self.problem.variables[id.0 as usize]
    }

    fn parameters(&self) -> ([&'a [f64]; MAX_FACTOR_VARIABLES], usize) {
        let mut parameters: [&[f64]; MAX_FACTOR_VARIABLES] = [&[]; MAX_FACTOR_VARIABLES];
        let variables = self.factor.variables();
        for (slot, id) in parameters.iter_mut().zip(variables) {
            *slot = &self.values[self.variable(*id).range()];
        }
        (parameters, variables.len().min(MAX_FACTOR_VARIABLES))
    }

    /// Numbers needed to evaluate the factor: blocks of the normal equations and gradients first, then
    /// residual and Jacobians.
    fn scratch_size(&self) -> usize {
        let rows = self.factor.residual_dimension();
        let (mut blocks, mut gradient, mut tangent) = (0, 0, 0);
        for id in self.factor.variables() {
            let variable = self.variable(*id);
            tangent += variable.manifold.tangent_dimension();
            let d = variable.degrees_of_freedom();
            gradient += d;
            blocks += d * gradient;
        }
        blocks + gradient + rows * (1 + tangent)
    }

    fn cost(&self, scratch: &mut [f64]) -> Option<f64> {
        let residual = scratch.get_mut(..self.factor.residual_dimension())?;
        let (parameters, count) = self.parameters();
        residual.fill(0.0);
        if !self.factor.evaluate(&parameters[..count], residual, None) {
            return None;
        }
        let cost = 0.5 * self.loss.evaluate(residual.iter().map(|r| r * r).sum()).value;
        cost.is_finite().then_some(cost)
    }

    /// Evaluates the factor and leaves its blocks and gradients at the beginning of `scratch`.
    fn normal_blocks(&self, position: &[u32], scratch: &mut [f64]) -> bool {
        let rows = self.factor.residual_dimension();
        let variables = self.factor.variables();
        let tangent: usize = variables.iter().map(|v| self.variable(*v).manifold.tangent_dimension()).sum();
        let Some(split) = scratch.len().checked_sub(rows * (1 + tangent)) else { return false };
        let (mut blocks, work) = scratch.split_at_mut(split);
        work.fill(0.0);
        let (residual, mut rest) = work.split_at_mut(rows);
        let mut jacobians: [&mut [f64]; MAX_FACTOR_VARIABLES] = Default::default();
        for (slot, id) in jacobians.iter_mut().zip(variables) {
            let size = rows * self.variable(*id).manifold.tangent_dimension();
            let (own, after) = rest.split_at_mut(size);
            (*slot, rest) = (own, after);
        }
        let (parameters, count) = self.parameters();
        if !self.factor.evaluate(&parameters[..count], residual, Some(&mut jacobians[..count])) {
            return false;
        }
        let squared_norm = residual.iter().map(|r| r * r).sum();
        let correction = (*self.loss != Loss::None)
            .then(|| Correction::new(&self.loss.evaluate(squared_norm), squared_norm));
        let mut free: [(u32, &[f64]); MAX_FACTOR_VARIABLES] = Default::default();
        let mut free_count = 0;
        for ((jacobian, id), x) in jacobians.into_iter().zip(variables).zip(parameters) {
            let at = position[id.0 as usize];
            if at == CONSTANT {
                continue;
            }
            let restricted = self.variable(*id).manifold.restrict(x, rows, jacobian);
            if let Some(correction) = &correction {
                correction.apply_to_jacobian(residual, restricted);
            }
            free[free_count] = (at, restricted);
            free_count += 1;
        }
        if let Some(correction) = &correction {
            correction.apply_to_residual(residual);
        }
        for (i, (at, jacobian)) in free[..free_count].iter().enumerate() {
            for (other_at, other) in &free[..=i] {
                // The block goes below the diagonal: its rows belong to the later variable.
                let (row, column) = if at >= other_at { (jacobian, other) } else { (other, jacobian) };
                let (block, after) =
                    blocks.split_at_mut(row.len() / rows.max(1) * (column.len() / rows.max(1)));
                products::transposed_product(rows, row, column, block);
                blocks = after;
            }
            let (gradient, after) = blocks.split_at_mut(jacobian.len() / rows.max(1));
            products::transposed_product(rows, jacobian, residual, gradient);
            blocks = after;
        }
        true
    }

    /// Adds what [`FactorView::normal_blocks`] left.
    fn add_to(
        &self,
        scratch: &[f64],
        offsets: &[u32],
        position: &[u32],
        system: &mut BlockSystem,
        gradient: &mut [f64],
    ) {
        let pattern = &system.pattern;
        let mut free = [0u32; MAX_FACTOR_VARIABLES];
        let mut free_count = 0;
        for id in self.factor.variables() {
            let at = position[id.0 as usize];
            if at != CONSTANT {
                free[free_count] = at;
                free_count += 1;
            }
        }
        let mut rest = scratch;
        let mut offsets = &offsets[..pair_count(free_count)];
        for (i, at) in free[..free_count].iter().enumerate() {
            for other in &free[..=i] {
                let (row, column) = ((*at).max(*other) as usize, (*at).min(*other) as usize);
                let (height, width) = (pattern.dimensions[row] as usize, pattern.dimensions[column] as usize);
                let (block, after) = rest.split_at(height * width);
                let Some((offset, next)) = offsets.split_first() else { return };
                let stride = pattern.heights[column] as usize;
                for (c, values) in block.chunks_exact(height.max(1)).enumerate() {
                    let target = &mut system.values[*offset as usize + c * stride..][..height];
                    target.iter_mut().zip(values).for_each(|(t, v)| *t += v);
                }
                (rest, offsets) = (after, next);
            }
            let start = pattern.starts[*at as usize] as usize;
            let (own, after) = rest.split_at(pattern.dimensions[*at as usize] as usize);
            gradient[start..start + own.len()].iter_mut().zip(own).for_each(|(g, v)| *g += v);
            rest = after;
        }
    }
}
