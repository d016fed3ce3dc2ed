//! Checks the IMU samples of one topic (checks 1 and 13 of `spec/tools.md` §2.6), units and direction of
//! gravity.

use portolan_geometry::{Rigid3, Vector3};
use portolan_ingest::{FAST_TURN, MAX_ACCELERATION, MAX_ANGULAR_VELOCITY, is_partial};
use portolan_issue::Severity;
use portolan_recording::Imu;

use crate::finding::{Findings, Kind};
use crate::histogram::Histogram;
use crate::imu_values::{Rest, Saturation};

const ACCELERATION: Kind = Kind {
    name: "acceleration",
    severity: Severity::Warning,
    effect: "level and motion are misjudged during such shocks",
    to_do: "accelerations must be in m/s² and include gravity; mount the sensor on dampers if it is shaken",
};
const MEAN_ACCELERATION: Kind = Kind {
    name: "mean acceleration",
    severity: Severity::Error,
    effect: "level is misjudged; in 3D the map bends or the scale of motion is wrong",
    to_do: "acceleration data should include gravity and be given in m/s²",
};
const NO_GRAVITY: Kind = Kind {
    name: "no gravity",
    severity: Severity::Error,
    effect: "the IMU is left out; in 3D level is only what it was at the start",
    to_do: "let the driver send accelerations that include gravity, as the sensor measures them",
};
const IN_G: Kind = Kind {
    name: "in g",
    severity: Severity::Warning,
    effect: "none: such accelerations are multiplied by 9.80665",
    to_do: "let the driver send m/s²",
};
const NOT_A_NUMBER: Kind = Kind {
    name: "not a number",
    severity: Severity::Error,
    effect: "these samples are left out",
    to_do: "mend the driver",
};
const IMPOSSIBLE: Kind = Kind {
    name: "impossible values",
    severity: Severity::Error,
    effect: "these samples are left out",
    to_do: "look for faults of the transmission or of the driver; no IMU measures 80 rad/s or 400 m/s²",
};
const PARTIAL: Kind = Kind {
    name: "partial",
    severity: Severity::Error,
    effect: "samples that lack acceleration or angular velocity are left out",
    to_do: "use an IMU that measures both, or map in 2D without it",
};
const DEGREES: Kind = Kind {
    name: "gyroscope in degrees",
    severity: Severity::Error,
    effect: "such angular velocities are multiplied by π/180 where the first seconds show it; else rotation is overestimated 57 times and there is no sensible map",
    to_do: "angular velocities must be in rad/s; convert the recording or mend the driver",
};
const UPSIDE_DOWN: Kind = Kind {
    name: "upside down",
    severity: Severity::Warning,
    effect: "the map comes out upside down, or motion is mirrored in 2D",
    to_do: "at rest the acceleration must point up (+9.8 along the axis that points up); give the mounting of the IMU in the transforms",
};
const LEANING: Kind = Kind {
    name: "leaning",
    severity: Severity::Warning,
    effect: "the map is level, but the robot seems to lean; in 2D scans are projected wrongly",
    to_do: "give the mounting of the IMU in the transforms",
};

const AXES: Kind = Kind {
    name: "axes",
    severity: Severity::Error,
    effect: "the IMU is left out where the frame of the robot shows it; elsewhere in 3D level is found from gravity, but rotations are taken about the wrong axes where transforms connect it with the lidar",
    to_do: "give the mounting of the IMU in the transforms, or let the driver send x forward, y left, z up",
};

/// Angle above which the IMU does not lean but has other axes, degrees.
const OTHER_AXES: f64 = 60.0;

/// Median acceleration below which gravity is missing, m/s². Values about 1 are an exception: they are in g
/// if they do not cancel out.
/// Range of median accelerations that are taken to be in g.
const LEAST_GRAVITY: f64 = 3.0;
/// Mean acceleration vector from which values about 1 are in g.
const IN_G_RANGE: std::ops::Range<f64> = 0.8..1.2;
const LEAST_MEAN_IN_G: f64 = 0.3;

/// IMU samples of one topic.
#[derive(Debug, Default)]
pub(crate) struct ImuChecks {
    count: u64,
    sum: Vector3,
    norms: Histogram,
    sum_of_norms: f64,
    fast: u64,
    /// Number of samples faster than gyroscopes can measure, unless they are in degrees.
    too_fast: u64,
    rest: Rest,
    saturation: Saturation,
}

