//! Simulates buildings, lidars, IMU, wheels and walks, with exact ground truth.
//!
//! A [`Simulation`] draws a building from a seed ([`portolan_worlds`]), plans a smooth walk through it
//! ([`motion`]), measures with its sensors while walking ([`sensors`]) and is a
//! [`portolan_recording::Recording`], so that mapping can consume it like a file. It knows the exact
//! pose at any time.
//!
//! A [`Simulation3d`] is the same in 3D: storeys, stairs, ramps and terrain, a walk with
//! gait, and spinning lidars with any beams.
//!
//! The same options give the same bytes: random numbers are drawn per sensor and message from
//! [`Random`](portolan_worlds::Random), so the number of threads does not matter, and transcendental
//! functions come from `libm`, so the platform does not matter.
//!
//! ```
//! use portolan_simulator::{ScenarioOptions, Simulation};
//! # fn main() -> Result<(), portolan_simulator::SimulatorError> {
//! let options = ScenarioOptions { seed: 7, duration: Some(20.0), ..ScenarioOptions::default() };
//! let simulation = Simulation::new(options)?;
//! let map_from_base = simulation.truth_at(simulation.start_time());
//! assert!(map_from_base.is_some());
//! # Ok(())
//! # }
//! ```

mod error;
pub mod motion;
mod rig;
mod scenario;
mod scenario_3d;
pub mod sensors;
mod simulation;
mod simulation_3d;
mod streams;
mod truth;
mod truth_3d;

pub use error::SimulatorError;
pub use scenario::ScenarioOptions;
pub use scenario_3d::Scenario3dOptions;
pub use simulation::Simulation;
pub use simulation_3d::Simulation3d;
pub use truth::OccupancyPicture;
