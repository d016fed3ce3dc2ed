//! A least-squares problem with many variables, in which each factor depends on only a few.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid2, Rigid3, Vector3};

use super::factor::{Factor, MAX_FACTOR_VARIABLES, Pool, TypedPool};
use super::manifold::{Manifold, RotationFreedom, TranslationFreedom};
use crate::Loss;

/// A variable of a [`Problem`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VariableId(pub(crate) u32);

/// A factor of a [`Problem`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FactorId {
    pub(crate) pool: u32,
    pub(crate) index: u32,
}

/// An invalid problem.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProblemError {
    /// A factor refers to a variable that the problem does not have.
    #[error("the factor depends on variable {variable}, but the problem has only {count}")]
    UnknownVariable {
        /// Index of the variable.
        variable: u32,
        /// Number of variables.
        count: usize,
    },
    /// A factor refers to one variable twice.
    #[error("the factor depends twice on variable {0}; give each variable once")]
    RepeatedVariable(u32),
    /// A factor has no or too many variables.
    #[error("the factor depends on {0} variables; 1 to {MAX_FACTOR_VARIABLES} are possible")]
    VariableCount(usize),
    /// The number of values of a variable does not match its manifold.
    #[error("the variable needs {expected} numbers, {given} were given")]
    AmbientDimension {
        /// Number that the manifold needs.
        expected: usize,
        /// Number that was given.
        given: usize,
    },
    /// A loss with a scale that is not positive.
    #[error("the scale of the loss must be positive and finite")]
    InvalidLoss,
    /// More than 2³² variables, factors or non-zeros.
    #[error("the problem is too large: more than 4 billion entries in {0}")]
    TooLarge(&'static str),
    /// The factorisation does not fit into memory.
    #[error("not enough memory for the factorisation of the normal equations")]
    OutOfMemory,
    /// Normal equations that do not constrain all variables.
    #[error("the factors do not determine all variables: hold one variable constant in each connected part")]
    Singular,
    /// Some residual is not finite at the current values.
    #[error("a residual cannot be evaluated at the current values of its variables")]
    NotEvaluable,
}

pub(crate) struct Variable {
    pub offset: u32,
    pub manifold: Manifold,
    pub constant: bool,
}

impl Variable {
    pub fn range(&self) -> std::ops::Range<usize> {
        let start = self.offset as usize;
        start..start + self.manifold.ambient_dimension()
    }

    /// Degrees of freedom that take part in the optimisation.
    pub fn degrees_of_freedom(&self) -> usize {
        if self.constant { 0 } else { self.manifold.free_dimension() }
    }
}

pub(crate) struct FactorGroup {
    pub pool: Box<dyn Pool>,
    pub losses: Vec<Loss>,
}

/// Variables and factors. Add them, call [`solve`](Problem::solve), read the variables back.
#[derive(Default)]
pub struct Problem {
    pub(crate) variables: Vec<Variable>,
    pub(crate) values: Vec<f64>,
    pub(crate) groups: Vec<FactorGroup>,
    last_group: usize,
}

impl Problem {
    /// An empty problem.
    pub fn new() -> Self {
        Self::default()
    }

    /// Reserves memory for this many more variables of at most `ambient_dimension` numbers each.
    pub fn reserve_variables(&mut self, count: usize, ambient_dimension: usize) {
        self.variables.reserve(count);
        self.values.reserve(count.saturating_mul(ambient_dimension));
    }

    /// Releases the memory that was reserved for more variables and factors.
    pub fn shrink_to_fit(&mut self) {
        self.variables.shrink_to_fit();
        self.values.shrink_to_fit();
        for group in &mut self.groups {
            group.pool.shrink_to_fit();
            group.losses.shrink_to_fit();
        }
    }

    /// Adds a variable with its initial values, in the layout of the manifold. Quaternions are not
    /// normalised; they should be.
    ///
    /// # Errors
    /// If the manifold needs another number of values, or the problem would have 2³² numbers or more.
    pub fn add_variable(&mut self, manifold: Manifold, values: &[f64]) -> Result<VariableId, ProblemError> {
        let expected = manifold.ambient_dimension();
        if expected != values.len() {
            return Err(ProblemError::AmbientDimension { expected, given: values.len() });
        }
        if u32::try_from(self.values.len() + expected).is_err() {
            return Err(ProblemError::TooLarge("values"));
        }
        Ok(self.push(manifold, values))
    }

