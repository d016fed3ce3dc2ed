//! Options of the simulated scenario, from the command line.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use portolan_geometry::Rigid3;
use portolan_simulator::sensors::{
    BeamTable, Fault, GnssOptions, LandmarkOptions, OdometryOptions, SpinningLidarOptions,
};
use portolan_simulator::{Scenario3dOptions, ScenarioOptions, motion::Carrier};
use portolan_worlds::three_d::Scene3d;
use portolan_worlds::two_d::Scene;

use crate::commands::argument::pose_3d;

/// Kind of scene, 2D or 3D.
#[derive(Clone, Copy, Debug)]
pub enum AnyScene {
    /// Floor for a robot with a planar lidar.
    TwoD(Scene),
    /// World for a walker or a vehicle with spinning lidars.
    ThreeD(Scene3d),
}

/// Options of the simulator.
pub enum AnyScenario {
    /// In 2D.
    TwoD(Box<ScenarioOptions>),
    /// In 3D.
    ThreeD(Box<Scenario3dOptions>),
}

/// Building, motion, sensors and faults.
#[derive(clap::Args, Clone, Debug)]
pub struct ScenarioArgs {
    /// Kind of environment: office, corridors, hall and warehouse are 2D, for a robot with a planar lidar;
    /// museum (storeys, stairs, garden), garage (decks and ramps), park, tunnel and field (where a lidar is
    /// degenerate along the path) are 3D.
    #[arg(default_value = "office", value_name = "SCENARIO", value_parser = scene_parser())]
    scene: AnyScene,
    /// Seed of building, path, people and noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Seed of the building alone, for several recordings of the same building.
    #[arg(long, help_heading = "Building", value_name = "N")]
    building_seed: Option<u64>,
    /// Length of the recording. Default: one full tour of the building.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Length of the recording in minutes.
    #[arg(long, value_name = "MINUTES", conflicts_with = "seconds")]
    minutes: Option<f64>,
    /// Width and height of the floor, metres: `40x25`. Default: that of the scenario.
    #[arg(long, help_heading = "Building", value_name = "WxH", value_parser = parse_size)]
    size: Option<[f64; 2]>,
    /// Number of people who walk about. Default: that of the scenario.
    #[arg(long, help_heading = "Building", value_name = "N")]
    people: Option<usize>,
    /// Fraction of doors that are closed, 0 to 1. Default 0.2. Planar scenarios only.
    #[arg(long, help_heading = "Building", value_name = "FRACTION")]
    closed_doors: Option<f64>,
    /// Number of storeys (museum) or decks (garage), 1 to 6. Default 3. 3D scenarios only.
    #[arg(long, help_heading = "Building", value_name = "N")]
    storeys: Option<usize>,
    /// Amount of furniture: 0 none, 1 as usual, at most 3.
    #[arg(long, help_heading = "Building", value_name = "FACTOR", default_value_t = 1.0)]
    clutter: f64,
    /// Fraction of larger rooms with a glass front, 0 to 1.
    #[arg(long, help_heading = "Building", value_name = "FRACTION", default_value_t = 0.35)]
    glass: f64,
    /// Speed, m/s. Default 0.8, in 3D 1.2.
    #[arg(long, help_heading = "Robot and sensors", value_name = "M/S")]
    speed: Option<f64>,
    /// Scans or sweeps per second. Default 10.
    #[arg(long, help_heading = "Robot and sensors", value_name = "HZ")]
    scan_rate: Option<f64>,
    /// Beams per scan, in 3D firings per revolution. Default 360, in 3D that of the lidar model.
    #[arg(long, help_heading = "Robot and sensors", value_name = "N")]
    beams: Option<usize>,
    /// Field of view of a scan, degrees. Default 360. Planar scenarios only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "DEGREES")]
    field_of_view: Option<f64>,
    /// Range of the lidar, metres. Default 12, in 3D that of the lidar model.
    #[arg(long, help_heading = "Robot and sensors", value_name = "METRES")]
    range: Option<f64>,
    /// Number of spinning lidars, at most 8; every second one spins about a horizontal axis. Default 1.
    /// 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "N")]
    lidars: Option<usize>,
    /// Lidar model: vlp16, vlp32, hdl64, os1-16, os1-64, os0-128, xt32, or avia, mid360 with a non-repetitive
    /// scan pattern; or `LOW:HIGH:BEAMS[:COLUMNS[:RANGE]]`, or the elevation of each beam,
    /// `-15,-7,-3,0,3[:COLUMNS[:RANGE]]`, angles in degrees. Default vlp16. 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "MODEL", allow_hyphen_values = true)]
    lidar: Option<BeamTable>,
    /// Pose of a spinning lidar on the platform, metres and degrees; may be given once for each. 3D scenarios
    /// only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "X,Y,Z,ROLL,PITCH,YAW",
        value_parser = pose_3d, allow_hyphen_values = true)]
    mounting: Vec<Rigid3>,
    /// Record points without times. 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors")]
    no_point_times: bool,
    /// Platform that carries the sensors: walker or wheels. Default: walker in the museum, else wheels. 3D
    /// scenarios only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "PLATFORM", value_parser = carrier_parser())]
    carrier: Option<Carrier>,
    /// Stand still throughout (with --seconds or --minutes). 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors")]
    standing: bool,
    /// Record landmarks on the walls. 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors")]
    landmarks: bool,
    /// Record no satellite fixes. 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors")]
    no_gnss: bool,
    /// Record no satellite fixes in this interval, seconds since the start, `30:60`; may be given several
    /// times. 3D scenarios only.
    #[arg(long, help_heading = "Robot and sensors", value_name = "FROM:TO", value_parser = parse_span)]
    gnss_outage: Vec<[f64; 2]>,
    /// Record no wheel odometry (in 3D, a walker has none).
    #[arg(long, help_heading = "Robot and sensors")]
    no_odometry: bool,
    /// Record no IMU.
    #[arg(long, help_heading = "Robot and sensors")]
    no_imu: bool,
    /// Sensors without errors, and no people.
    #[arg(long, help_heading = "Robot and sensors", conflicts_with = "people")]
    exact: bool,
    /// Fault to simulate; may be given several times: duplicate:SENSOR:N, backward:SENSOR:N:SECONDS,
    /// gap:SENSOR:FROM:TO, nan:N, empty:N, jump:SECONDS:X:Y:YAW, no-gravity, clock:SENSOR:SECONDS,
    /// no-tf:SENSOR, dies:SECONDS (the last lidar), saturate:GYROSCOPE:ACCELEROMETER, swap-axes (IMU), where
    /// SENSOR is scan, odom or imu and N means every N-th message.
    #[arg(long, help_heading = "Robot and sensors", value_name = "FAULT")]
    fault: Vec<Fault>,
}

