//! Evaluation of one factor: its cost, and its contribution to the normal equations.

use super::block_system::BlockSystem;
use super::factor::{Factor, MAX_FACTOR_VARIABLES};
use super::problem::{FactorId, Problem, Variable, VariableId};
use super::products;
use crate::Loss;
use crate::loss::Correction;

/// Marks variables that are not optimised.
pub(crate) const CONSTANT: u32 = u32::MAX;

/// Number of blocks of the normal equations: all pairs of free variables of a factor, the first with itself,
/// then the second with the first and with itself, and so on.
fn pair_count(free: usize) -> usize {
    free * (free + 1) / 2
}

/// One factor at given values of its variables.
pub(super) struct FactorView<'a> {
    pub problem: &'a Problem,
    pub values: &'a [f64],
    pub factor: &'a dyn Factor,
    pub loss: &'a Loss,
}

impl<'a> FactorView<'a> {
    pub fn new(problem: &'a Problem, values: &'a [f64], id: FactorId) -> Option<Self> {
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

    /// Number of values needed to evaluate the factor: blocks of the normal equations and gradients first,
    /// then residual and Jacobians.
    pub fn scratch_size(&self) -> usize {
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

    pub fn cost(&self, scratch: &mut [f64]) -> Option<f64> {
        let residual = scratch.get_mut(..self.factor.residual_dimension())?;
        let (parameters, count) = self.parameters();
        residual.fill(0.0);
        if !self.factor.evaluate(&parameters[..count], residual, None) {
            return None;
        }
        let cost = 0.5 * self.loss.evaluate(residual.iter().map(|r| r * r).sum()).value;
        cost.is_finite().then_some(cost)
    }

    /// Evaluates the factor and writes its blocks and gradients to the beginning of `scratch`.
    pub fn normal_blocks(&self, position: &[u32], scratch: &mut [f64]) -> bool {
        let rows = self.factor.residual_dimension();
        let variables = self.factor.variables();
        let tangent: usize = variables.iter().map(|v| self.variable(*v).manifold.tangent_dimension()).sum();
        let Some(split) = scratch.len().checked_sub(rows * (1 + tangent)) else { return false };
        let (blocks, work) = scratch.split_at_mut(split);
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
        let mut free: [FreeJacobian<'_>; MAX_FACTOR_VARIABLES] = Default::default();
        let mut free_count = 0;
        for ((jacobian, id), x) in jacobians.into_iter().zip(variables).zip(parameters) {
            let position = position[id.0 as usize];
            if position == CONSTANT {
                continue;
            }
            let variable = self.variable(*id);
            let jacobian = variable.manifold.restrict(x, rows, jacobian);
            if let Some(correction) = &correction {
                correction.apply_to_jacobian(residual, jacobian);
            }
            free[free_count] = FreeJacobian { position, columns: variable.degrees_of_freedom(), jacobian };
            free_count += 1;
        }
        if let Some(correction) = &correction {
            correction.apply_to_residual(residual);
        }
        write_products(&free[..free_count], residual, blocks);
        true
    }

    /// Adds the result of [`FactorView::normal_blocks`].
    pub fn add_to(
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
                products::add_block(block, height, &mut system.values[*offset as usize..], stride);
                (rest, offsets) = (after, next);
            }
            let start = pattern.starts[*at as usize] as usize;
            let (own, after) = rest.split_at(pattern.dimensions[*at as usize] as usize);
            gradient[start..start + own.len()].iter_mut().zip(own).for_each(|(g, v)| *g += v);
            rest = after;
        }
    }
}

/// The Jacobian with respect to the degrees of freedom of one variable.
#[derive(Default)]
struct FreeJacobian<'a> {
    position: u32,
    columns: usize,
    jacobian: &'a [f64],
}

/// Writes `JᵀJ` by blocks, each below the diagonal, with rows of the later variable; and `Jᵀr`.
fn write_products(free: &[FreeJacobian<'_>], residual: &[f64], mut blocks: &mut [f64]) {
    let rows = residual.len();
    for (i, own) in free.iter().enumerate() {
        for other in &free[..=i] {
            let (row, column) = if own.position >= other.position { (own, other) } else { (other, own) };
            let (block, after) = blocks.split_at_mut(row.columns * column.columns);
            products::transposed_product(rows, row.jacobian, column.jacobian, block);
            blocks = after;
        }
        let (gradient, after) = blocks.split_at_mut(own.columns);
        products::transposed_product(rows, own.jacobian, residual, gradient);
        blocks = after;
    }
}

impl Problem {
    /// The cost of each factor at the current values, in the order of evaluation; `None` for a factor that
    /// cannot be evaluated.
    pub fn factor_costs(&self) -> impl Iterator<Item = (FactorId, Option<f64>)> {
        let mut scratch = Vec::new();
        self.factors().map(move |(id, factor, loss)| {
            let view = FactorView { problem: self, values: &self.values, factor, loss };
            scratch.resize(view.scratch_size().max(scratch.len()), 0.0);
            (id, view.cost(&mut scratch))
        })
    }
}
