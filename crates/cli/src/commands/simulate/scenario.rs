//! What is simulated, from the command line.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use portolan_simulator::ScenarioOptions;
use portolan_simulator::sensors::Fault;
use portolan_simulator::world::Scene;

/// The building, the walk, the sensors and what goes wrong with them.
#[derive(clap::Args, Clone, Debug)]
pub struct ScenarioArgs {
    /// Kind of building.
    #[arg(default_value = "office", value_name = "SCENARIO", value_parser = scene_parser())]
    scene: Scene,
    /// Building, walk, people and noise follow from it.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Seed of the building alone, to walk through the same building several times.
    #[arg(long, help_heading = "Building", value_name = "N")]
    building_seed: Option<u64>,
    /// Length of the recording. Default: one full tour of the building.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Length of the recording in minutes.
    #[arg(long, value_name = "MINUTES", conflicts_with = "seconds")]
    minutes: Option<f64>,
    /// Width and height of the floor, metres: `40x25`. Default: what suits the building.
    #[arg(long, help_heading = "Building", value_name = "WxH", value_parser = parse_size)]
    size: Option<[f64; 2]>,
    /// How many people walk about. Default: what suits the building.
    #[arg(long, help_heading = "Building", value_name = "N")]
    people: Option<usize>,
    /// Share of doors that are closed, 0 to 1.
    #[arg(long, help_heading = "Building", value_name = "SHARE", default_value_t = 0.2)]
    closed_doors: f64,
    /// How much furniture stands about: 0 none, 1 as usual, at most 3.
    #[arg(long, help_heading = "Building", value_name = "FACTOR", default_value_t = 1.0)]
    clutter: f64,
    /// Share of larger rooms with a glass front, 0 to 1.
    #[arg(long, help_heading = "Building", value_name = "SHARE", default_value_t = 0.35)]
    glass: f64,
    /// Speed of the robot, m/s.
    #[arg(long, help_heading = "Robot and sensors", value_name = "M/S", default_value_t = 0.8)]
    speed: f64,
    /// Scans per second.
    #[arg(long, help_heading = "Robot and sensors", value_name = "HZ", default_value_t = 10.0)]
    scan_rate: f64,
    /// Beams of a scan.
    #[arg(long, help_heading = "Robot and sensors", value_name = "N", default_value_t = 360)]
    beams: usize,
    /// Angle that a scan covers, degrees.
    #[arg(long, help_heading = "Robot and sensors", value_name = "DEGREES", default_value_t = 360.0)]
    field_of_view: f64,
    /// Range of the lidar, metres.
    #[arg(long, help_heading = "Robot and sensors", value_name = "METRES", default_value_t = 12.0)]
    range: f64,
    /// Record no wheel odometry.
    #[arg(long, help_heading = "Robot and sensors")]
    no_odometry: bool,
    /// Record no IMU.
    #[arg(long, help_heading = "Robot and sensors")]
    no_imu: bool,
    /// Exact sensors and nobody walking about.
    #[arg(long, help_heading = "Robot and sensors", conflicts_with = "people")]
    exact: bool,
    /// Something that goes wrong; may be given several times: duplicate:SENSOR:N, backward:SENSOR:N:SECONDS,
    /// gap:SENSOR:FROM:TO, nan:N, empty:N, jump:SECONDS:X:Y:YAW, no-gravity, clock:SENSOR:SECONDS,
    /// no-tf:SENSOR, where SENSOR is scan, odom or imu and N means every N-th message.
    #[arg(long, help_heading = "Robot and sensors", value_name = "FAULT")]
    fault: Vec<Fault>,
}

impl ScenarioArgs {
    /// The options of the simulator; it checks the values.
    pub fn options(&self) -> ScenarioOptions {
        let mut options = ScenarioOptions::new(self.scene, self.seed);
        options.building_seed = self.building_seed;
        options.duration = self.seconds.or(self.minutes.map(|minutes| 60.0 * minutes));
        options.size = self.size;
        options.people = self.people;
        options.closed_doors = self.closed_doors;
        options.clutter = self.clutter;
        options.glass = self.glass;
        options.motion.speed = self.speed;
        options.faults.clone_from(&self.fault);
        for lidar in &mut options.lidars {
            lidar.rate = self.scan_rate;
            lidar.beams = self.beams;
            lidar.field_of_view = self.field_of_view.to_radians();
            lidar.range_max = self.range;
        }
        if self.no_odometry {
            options.odometry = None;
        }
        if self.no_imu {
            options.imu = None;
        }
        if self.exact { options.without_noise() } else { options }
    }
}

fn scene_parser() -> impl TypedValueParser<Value = Scene> {
    PossibleValuesParser::new(Scene::ALL.map(Scene::name)).try_map(|name| name.parse::<Scene>())
}

fn parse_size(text: &str) -> Result<[f64; 2], String> {
    let parsed = text
        .split_once(['x', 'X'])
        .and_then(|(width, height)| Some([width.trim().parse().ok()?, height.trim().parse().ok()?]));
    parsed.ok_or_else(|| format!("{text} is no size; write width and height in metres, as 40x25"))
}