impl ImuChecks {
    pub fn add(&mut self, topic: &str, imu: &Imu, findings: &mut Findings) {
        let (acceleration, rate) =
            (Vector3::from(imu.linear_acceleration), Vector3::from(imu.angular_velocity));
        let (frame, stamp) = (&imu.header.frame_id, imu.header.stamp);
        if is_partial(imu) {
            return findings.add(&PARTIAL, topic, || {
                "samples say that they lack acceleration or angular velocity (covariance −1)".to_owned()
            });
        }
        let norm = acceleration.norm();
        let finite = |v: &Vector3| v.iter().all(|x| x.is_finite());
        if !finite(&acceleration) || !finite(&rate) {
            return findings
                .add(&NOT_A_NUMBER, topic, || format!("samples of frame_id {frame} are not numbers"));
        }
        // Units are not known yet: in degrees per second, values may be 57 times as large.
        if acceleration.amax() > MAX_ACCELERATION || rate.amax() > 57.3 * MAX_ANGULAR_VELOCITY {
            return findings.add(&IMPOSSIBLE, topic, || {
                format!("{:.3e} rad/s or {:.3e} m/s² in one sample", rate.amax(), acceleration.amax())
            });
        }
        self.count += 1;
        self.sum += acceleration;
        self.sum_of_norms += norm;
        self.too_fast += u64::from(rate.amax() > MAX_ANGULAR_VELOCITY);
        self.norms.add(norm);
        self.fast += u64::from(rate.norm() > FAST_TURN);
        self.rest.add(stamp, rate, acceleration);
        self.saturation.add(rate, acceleration);
        if !(3.0..=30.0).contains(&norm) && !(0.3..=3.0).contains(&norm) {
            findings.add(&ACCELERATION, topic, || {
                format!(
                    "frame_id {frame} time {}: IMU linear acceleration is {norm:.3} m/s^2, expected is [3, 30] m/s^2. (It should include gravity and be given in m/s^2.) linear_acceleration {:.3} {:.3} {:.3}",
                    stamp.unix_nanoseconds(), acceleration.x, acceleration.y, acceleration.z
                )
            });
        }
    }

    /// The measured direction of up, in its own frame; none if gravity was removed.
    pub fn up(&self) -> Option<Vector3> {
        self.sum.try_normalize(1e-9).filter(|_| !self.lacks_gravity())
    }

    /// Whether most accelerations are too small for gravity, even if they were in g.
    fn lacks_gravity(&self) -> bool {
        let usual = self.norms.median().unwrap_or(0.0);
        // Vibrations of 1 g without gravity cancel out on average.
        let mean = self.sum.norm() / self.count.max(1) as f64;
        usual < LEAST_GRAVITY && (!IN_G_RANGE.contains(&usual) || mean < LEAST_MEAN_IN_G)
    }

    /// Adds findings about the whole topic; `base_from_imu` is its mounting, if known.
    pub fn finish(&self, topic: &str, base_from_imu: Option<&Rigid3>, findings: &mut Findings) {
        if self.count == 0 {
            return;
        }
        let mean = self.sum_of_norms / self.count as f64;
        let usual = self.norms.median().unwrap_or(0.0);
        if self.lacks_gravity() {
            findings.add(&NO_GRAVITY, topic, || {
                format!("half of the IMU linear accelerations are below {usual:.3} m/s^2: gravity was removed from them")
            });
        } else if IN_G_RANGE.contains(&usual) {
            findings.add(&IN_G, topic, || {
                format!("IMU linear acceleration is {usual:.4} most of the time: it seems to be in g")
            });
        } else if !(9.5..=10.5).contains(&mean) {
            findings.add(&MEAN_ACCELERATION, topic, || {
                format!("average IMU linear acceleration is {mean:.4} m/s^2, expected is [9.5, 10.5] m/s^2. Linear acceleration data should include gravity and be given in m/s^2")
            });
        }
        if self.fast * 10 > self.count {
            let share = 100 * self.fast / self.count;
            findings.add(&DEGREES, topic, || {
                format!("{share}% of the angular velocities are above {FAST_TURN} rad/s; they seem to be in degrees")
            });
        } else if self.too_fast > 0 {
            findings.add(&IMPOSSIBLE, topic, || {
                format!("{} angular velocities are above {MAX_ANGULAR_VELOCITY} rad/s", self.too_fast)
            });
        }
        self.rest.finish(topic, findings);
        self.saturation.finish(topic, findings);
        let (Some(up), Some(mounting)) = (self.up(), base_from_imu) else { return };
        let up_in_base = mounting.rotation * up;
        let lean = up_in_base.z.clamp(-1.0, 1.0).acos().to_degrees();
        if (OTHER_AXES..=180.0 - OTHER_AXES).contains(&lean) {
            let (axis, sign) = axis_of(&up);
            return findings.add(&AXES, topic, || {
                format!("gravity lies along {sign}{axis} of the IMU, {lean:.0}° away from the vertical that the transforms give: its axes are swapped, or its mounting is missing")
            });
        }
        let kind = if lean > 135.0 { &UPSIDE_DOWN } else { &LEANING };
        if lean > 20.0 {
            findings.add(kind, topic, || {
                format!("on average \"up\" leans {lean:.0}° against the z axis of the tracking frame ({:.2} {:.2} {:.2})", up_in_base.x, up_in_base.y, up_in_base.z)
            });
        }
    }
}

/// The axis nearest to a direction, and its sign.
pub(super) fn axis_of(direction: &Vector3) -> (&'static str, &'static str) {
    let axis = direction.iamax();
    (["x", "y", "z"][axis], if direction[axis] < 0.0 { "-" } else { "+" })
}
