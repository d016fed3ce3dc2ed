//! Continuous-time refinement: a trajectory is bent, continuously in time and in all six degrees of freedom,
//! until everything it saw fits together.
//!
//! 1. Points of short windows become planar patches ([`surfels`]).
//! 2. Coarse: patches of different windows are paired, far pairs first, and knots seconds apart are solved for.
//! 3. Fine: patches of all windows are grouped into planes; knots a tenth of a second apart and all planes are
//!    solved for together.
//! 4. With the better trajectory patches are sharper; steps 1 and 3 are repeated.

mod block_tridiagonal;
mod cells;
mod coarse;
mod dense_trajectory;
mod fine;
mod knots;
mod odometry;
mod pairs;
mod plane_equations;
mod planes;
mod surfels;

use portolan_geometry::{Rigid3, Time};

pub use dense_trajectory::{Correction, DenseTrajectory};
pub use knots::Knots;
pub use odometry::OdometryNoise;

use crate::{PointStore, RefineError};
use coarse::coarse_step;
use fine::fine_step;
use surfels::{SurfelMap, TimedPoints};

/// How to refine.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ContinuousOptions {
    /// Length of the windows within which the input is trusted to show a wall as one sheet, seconds.
    pub window: f64,
    /// How wrong the motion of the input may be.
    pub odometry: OdometryNoise,
}

impl Default for ContinuousOptions {
    fn default() -> Self {
        Self { window: 2.0, odometry: OdometryNoise { translation: 0.05, rotation: 0.5_f64.to_radians() } }
    }
}

/// How far a refinement is.
#[derive(Clone, Debug)]
pub struct RefineProgress {
    /// What was just done.
    pub stage: String,
    /// Share that is done, 0 to 1.
    pub share: f64,
    /// Root mean square distance of points (or pairs of patches) across their surfaces, metres.
    pub rms: f64,
    /// Largest shift of the last step, metres.
    pub shift: f64,
}

/// Bends a trajectory (`world_from_tracking` in ascending order of time) until the points fit together.
/// `observe` is called after each step and stops by returning false; what is reached is kept.
///
/// # Errors
/// Fails if there are no points, no surfaces, too few poses, or points and poses are of different times.
pub fn refine_continuous(
    points: &PointStore,
    input: &[(Time, Rigid3)],
    options: &ContinuousOptions,
    observe: &mut dyn FnMut(&RefineProgress) -> bool,
) -> Result<DenseTrajectory, RefineError> {
    let mut trajectory = DenseTrajectory::new(input)?;
    let offset = points.start().seconds_since(trajectory.start());
    let timed = TimedPoints { points: points.points(), offset };
    let mut map = SurfelMap::extract(timed, &trajectory, options.window);
    if map.surfels.is_empty() {
        return Err(RefineError::NoSurfaces(points.points().len()));
    }
    let coarse = Knots::new(trajectory.duration(), options.window);
    const GATES: [f64; 4] = [1.0, 0.5, 0.25, 0.12];
    for gate in GATES {
        for _ in 0..4 {
            let step = coarse_step(&map, &mut trajectory, &coarse, options.odometry, gate)?;
            let stage = format!("coarse {gate} m, {} pairs of {} surfels", step.pairs, map.surfels.len());
            if !observe(&RefineProgress { stage, share: 0.0, rms: step.rms, shift: step.shift }) {
                return Ok(trajectory);
            }
        }
    }
    for (spacing, gap, steps) in [(0.5, 0.15, 3), (0.1, 0.1, 3), (0.1, 0.1, 3)] {
        map = SurfelMap::extract(timed, &trajectory, options.window);
        let knots = Knots::new(trajectory.duration(), spacing);
        for _ in 0..steps {
            let step = fine_step(&map, &mut trajectory, &knots, options.odometry, gap)?;
            let stage = format!(
                "fine {spacing} s, {} planes, {} clusters, {} solver steps",
                step.planes, step.clusters, step.solver_steps
            );
            if !observe(&RefineProgress { stage, share: 0.0, rms: step.rms, shift: step.shift }) {
                return Ok(trajectory);
            }
        }
    }
    trajectory.anchor_first_pose();
    Ok(trajectory)
}
