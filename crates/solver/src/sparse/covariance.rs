//! Covariance of variables.

use nalgebra::DMatrix;

use super::block_system::SINGULAR_PIVOT;
use super::factor_view::CONSTANT;
use super::problem::{Problem, ProblemError, VariableId};

/// Joint covariance of some variables: the corresponding blocks of `(JᵀJ)⁻¹`, in the tangent space of the
/// degrees of freedom of each variable. Rotations are half-angle vectors: multiply by 2 (variances by 4) for
/// radians. Meaningful if the residuals are weighted by their standard deviations.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariance {
    starts: Vec<usize>,
    matrix: DMatrix<f64>,
}

impl Covariance {
    /// The block of the `i`-th and the `j`-th requested variable; empty for constant variables, `None` beyond
    /// the end.
    pub fn block(&self, i: usize, j: usize) -> Option<DMatrix<f64>> {
        let range = |k: usize| Some((*self.starts.get(k)?, *self.starts.get(k + 1)?));
        let ((row, row_end), (column, column_end)) = (range(i)?, range(j)?);
        Some(self.matrix.view((row, column), (row_end - row, column_end - column)).into_owned())
    }

    /// All blocks side by side.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}

impl Problem {
    /// Covariance of `variables` at the current values; robust losses enter as weights. Takes one
    /// factorisation and one triangular solve per requested degree of freedom.
    ///
    /// # Errors
    /// If the problem is too large, a residual cannot be evaluated at the current values, the factors do not
    /// constrain all variables, or one of `variables` does not exist.
    pub fn covariance(&self, variables: &[VariableId]) -> Result<Covariance, ProblemError> {
        let mut prepared = self.prepare()?;
        let (linearization, system) = (&mut prepared.linearization, &mut prepared.system);
        let n = system.size();
        let mut gradient = vec![0.0; n];
        if !linearization.linearize(self, &self.values, system, &mut gradient) {
            return Err(ProblemError::NotEvaluable);
        }
        if n > 0 && !(system.factorize(&vec![0.0; n]) && system.smallest_pivot_ratio() > SINGULAR_PIVOT) {
            return Err(ProblemError::Singular);
        }
        let mut unknowns = Vec::new();
        let mut starts = vec![0];
        for id in variables {
            let count = linearization.position.len();
            let position = linearization.position.get(id.0 as usize).copied();
            let position = position.ok_or(ProblemError::UnknownVariable { variable: id.0, count })?;
            if position != CONSTANT {
                let start = system.pattern.starts[position as usize];
                unknowns.extend(start as usize..system.pattern.starts[position as usize + 1] as usize);
            }
            starts.push(unknowns.len());
        }
        let mut matrix = DMatrix::zeros(unknowns.len(), unknowns.len());
        let mut column = vec![0.0; n];
        for (j, unknown) in unknowns.iter().enumerate() {
            column.fill(0.0);
            column[*unknown] = 1.0;
            system.solve(&mut column);
            for (i, row) in unknowns.iter().enumerate() {
                matrix[(i, j)] = column[*row];
            }
        }
        if matrix.iter().any(|v| !v.is_finite()) {
            return Err(ProblemError::Singular);
        }
        let matrix = (&matrix + matrix.transpose()) * 0.5;
        Ok(Covariance { starts, matrix })
    }
}
