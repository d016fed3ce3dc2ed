//! Options of a simulation in 2D, and their checks.

use portolan_geometry::Time;

use crate::SimulatorError;
use crate::motion::MotionLimits;
use crate::sensors::{Fault, FaultTarget, ImuOptions, LidarOptions, OdometryOptions, check_faults};
use portolan_worlds::two_d::{PlanStyle, Scene};

/// All options of a simulation. The defaults are a full tour of an office floor by a robot with a lidar,
/// wheel odometry and an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ScenarioOptions {
    /// Kind of building. Default office.
    pub scene: Scene,
    /// Seed of everything random: building, walk, people, noise. Default 1.
    pub seed: u64,
    /// Seed of the building alone, for several walks through the same building; none for `seed`.
    pub building_seed: Option<u64>,
    /// Width and height of the floor, metres; none for the default of the scene. At most 200 each.
    pub size: Option<[f64; 2]>,
    /// Length of the recording, seconds, at most a day; none for one full tour. A tour that takes longer
    /// goes home early, a shorter one starts over; if time is left at the end, the robot stands. Default
    /// none.
    pub duration: Option<f64>,
    /// True time at the start. Default 1 700 000 000 s after 1970.
    pub start_time: Time,
    /// Number of people who walk about; none for the default of the scene.
    pub people: Option<usize>,
    /// Fraction of doors that are closed, in [0, 1]. Default 0.2.
    pub closed_doors: f64,
    /// Density of furniture: 0 none, 1 usual, at most 3. Default 1.
    pub clutter: f64,
    /// Fraction of larger rooms with a glass front, in [0, 1]; at 0, halls have no glass front, either.
    /// Default 0.35.
    pub glass: f64,
    /// Speed and acceleration of the robot.
    pub motion: MotionLimits,
    /// Distance that the robot keeps from all fixed surfaces, metres. Default 0.3.
    pub robot_radius: f64,
    /// Time to stand at the start and at the end, seconds. Default 2.
    pub rest: f64,
    /// Lidars. Default one.
    pub lidars: Vec<LidarOptions>,
    /// Wheel odometry; none if it is not recorded.
    pub odometry: Option<OdometryOptions>,
    /// IMU; none if it is not recorded.
    pub imu: Option<ImuOptions>,
    /// Faults of the sensors. Default none.
    pub faults: Vec<Fault>,
}

impl Default for ScenarioOptions {
    fn default() -> Self {
        Self {
            scene: Scene::default(),
            seed: 1,
            building_seed: None,
            size: None,
            duration: None,
            start_time: Time::from_ros(1_700_000_000, 0),
            people: None,
            closed_doors: 0.2,
            clutter: 1.0,
            glass: 0.35,
            motion: MotionLimits::default(),
            robot_radius: 0.3,
            rest: 2.0,
            lidars: vec![LidarOptions::default()],
            odometry: Some(OdometryOptions::default()),
            imu: Some(ImuOptions::default()),
            faults: Vec::new(),
        }
    }
}

/// Longest recording, seconds.
pub(crate) const LONGEST: f64 = 86_400.0;
const FULL_CIRCLE: f64 = std::f64::consts::TAU;

impl ScenarioOptions {
    /// The default options for a scene and a seed.
    pub fn new(scene: Scene, seed: u64) -> Self {
        Self { scene, seed, ..Self::default() }
    }

    /// The same scenario with exact sensors and without people.
    pub fn without_noise(self) -> Self {
        Self {
            people: Some(0),
            lidars: self.lidars.into_iter().map(LidarOptions::without_noise).collect(),
            odometry: self.odometry.map(OdometryOptions::without_noise),
            imu: self.imu.map(ImuOptions::without_noise),
            ..self
        }
    }

    pub(crate) fn plan_style(&self) -> PlanStyle {
        PlanStyle {
            size: self.size.unwrap_or(self.scene.default_size()),
            closed_doors: self.closed_doors,
            clutter: self.clutter,
            glass: self.glass,
        }
    }