impl ScenarioArgs {
    /// Options of the simulator, which checks the values. It is an error to give an option that does not apply to the
    /// scenario.
    pub fn scenario(&self) -> Result<AnyScenario, String> {
        let misplaced = match self.scene {
            AnyScene::TwoD(_) => self.only_in_3d(),
            AnyScene::ThreeD(_) => self.only_in_2d(),
        };
        if let Some(option) = misplaced {
            let kind = if matches!(self.scene, AnyScene::TwoD(_)) { "3D" } else { "planar" };
            return Err(format!("--{option} is for {kind} scenarios only"));
        }
        if self.mounting.len() > self.lidars.unwrap_or(1) {
            return Err(format!("--mounting is given {} times for fewer --lidars", self.mounting.len()));
        }
        Ok(match self.scene {
            AnyScene::TwoD(scene) => AnyScenario::TwoD(Box::new(self.options_2d(scene))),
            AnyScene::ThreeD(scene) => AnyScenario::ThreeD(Box::new(self.options_3d(scene))),
        })
    }

    fn only_in_3d(&self) -> Option<&'static str> {
        let given = [
            ("storeys", self.storeys.is_some()),
            ("lidars", self.lidars.is_some()),
            ("lidar", self.lidar.is_some()),
            ("mounting", !self.mounting.is_empty()),
            ("no-point-times", self.no_point_times),
            ("carrier", self.carrier.is_some()),
            ("standing", self.standing),
            ("landmarks", self.landmarks),
            ("no-gnss", self.no_gnss),
            ("gnss-outage", !self.gnss_outage.is_empty()),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }

