//! Options of a simulation in 3D, and their checks.

use portolan_geometry::{Rigid3, Time, Vector3, nalgebra as na};

use crate::SimulatorError;
use crate::motion::{Carrier, rotation};
use crate::scenario::{LONGEST, Names, check_sensors, within};
use crate::sensors::{
    Fault, GnssOptions, ImuOptions, LandmarkOptions, OdometryOptions, SpinningLidarOptions,
};
use portolan_worlds::three_d::Scene3d;
use portolan_worlds::three_d::{SolidPlan, SolidStyle};

/// All options of a simulation in 3D. The defaults are a tour of a museum with a backpack that has one
/// lidar and an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario3dOptions {
    /// Kind of surroundings. Default museum.
    pub scene: Scene3d,
    /// Seed of everything random. Default 1.
    pub seed: u64,
    /// Seed of the world alone; none for `seed`.
    pub building_seed: Option<u64>,
    /// Width and depth, metres; none for the default of the scene. At most 400 each.
    pub size: Option<[f64; 2]>,
    /// Number of storeys or decks, 1 to 6; none for the default of the scene.
    pub storeys: Option<usize>,
    /// Length of the recording, seconds; none for every loop once. As many loops as fit are walked, then a
    /// path out and back again. Default none.
    pub duration: Option<f64>,
    /// True time at the start. Default 1 700 000 000 s after 1970.
    pub start_time: Time,
    /// Number of people who walk about; none for the default of the scene.
    pub people: Option<usize>,
    /// Density of furniture and other objects: 0 none, 1 usual, at most 3. Default 1.
    pub clutter: f64,
    /// Fraction of windows, 0 to 1. Default 0.35.
    pub glass: f64,
    /// Platform that carries the sensors; none for the default of the scene.
    pub carrier: Option<Carrier>,
    /// Speed, m/s. Default 1.2.
    pub speed: f64,
    /// Factor of the bobbing and swaying of the body: 0 none, 1 usual, at most 3. Default 1.
    pub gait: f64,
    /// Time to stand at the start and at the end, seconds. Default 2.
    pub rest: f64,
    /// Whether to stand all the time, without swaying (with a duration). Default no.
    pub standing: bool,
    /// Height of `base_link` above the ground, metres. Default 1.3.
    pub base_height: f64,
    /// Lidars. Default one.
    pub lidars: Vec<SpinningLidarOptions>,
    /// IMU; none if it is not recorded. Default 200 samples per second.
    pub imu: Option<ImuOptions>,
    /// Wheel odometry; none if it is not recorded, which is the default.
    pub odometry: Option<OdometryOptions>,
    /// Satellite receiver; none if it is not recorded, which is the default.
    pub gnss: Option<GnssOptions>,
    /// Landmarks; none if they are not recorded, which is the default.
    pub landmarks: Option<LandmarkOptions>,
    /// Faults of the sensors (`scan` means the lidars). Default none.
    pub faults: Vec<Fault>,
}

impl Default for Scenario3dOptions {
    fn default() -> Self {
        Self {
            scene: Scene3d::default(),
            seed: 1,
            building_seed: None,
            size: None,
            storeys: None,
            duration: None,
            start_time: Time::from_ros(1_700_000_000, 0),
            people: None,
            clutter: 1.0,
            glass: 0.35,
            carrier: None,
            speed: 1.2,
            gait: 1.0,
            rest: 2.0,
            standing: false,
            base_height: 1.3,
            lidars: usual_lidars(1),
            imu: Some(ImuOptions { rate: 200.0, ..ImuOptions::default() }),
            odometry: None,
            gnss: None,
            landmarks: None,
            faults: Vec::new(),
        }
    }
}

