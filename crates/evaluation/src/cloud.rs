//! Quality of a point cloud: its sharpness from the neighbourhood of each point if there is no ground truth,
//! and its distance to the true surfaces if there is.

mod boxes;
mod comparison;
mod fit;
mod mesh_files;
mod orthogonality;
mod passes;
mod quality;
mod reference;
mod search;
mod surface;
mod thickness;
mod triangles;
mod wall_changes;

pub use boxes::{SolidBox, read_boxes};
pub use comparison::{PairedComparison, compare_places, place_of};
pub use mesh_files::{Mesh, is_mesh, read_mesh};
pub use orthogonality::{MutualOrthogonality, mutual_orthogonality};
pub use passes::{PassDistance, PassDistances, PassOptions, pass_distances};
pub use portolan_spatial::{Sharpness, SharpnessOptions, sharpness, spread_sample};
pub use quality::{CloudQuality, CloudToJudge, QualityOptions, cloud_quality};
pub use reference::ReferenceCloud;
pub use surface::{SurfaceErrors, TrueSurfaces, surface_errors};
pub use thickness::{WallThickness, wall_thickness};
pub use triangles::Triangle;
pub use wall_changes::{WallChange, WallChanges};