    /// Checks every value; errors name the option and its bounds.
    ///
    /// # Errors
    /// The first value that is outside its bounds; else missing or repeated names of sensors, or a fault of
    /// a sensor that is not recorded.
    pub fn check(&self) -> Result<(), SimulatorError> {
        let [width, height] = self.size.unwrap_or(self.scene.default_size());
        let [least_width, least_height] = self.scene.minimum_size();
        within("size (width)", width, least_width, 200.0)?;
        within("size (height)", height, least_height, 200.0)?;
        within("duration", self.duration.unwrap_or(1.0), 0.1, LONGEST)?;
        within("people", self.people.unwrap_or(0) as f64, 0.0, 1000.0)?;
        within("closed_doors", self.closed_doors, 0.0, 1.0)?;
        within("clutter", self.clutter, 0.0, 3.0)?;
        within("glass", self.glass, 0.0, 1.0)?;
        within("robot_radius", self.robot_radius, 0.05, 1.0)?;
        within("rest", self.rest, 0.0, 600.0)?;
        within("motion.speed", self.motion.speed, 0.05, 20.0)?;
        within("motion.acceleration", self.motion.acceleration, 0.01, 20.0)?;
        within("motion.turn_rate", self.motion.turn_rate, 0.05, 20.0)?;
        within("motion.turn_acceleration", self.motion.turn_acceleration, 0.05, 100.0)?;
        self.lidars.iter().try_for_each(check_lidar)?;
        let lidars: Vec<Names> = self.lidars.iter().map(|l| (&*l.topic, Some(&*l.frame))).collect();
        check_sensors(&lidars, (self.odometry.as_ref(), self.imu.as_ref()), &[], &self.faults)
    }
}

/// The names of one sensor: its topic, and its frame if it has one.
pub(crate) type Names<'a> = (&'a str, Option<&'a str>);

/// Checks that both kinds of scenarios share: names must differ, and faults must concern sensors that are
/// recorded.
pub(crate) fn check_sensors(
    lidars: &[Names],
    (odometry, imu): (Option<&OdometryOptions>, Option<&ImuOptions>),
    others: &[Names],
    faults: &[Fault],
) -> Result<(), SimulatorError> {
    odometry.map_or(Ok(()), check_odometry)?;
    imu.map_or(Ok(()), check_imu)?;
    let mut names = vec![("/tf_static", Some("base_link"))];
    names.extend(lidars.iter().chain(others));
    names.extend(odometry.map(|o| (o.topic.as_str(), Some(o.frame.as_str()))));
    names.extend(imu.map(|i| (i.topic.as_str(), Some(i.frame.as_str()))));
    check_unique("topic", names.iter().map(|(topic, _)| *topic).collect())?;
    let frames = names.iter().filter_map(|(_, frame)| *frame);
    check_unique("frame", frames.collect())?;
    let recorded = [
        (!lidars.is_empty()).then_some(FaultTarget::Scan),
        odometry.map(|_| FaultTarget::Odometry),
        imu.map(|_| FaultTarget::Imu),
    ];
    check_faults(faults, &recorded.into_iter().flatten().collect::<Vec<_>>())
}

/// Whether all names are given and different.
fn check_unique(what: &str, mut names: Vec<&str>) -> Result<(), SimulatorError> {
    let bad = |detail: String| Err(SimulatorError::BadNames { detail });
    names.sort_unstable();
    if names.first().is_some_and(|name| name.is_empty()) {
        return bad(format!("a {what} without a name; give every sensor a {what}"));
    }
    match names.windows(2).find(|pair| pair[0] == pair[1]) {
        Some(twice) => bad(format!("the {what} {} is used twice; give every sensor its own", twice[0])),
        None => Ok(()),
    }
}

pub(crate) fn within(option: &'static str, value: f64, low: f64, high: f64) -> Result<(), SimulatorError> {
    match (low..=high).contains(&value) {
        true => Ok(()),
        false => Err(SimulatorError::OutOfBounds { option, bounds: format!("from {low} to {high}"), value }),
    }
}