/// One lidar above the head on `/points2`, or on `/points2_1`, with a second one behind that spins about a
/// nearly horizontal axis on `/points2_2`, and so on alternately.
pub(crate) fn usual_lidars(count: usize) -> Vec<SpinningLidarOptions> {
    let mount = |i: usize| {
        let lift = 0.1 * (i / 2) as f64;
        let (place, [roll, pitch, yaw]) = if i.is_multiple_of(2) {
            (Vector3::new(0.0, 0.0, 0.5 + lift), [0.0, 0.0, 0.0])
        } else {
            (Vector3::new(-0.18, 0.0, 0.15 + lift), [0.0, 1.35, 0.0])
        };
        Rigid3::from_parts(na::Translation3::from(place), rotation(roll, pitch, yaw))
    };
    let name = |stem: &str, i: usize| if count == 1 { stem.to_owned() } else { format!("{stem}_{}", i + 1) };
    (0..count)
        .map(|i| SpinningLidarOptions {
            topic: name("/points2", i),
            frame: name("lidar", i),
            base_from_lidar: mount(i),
            // The heads are not synchronised.
            phase: 0.037 * i as f64,
            ..SpinningLidarOptions::default()
        })
        .collect()
}

impl Scenario3dOptions {
    /// The default options for a scene, a seed and a number of lidars.
    pub fn new(scene: Scene3d, seed: u64, lidars: usize) -> Self {
        Self { scene, seed, lidars: usual_lidars(lidars), ..Self::default() }
    }

    /// The same scenario with exact sensors and without people.
    pub fn without_noise(self) -> Self {
        Self {
            people: Some(0),
            lidars: self.lidars.into_iter().map(SpinningLidarOptions::without_noise).collect(),
            odometry: self.odometry.map(OdometryOptions::without_noise),
            imu: self.imu.map(ImuOptions::without_noise),
            gnss: self.gnss.map(GnssOptions::without_noise),
            landmarks: self.landmarks.map(LandmarkOptions::without_noise),
            ..self
        }
    }

    /// The platform that carries the sensors.
    pub fn carrier(&self) -> Carrier {
        self.carrier.unwrap_or(Carrier::usual_in(self.scene))
    }

    /// Number of people who walk about.
    pub(crate) fn people(&self) -> usize {
        self.people.unwrap_or(self.scene.default_people())
    }

    fn style(&self) -> SolidStyle {
        SolidStyle {
            size: self.size.unwrap_or(self.scene.default_size()),
            storeys: self.storeys.unwrap_or(self.scene.default_storeys()),
            clutter: self.clutter,
            glass: self.glass,
        }
    }

    /// Draws the world.
    pub(crate) fn plan(&self) -> SolidPlan {
        self.scene.draw(&self.style(), self.building_seed.unwrap_or(self.seed))
    }

    /// Checks every value; errors name the option and its bounds.
    ///
    /// # Errors
    /// The first value that is outside its bounds; else missing or repeated names of sensors, or a fault of
    /// a sensor that is not recorded.
    pub fn check(&self) -> Result<(), SimulatorError> {
        let style = self.style();
        let [least_width, least_depth] = self.scene.minimum_size();
        within("size (width)", style.size[0], least_width, 400.0)?;
        within("size (depth)", style.size[1], least_depth, 400.0)?;
        within("storeys", style.storeys as f64, 1.0, 6.0)?;
        within("duration", self.duration.unwrap_or(1.0), 0.1, LONGEST)?;
        within("people", self.people() as f64, 0.0, 1000.0)?;
        within("clutter", self.clutter, 0.0, 3.0)?;
        within("glass", self.glass, 0.0, 1.0)?;
        within("speed", self.speed, 0.05, 20.0)?;
        within("gait", self.gait, 0.0, 3.0)?;
        within("rest", self.rest, 0.0, 600.0)?;
        within("base_height", self.base_height, 0.0, 10.0)?;
        within("lidars", self.lidars.len() as f64, 0.0, 8.0)?;
        self.lidars.iter().try_for_each(check_lidar)?;
        self.gnss.iter().try_for_each(check_gnss)?;
        self.landmarks.iter().try_for_each(check_landmarks)?;
        let lidars: Vec<Names> = self.lidars.iter().map(|l| (&*l.topic, Some(&*l.frame))).collect();
        let gnss = self.gnss.iter().map(|g| (&*g.topic, Some(&*g.frame)));
        let others: Vec<Names> = gnss.chain(self.landmarks.iter().map(|l| (&*l.topic, None))).collect();
        check_sensors(&lidars, (self.odometry.as_ref(), self.imu.as_ref()), &others, &self.faults)
    }
}

