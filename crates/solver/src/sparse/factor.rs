//! Factors: residuals that depend on a few variables.

use std::any::Any;

use super::problem::VariableId;

/// Maximum number of variables of one factor.
pub const MAX_FACTOR_VARIABLES: usize = 8;

/// A residual and its derivatives. Factors of one type are stored contiguously: keep them small and free of
/// allocations.
pub trait Factor: Send + Sync + 'static {
    /// The variables it depends on, each once, at most [`MAX_FACTOR_VARIABLES`].
    fn variables(&self) -> &[VariableId];

    /// Number of residuals; constant for a factor.
    fn residual_dimension(&self) -> usize;

    /// Computes the residual for the given values, one slice per variable in the layout of its
    /// [`Manifold`](super::Manifold). If Jacobians are requested, there is one per variable, initialised to
    /// zero and stored column by column: `residual_dimension()` rows,
    /// [`tangent_dimension`](super::Manifold::tangent_dimension) columns. Returns false if the residual
    /// cannot be evaluated; the solver then takes a shorter step.
    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool;
}

/// All factors of one type, behind a type-erased interface.
pub(crate) trait Pool: Any + Send + Sync {
    fn len(&self) -> usize;
    fn factor(&self, index: usize) -> Option<&dyn Factor>;
    fn shrink_to_fit(&mut self);
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

pub(crate) struct TypedPool<F>(pub Vec<F>);

impl<F: Factor> Pool for TypedPool<F> {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn factor(&self, index: usize) -> Option<&dyn Factor> {
        self.0.get(index).map(|f| f as &dyn Factor)
    }

    fn shrink_to_fit(&mut self) {
        self.0.shrink_to_fit();
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}
