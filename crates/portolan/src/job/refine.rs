//! Data and results of `refine`: the raw points of a recording, and a folder with trajectory, cloud, map and
//! report.
//!
//! [`read_points`] gives the input of
//! [`refine_continuous_with`](portolan_refinement::continuous::refine_continuous_with); [`write_refinement`]
//! writes its result.

mod cloud_pair;
mod judgement;
mod page;
mod pictures;
mod points;
mod results;

pub use judgement::Judgement;
pub use points::{MotionSensor, PointReading, ReadPoints, read_points};
pub use results::{REFINED_FILES, RefineResults, write_refinement};