fn check_pose(option: &str, pose: &Rigid3) -> Result<(), SimulatorError> {
    match portolan_geometry::is_valid_pose(pose) && pose.translation.vector.norm() < 100.0 {
        true => Ok(()),
        false => Err(SimulatorError::BadNames {
            detail: format!("{option} is not a rigid transform of less than 100 m"),
        }),
    }
}

fn check_lidar(lidar: &SpinningLidarOptions) -> Result<(), SimulatorError> {
    if !lidar.beams.is_sensible() {
        let detail =
            "lidar.beams: the lists must be of the same length, with 1 to 1024 beams, angles in radians and \
                      8 to 100,000 columns"
                .to_owned();
        return Err(SimulatorError::BadNames { detail });
    }
    check_pose("lidar.base_from_lidar", &lidar.base_from_lidar)?;
    within("lidar.beams.range_max", lidar.beams.range_max, 0.5, 1000.0)?;
    within("lidar.rate", lidar.rate, 0.5, 100.0)?;
    within("lidar.phase", lidar.phase, 0.0, 10.0)?;
    within("lidar.range_min", lidar.range_min, 0.0, 10.0)?;
    within("lidar.range_noise", lidar.range_noise, 0.0, 10.0)?;
    within("lidar.range_resolution", lidar.range_resolution, 0.0, 1.0)?;
    within("lidar.drop_out", lidar.drop_out, 0.0, 1.0)
}

fn check_gnss(gnss: &GnssOptions) -> Result<(), SimulatorError> {
    check_pose("gnss.base_from_antenna", &gnss.base_from_antenna)?;
    within("gnss.rate", gnss.rate, 0.1, 100.0)?;
    within("gnss.origin_degrees (latitude)", gnss.origin_degrees[0], -89.0, 89.0)?;
    within("gnss.origin_degrees (longitude)", gnss.origin_degrees[1], -180.0, 180.0)?;
    within("gnss.origin_altitude", gnss.origin_altitude, -1000.0, 10_000.0)?;
    within("gnss.noise", gnss.noise, 0.0, 100.0)?;
    within("gnss.wander", gnss.wander, 0.0, 100.0)
}

fn check_landmarks(landmarks: &LandmarkOptions) -> Result<(), SimulatorError> {
    within("landmarks.rate", landmarks.rate, 0.1, 100.0)?;
    within("landmarks.range", landmarks.range, 0.5, 100.0)?;
    within("landmarks.position_noise", landmarks.position_noise, 0.0, 10.0)?;
    within("landmarks.rotation_noise", landmarks.rotation_noise, 0.0, 1.0)?;
    within("landmarks.camera_height", landmarks.camera_height, -10.0, 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_option() {
        assert!(Scenario3dOptions::default().check().is_ok());
        let refused = |options: Scenario3dOptions| options.check().unwrap_err().to_string();
        let tiny = Scenario3dOptions { size: Some([5.0, 30.0]), ..Scenario3dOptions::default() };
        assert_eq!(refused(tiny), "size (width) must be from 22 to 400, but is 5");
        let mut twice = Scenario3dOptions::default();
        twice.lidars.extend(usual_lidars(1));
        assert!(refused(twice).contains("topic /points2 is used twice"));
        assert!(
            "mall"
                .parse::<Scene3d>()
                .unwrap_err()
                .to_string()
                .contains("museum, garage, park, tunnel, field")
        );
        assert!(Scenario3dOptions::new(Scene3d::Park, 1, 4).check().is_ok());
    }
}
