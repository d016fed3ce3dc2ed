//! Common interface of 2D and 3D simulations.

use std::io::{self, Write};

use portolan_geometry::{Rigid3, Time};
use portolan_recording::Recording;
use portolan_simulator::{Simulation, Simulation3d};

/// Writes surfaces.
pub type SurfaceWriter<'a> = Box<dyn Fn(&mut dyn Write) -> io::Result<()> + 'a>;

/// A simulated recording with its ground truth.
pub trait Simulated: Recording {
    /// Default rate of true poses, Hz.
    fn usual_truth_rate(&self) -> f64;

    /// Writes the true trajectory in TUM format, at `rate` poses per second.
    fn write_truth(&self, out: &mut dyn Write, rate: f64) -> io::Result<()>;

    /// File endings and writers of the true surfaces.
    fn surfaces(&self) -> Vec<(&'static str, SurfaceWriter<'_>)>;

    /// Duration, seconds, and path length, metres, of the trajectory.
    fn extent(&self) -> (f64, f64);
}

impl Simulated for Simulation {
    fn usual_truth_rate(&self) -> f64 {
        100.0
    }

    fn write_truth(&self, out: &mut dyn Write, rate: f64) -> io::Result<()> {
        self.write_truth_tum(out, rate)
    }

    fn surfaces(&self) -> Vec<(&'static str, SurfaceWriter<'_>)> {
        vec![("walls.csv", Box::new(|out| self.write_walls_csv(out)))]
    }

    fn extent(&self) -> (f64, f64) {
        (self.duration(), path_length(self.truth(20.0)))
    }
}

impl Simulated for Simulation3d {
    fn usual_truth_rate(&self) -> f64 {
        200.0
    }

    fn write_truth(&self, out: &mut dyn Write, rate: f64) -> io::Result<()> {
        self.write_truth_tum(out, rate)
    }

    fn surfaces(&self) -> Vec<(&'static str, SurfaceWriter<'_>)> {
        vec![
            ("surfaces.json", Box::new(|out| self.write_surfaces_json(out))),
            ("surfaces.ply", Box::new(|out| self.write_surfaces_ply(out))),
        ]
    }

    fn extent(&self) -> (f64, f64) {
        (self.duration(), path_length(self.truth(20.0)))
    }
}

/// Path length along the poses, metres.
fn path_length(poses: impl Iterator<Item = (Time, Rigid3)>) -> f64 {
    let mut positions = poses.map(|(_, pose)| pose.translation.vector);
    let Some(mut last) = positions.next() else { return 0.0 };
    positions.map(|position| (position - std::mem::replace(&mut last, position)).norm()).sum()
}