    fn only_in_2d(&self) -> Option<&'static str> {
        let given =
            [("closed-doors", self.closed_doors.is_some()), ("field-of-view", self.field_of_view.is_some())];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(name, _)| name)
    }

    fn duration(&self) -> Option<f64> {
        self.seconds.or(self.minutes.map(|minutes| 60.0 * minutes))
    }

    fn options_2d(&self, scene: Scene) -> ScenarioOptions {
        let mut options = ScenarioOptions::new(scene, self.seed);
        options.building_seed = self.building_seed;
        options.duration = self.duration();
        options.size = self.size;
        options.people = self.people;
        options.closed_doors = self.closed_doors.unwrap_or(options.closed_doors);
        options.clutter = self.clutter;
        options.glass = self.glass;
        options.motion.speed = self.speed.unwrap_or(options.motion.speed);
        options.faults.clone_from(&self.fault);
        for lidar in &mut options.lidars {
            lidar.rate = self.scan_rate.unwrap_or(lidar.rate);
            lidar.beams = self.beams.unwrap_or(lidar.beams);
            lidar.field_of_view = self.field_of_view.map_or(lidar.field_of_view, f64::to_radians);
            lidar.range_max = self.range.unwrap_or(lidar.range_max);
        }
        if self.no_odometry {
            options.odometry = None;
        }
        if self.no_imu {
            options.imu = None;
        }
        if self.exact { options.without_noise() } else { options }
    }

    fn options_3d(&self, scene: Scene3d) -> Scenario3dOptions {
        let mut options = Scenario3dOptions::new(scene, self.seed, self.lidars.unwrap_or(1).min(9));
        options.building_seed = self.building_seed;
        options.duration = self.duration();
        options.size = self.size;
        options.storeys = self.storeys;
        options.people = self.people;
        options.clutter = self.clutter;
        options.glass = self.glass;
        options.carrier = self.carrier;
        options.standing = self.standing;
        options.speed = self.speed.unwrap_or(options.speed);
        options.faults.clone_from(&self.fault);
        options.lidars.iter_mut().for_each(|lidar| self.set_up(lidar));
        for (lidar, base_from_lidar) in options.lidars.iter_mut().zip(&self.mounting) {
            lidar.base_from_lidar = *base_from_lidar;
        }
        options.gnss = (!self.no_gnss)
            .then(|| GnssOptions { outages: self.gnss_outage.clone(), ..GnssOptions::default() });
        options.landmarks = self.landmarks.then(LandmarkOptions::default);
        if options.carrier() == Carrier::Wheels && !self.no_odometry {
            options.odometry = Some(OdometryOptions::default());
        }
        if self.no_imu {
            options.imu = None;
        }
        if self.exact { options.without_noise() } else { options }
    }

    fn set_up(&self, lidar: &mut SpinningLidarOptions) {
        if let Some(model) = &self.lidar {
            lidar.beams.clone_from(model);
        }
        lidar.rate = self.scan_rate.unwrap_or(lidar.rate);
        lidar.beams.columns = self.beams.unwrap_or(lidar.beams.columns);
        lidar.beams.range_max = self.range.unwrap_or(lidar.beams.range_max);
        lidar.point_times = !self.no_point_times;
    }
}

fn scene_parser() -> impl TypedValueParser<Value = AnyScene> {
    let names = Scene::ALL.map(Scene::name).into_iter().chain(Scene3d::ALL.map(Scene3d::name));
    PossibleValuesParser::new(names).try_map(|name| {
        name.parse::<Scene3d>().map(AnyScene::ThreeD).or_else(|_| name.parse::<Scene>().map(AnyScene::TwoD))
    })
}

fn carrier_parser() -> impl TypedValueParser<Value = Carrier> {
    PossibleValuesParser::new(["walker", "wheels"])
        .map(|name| if name == "walker" { Carrier::Walker } else { Carrier::Wheels })
}

fn parse_size(text: &str) -> Result<[f64; 2], String> {
    parse_pair(text, &['x', 'X'])
        .ok_or_else(|| format!("{text} is not a size; write width and height in metres, as 40x25"))
}

fn parse_span(text: &str) -> Result<[f64; 2], String> {
    parse_pair(text, &[':'])
        .filter(|[from, to]| from < to)
        .ok_or_else(|| format!("{text} is not a time span; write from and to in seconds, as 30:60"))
}

fn parse_pair(text: &str, separators: &[char]) -> Option<[f64; 2]> {
    let (first, second) = text.split_once(separators)?;
    Some([first.trim().parse().ok()?, second.trim().parse().ok()?])
}
