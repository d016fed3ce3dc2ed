//! A drive through the building, and how far poses are from the truth.

use std::error::Error;

use portolan::evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors};
use portolan::geometry::{Dimension, Rigid3, Time};
use portolan::recording::Recording;
use portolan::simulator::sensors::{LidarOptions, OdometryOptions};
use portolan::simulator::{Scenario3dOptions, ScenarioOptions, Simulation, Simulation3d};
use portolan::worlds::three_d::Scene3d;
use portolan::worlds::two_d::Scene;

/// Scans a second, and beams of one in 2D and columns of one in 3D: a day of usual ones would take the simulator longer than
/// mapping.
const RATE: f64 = 5.0;
const BEAMS: usize = 180;
const COLUMNS: usize = 300;

/// A day in the building.
pub enum Drive {
    /// Through an office, with lidar and wheels, and people in the way.
    TwoD(Simulation),
    /// Through a storey of a museum, with a backpack that has a lidar and an IMU.
    ThreeD(Simulation3d),
}

impl Drive {
    /// A drive of so many seconds, or one tour.
    pub fn new(dimension: Dimension, day: u64, seconds: Option<f64>) -> Result<Self, Box<dyn Error>> {
        Ok(match dimension {
            Dimension::TwoD => Self::TwoD(Simulation::new(ScenarioOptions {
                building_seed: Some(1),
                duration: seconds,
                people: Some(2),
                lidars: vec![LidarOptions { rate: RATE, beams: BEAMS, ..LidarOptions::default() }],
                odometry: Some(OdometryOptions { rate: 4.0 * RATE, ..OdometryOptions::default() }),
                imu: None,
                ..ScenarioOptions::new(Scene::Office, day)
            })?),
            Dimension::ThreeD => {
                let mut options = Scenario3dOptions {
                    scene: Scene3d::Museum,
                    seed: day,
                    building_seed: Some(1),
                    duration: seconds,
                    size: Some([22.0, 19.0]),
                    storeys: Some(1),
                    people: Some(2),
                    ..Scenario3dOptions::default()
                };
                for lidar in &mut options.lidars {
                    lidar.rate = RATE;
                    lidar.beams.columns = COLUMNS;
                }
                Self::ThreeD(Simulation3d::new(options)?)
            }
        })
    }

    /// What the sensors measured.
    pub fn recording(&self) -> &dyn Recording {
        match self {
            Self::TwoD(simulation) => simulation,
            Self::ThreeD(simulation) => simulation,
        }
    }

    fn truth_at(&self, time: Time) -> Option<Rigid3> {
        match self {
            Self::TwoD(simulation) => simulation.truth_at(time),
            Self::ThreeD(simulation) => simulation.truth_at(time),
        }
    }

    /// The absolute trajectory error in words.
    pub fn errors(&self, found: &Trajectory) -> Result<String, Box<dyn Error>> {
        let truth = found.poses().iter().filter_map(|pose| {
            Some(TimedPose { time: pose.time, map_from_tracking: self.truth_at(pose.time)? })
        });
        let truth = Trajectory::new(truth).0;
        let alignment = match self {
            Self::TwoD(_) => Alignment::Se2,
            Self::ThreeD(_) => Alignment::Se3,
        };
        let errors = absolute_errors(&truth, found, Association::default(), alignment)?;
        let translation = errors.translation;
        Ok(format!(
            "{} poses, {:.0} m; absolute error rmse {:.4} m, most {:.3} m",
            errors.count, errors.path_length, translation.rmse, translation.max
        ))
    }
}