fn check_lidar(lidar: &LidarOptions) -> Result<(), SimulatorError> {
    within("lidar.rate", lidar.rate, 0.1, 1000.0)?;
    within("lidar.beams", lidar.beams as f64, 2.0, 100_000.0)?;
    within("lidar.field_of_view", lidar.field_of_view, 1e-3, FULL_CIRCLE + 1e-4)?;
    within("lidar.range_min", lidar.range_min, 0.0, 10.0)?;
    within("lidar.range_max", lidar.range_max, lidar.range_min.max(0.1), 500.0)?;
    within("lidar.range_noise", lidar.range_noise, 0.0, 10.0)?;
    within("lidar.range_noise_relative", lidar.range_noise_relative, 0.0, 1.0)?;
    within("lidar.range_resolution", lidar.range_resolution, 0.0, 1.0)?;
    within("lidar.drop_out", lidar.drop_out, 0.0, 1.0)?;
    within("lidar.beam_divergence", lidar.beam_divergence, 0.0, 0.5)?;
    within("lidar.mixed_pixels", lidar.mixed_pixels, 0.0, 1.0)?;
    let mount = lidar.mount;
    for value in [mount.x, mount.y, mount.z, mount.yaw] {
        within("lidar.mount", value, -10.0, 10.0)?;
    }
    Ok(())
}

fn check_odometry(odometry: &OdometryOptions) -> Result<(), SimulatorError> {
    within("odometry.rate", odometry.rate, 0.1, 2000.0)?;
    within("odometry.wheel_separation", odometry.wheel_separation, 0.05, 5.0)?;
    within("odometry.wheel_size_error", odometry.wheel_size_error, 0.0, 0.2)?;
    within("odometry.wheel_separation_error", odometry.wheel_separation_error, 0.0, 0.2)?;
    within("odometry.noise", odometry.noise, 0.0, 1.0)?;
    within("odometry.slips_per_minute", odometry.slips_per_minute, 0.0, 60.0)?;
    within("odometry.slip_ratio", odometry.slip_ratio, -1.0, 10.0)?;
    within("odometry.encoder_resolution", odometry.encoder_resolution, 0.0, 0.1)
}

fn check_imu(imu: &ImuOptions) -> Result<(), SimulatorError> {
    within("imu.rate", imu.rate, 0.1, 2000.0)?;
    within("imu.gyroscope_noise", imu.gyroscope_noise, 0.0, 10.0)?;
    within("imu.accelerometer_noise", imu.accelerometer_noise, 0.0, 10.0)?;
    within("imu.gyroscope_bias", imu.gyroscope_bias, 0.0, 10.0)?;
    within("imu.accelerometer_bias", imu.accelerometer_bias, 0.0, 10.0)?;
    within("imu.gyroscope_bias_walk", imu.gyroscope_bias_walk, 0.0, 10.0)?;
    within("imu.accelerometer_bias_walk", imu.accelerometer_bias_walk, 0.0, 10.0)?;
    within("imu.gravity", imu.gravity, 0.0, 30.0)?;
    let valid = portolan_geometry::is_valid_pose(&imu.base_from_imu);
    match valid {
        true => Ok(()),
        false => {
            Err(SimulatorError::BadNames { detail: "imu.base_from_imu is not a rigid transform".to_owned() })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_option() {
        assert!(ScenarioOptions::default().check().is_ok());
        let refused = |options: ScenarioOptions| options.check().unwrap_err().to_string();
        let tiny = ScenarioOptions { size: Some([5.0, f64::NAN]), ..ScenarioOptions::default() };
        assert_eq!(refused(tiny), "size (width) must be from 26 to 200, but is 5");
        let nan = ScenarioOptions { duration: Some(f64::NAN), ..ScenarioOptions::default() };
        assert!(refused(nan).starts_with("duration must be"));
        let twice = vec![LidarOptions::default(), LidarOptions::default()];
        let twice = ScenarioOptions { lidars: twice, ..ScenarioOptions::default() };
        assert!(refused(twice).contains("topic /scan is used twice"));
        let unknown = "mall".parse::<Scene>().unwrap_err().to_string();
        assert!(unknown.contains("office, corridors, hall, warehouse"));
    }
}
