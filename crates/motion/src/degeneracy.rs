//! Directions of motion that scans do not constrain, and the sensors that measure them instead.

use portolan_geometry::Vector3;

/// Unit vectors of the directions that a scan does not constrain. The frame is documented where they are
/// used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DegenerateDirections {
    /// Translations along these are not constrained.
    pub translations: Vec<Vector3>,
    /// Rotations about these are not constrained.
    pub rotations: Vec<Vector3>,
}

impl DegenerateDirections {
    /// Whether the scan constrains all directions.
    pub fn is_empty(&self) -> bool {
        self.translations.is_empty() && self.rotations.is_empty()
    }
}

/// Which motion a scan constrains, and which other sensors measure the rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observability {
    /// Directions that it does not constrain, in the tracking frame at its end.
    pub degenerate: DegenerateDirections,
    /// Whether odometry or a zero-velocity update measured the translation.
    pub translation_is_measured: bool,
    /// Whether a gyroscope measured the rotation.
    pub rotation_is_measured: bool,
}

impl Observability {
    /// Whether there is no degenerate direction.
    pub fn is_empty(&self) -> bool {
        self.degenerate.is_empty()
    }
}