    /// Saturates where [`Problem::add_variable`] returns an error: such a problem is refused when it is
    /// solved.
    fn push(&mut self, manifold: Manifold, values: &[f64]) -> VariableId {
        let id = VariableId(u32::try_from(self.variables.len()).unwrap_or(u32::MAX));
        let offset = u32::try_from(self.values.len()).unwrap_or(u32::MAX);
        self.variables.push(Variable { offset, manifold, constant: false });
        self.values.extend_from_slice(values);
        id
    }

    /// Adds a 2D pose.
    pub fn add_se2(&mut self, pose: &Rigid2) -> VariableId {
        self.push(Manifold::Se2, &[pose.translation.x, pose.translation.y, pose.angle])
    }

    /// Adds a pose with all degrees of freedom.
    pub fn add_se3(&mut self, pose: &Rigid3) -> VariableId {
        self.add_se3_with(pose, TranslationFreedom::Free, RotationFreedom::Free)
    }

    /// Adds a pose with restricted degrees of freedom.
    pub fn add_se3_with(
        &mut self,
        pose: &Rigid3,
        translation: TranslationFreedom,
        rotation: RotationFreedom,
    ) -> VariableId {
        self.push(Manifold::Se3(translation, rotation), &se3_values(pose))
    }

    /// Adds a rotation.
    pub fn add_rotation(&mut self, rotation: &Quaternion, freedom: RotationFreedom) -> VariableId {
        self.push(Manifold::Rotation(freedom), &quaternion_values(rotation))
    }

    /// Adds a position.
    pub fn add_translation(&mut self, position: &Vector3, freedom: TranslationFreedom) -> VariableId {
        self.push(Manifold::Translation(freedom), position.as_slice())
    }

    /// Adds a number.
    pub fn add_scalar(&mut self, value: f64) -> VariableId {
        self.push(Manifold::Euclidean(1), &[value])
    }

    /// Adds a number that stays at zero or above.
    pub fn add_nonnegative(&mut self, value: f64) -> VariableId {
        self.push(Manifold::NonNegative, &[value.max(0.0)])
    }

    /// Keeps a variable constant.
    pub fn set_constant(&mut self, id: VariableId) {
        self.hold(id, true);
    }

    /// Makes a variable free again.
    pub fn set_free(&mut self, id: VariableId) {
        self.hold(id, false);
    }

    fn hold(&mut self, id: VariableId, constant: bool) {
        if let Some(variable) = self.variables.get_mut(id.0 as usize) {
            variable.constant = constant;
        }
    }

    /// Adds a factor with its loss.
    ///
    /// # Errors
    /// If the factor has no variables, too many, one twice or one that does not exist; if the loss is not
    /// valid ([`Loss::is_valid`]); or if there are 2³² such factors already.
    pub fn add_factor<F: Factor>(&mut self, factor: F, loss: Loss) -> Result<FactorId, ProblemError> {
        self.check(factor.variables())?;
        if !loss.is_valid() {
            return Err(ProblemError::InvalidLoss);
        }
        let group = self.group_of::<F>();
        let Some(entry) = self.groups.get_mut(group) else { return Err(ProblemError::TooLarge("factors")) };
        let index = entry.losses.len();
        let id = FactorId {
            pool: group as u32,
            index: u32::try_from(index).map_err(|_| ProblemError::TooLarge("factors"))?,
        };
        if let Some(pool) = entry.pool.as_any_mut().downcast_mut::<TypedPool<F>>() {
            pool.0.push(factor);
            entry.losses.push(loss);
        }
        Ok(id)
    }

    fn check(&self, variables: &[VariableId]) -> Result<(), ProblemError> {
        if !(1..=MAX_FACTOR_VARIABLES).contains(&variables.len()) {
            return Err(ProblemError::VariableCount(variables.len()));
        }
        for (i, id) in variables.iter().enumerate() {
            if id.0 as usize >= self.variables.len() {
                return Err(ProblemError::UnknownVariable { variable: id.0, count: self.variables.len() });
            }
            if variables[..i].contains(id) {
                return Err(ProblemError::RepeatedVariable(id.0));
            }
        }
        Ok(())
    }

