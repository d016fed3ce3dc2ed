//! How sharp a point cloud is: without truth by what lies around each point, with truth by the distance to
//! the true surfaces.

mod boxes;
mod surface;
mod thickness;

pub use boxes::{SolidBox, read_boxes};
pub use portolan_refinement::{Sharpness, SharpnessOptions, sharpness, spread_sample};
pub use surface::{SurfaceErrors, surface_errors};
pub use thickness::{WallThickness, wall_thickness};