    /// The group of factors of type `F`; it is created if there is none. Factors are mostly added in runs of
    /// one type.
    fn group_of<F: Factor>(&mut self) -> usize {
        let last = self.last_group;
        let holds = |group: &mut FactorGroup| group.pool.as_any_mut().is::<TypedPool<F>>();
        if !self.groups.get_mut(last).is_some_and(holds) {
            self.last_group = self.groups.iter_mut().position(holds).unwrap_or_else(|| {
                let pool = Box::new(TypedPool::<F>(Vec::new()));
                self.groups.push(FactorGroup { pool, losses: Vec::new() });
                self.groups.len() - 1
            });
        }
        self.last_group
    }

    /// The numbers of a variable; empty if there is no such variable.
    pub fn values(&self, id: VariableId) -> &[f64] {
        let range = self.variables.get(id.0 as usize).map(Variable::range);
        range.and_then(|r| self.values.get(r)).unwrap_or_default()
    }

    /// Replaces the numbers of a variable.
    ///
    /// # Errors
    /// If there is no such variable, or it has another number of values.
    pub fn set_values(&mut self, id: VariableId, values: &[f64]) -> Result<(), ProblemError> {
        let count = self.variables.len();
        let variable = self
            .variables
            .get(id.0 as usize)
            .ok_or(ProblemError::UnknownVariable { variable: id.0, count })?;
        let expected = variable.manifold.ambient_dimension();
        match self.values.get_mut(variable.range()) {
            Some(old) if old.len() == values.len() => old.copy_from_slice(values),
            _ => return Err(ProblemError::AmbientDimension { expected, given: values.len() }),
        }
        Ok(())
    }

    /// A 2D pose; the identity if the variable is not one.
    pub fn se2(&self, id: VariableId) -> Rigid2 {
        match self.values(id) {
            &[x, y, angle] => Rigid2::new(x, y, angle),
            _ => Rigid2::identity(),
        }
    }

    /// A pose; the identity if the variable is not one.
    pub fn se3(&self, id: VariableId) -> Rigid3 {
        match self.values(id) {
            &[x, y, z, qw, qx, qy, qz] => Rigid3::from_parts(
                na::Translation3::new(x, y, z),
                Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz)),
            ),
            _ => Rigid3::identity(),
        }
    }

    /// A rotation; the identity if the variable is not one.
    pub fn rotation(&self, id: VariableId) -> Quaternion {
        match self.values(id) {
            &[w, x, y, z] => Quaternion::new_normalize(na::Quaternion::new(w, x, y, z)),
            _ => Quaternion::identity(),
        }
    }

    /// The first number of a variable; zero if there is none.
    pub fn scalar(&self, id: VariableId) -> f64 {
        self.values(id).first().copied().unwrap_or_default()
    }

    /// Number of variables, including constant ones.
    pub fn variable_count(&self) -> usize {
        self.variables.len()
    }

    /// Number of factors.
    pub fn factor_count(&self) -> usize {
        self.groups.iter().map(|g| g.pool.len()).sum()
    }

    /// Number of residuals of all factors together.
    pub fn residual_count(&self) -> usize {
        self.factors().map(|(_, factor, _)| factor.residual_dimension()).sum()
    }

    /// Degrees of freedom of all variables that are not constant.
    pub fn degrees_of_freedom(&self) -> usize {
        self.variables.iter().map(Variable::degrees_of_freedom).sum()
    }

    /// All factors in the fixed order in which they are evaluated.
    pub(crate) fn factors(&self) -> impl Iterator<Item = (FactorId, &dyn Factor, &Loss)> {
        self.groups.iter().enumerate().flat_map(|(pool, group)| {
            group.losses.iter().enumerate().filter_map(move |(index, loss)| {
                let id = FactorId { pool: pool as u32, index: index as u32 };
                group.pool.factor(index).map(|f| (id, f, loss))
            })
        })
    }

    pub(crate) fn factor(&self, id: FactorId) -> Option<(&dyn Factor, &Loss)> {
        let group = self.groups.get(id.pool as usize)?;
        Some((group.pool.factor(id.index as usize)?, group.losses.get(id.index as usize)?))
    }
}

/// The numbers of a pose variable.
pub(crate) fn se3_values(pose: &Rigid3) -> [f64; 7] {
    let (t, q) = (&pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

fn quaternion_values(rotation: &Quaternion) -> [f64; 4] {
    let q = rotation.quaternion();
    [q.w, q.i, q.j, q.k]
}
