//! Results for an IMU from matching sweeps of a lidar (offset of its clock, rotation against the lidar), and
//! the findings from them.

use portolan_geometry::Vector3;
use std::sync::Arc;

use crate::finding::Findings;
use crate::rotation::{misalignment_finding, mounting_finding, offset_finding};

/// The offset between the clocks of a lidar and an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockOffset {
    /// Topic of the lidar.
    pub lidar: Arc<str>,
    /// Topic of the IMU.
    pub imu: Arc<str>,
    /// Time by which the lidar is stamped too late against the IMU, seconds.
    pub seconds: f64,
    /// Standard deviation of the offset, seconds, estimated with 19 degrees of freedom.
    pub sigma: f64,
    /// Whether the points of the lidar have times; without them it is unknown which part of a sweep its
    /// stamp belongs to.
    pub has_point_times: bool,
}

/// Offsets above which they are reported, and above which the report is a warning, seconds: first for lidars
/// whose points have times, then for others, whose sweeps take a tenth of a second. At 1 rad/s the first
/// value displaces points at 10 m by 10 cm.
const OFFSETS: [[f64; 2]; 2] = [[0.01, 0.035], [0.05, 0.1]];
/// Number of standard deviations by which an offset has to exceed them: for a clock exactly at the limit,
/// one in two thousand is reported (Student's t with 19 degrees of freedom, one side).
const SURE: f64 = 3.9;

impl ClockOffset {
    fn limits(&self) -> [f64; 2] {
        OFFSETS[usize::from(!self.has_point_times)]
    }

    /// Whether the offset certainly exceeds measurement errors, so that it is reported.
    pub fn is_significant(&self) -> bool {
        let [reported, _] = self.limits();
        self.seconds.abs() - SURE * self.sigma > reported
    }

    pub(super) fn add_to(&self, findings: &mut Findings) {
        if self.is_significant() {
            let [_, warned] = self.limits();
            findings.push(offset_finding(&self.imu, &self.lidar, self.seconds, warned));
        }
    }
}

/// Results for the IMU from the rotations of lidars in 3D.
#[derive(Clone, Debug, Default)]
pub struct ImuComparison {
    /// Offset of the clock of each lidar against that of the IMU, where the recording determines it.
    pub offsets: Vec<ClockOffset>,
    /// How the IMU rotates, where all lidars agree that it rotates differently.
    pub mounting: Option<ImuMounting>,
    /// Small error of its mounting in the transforms, where it otherwise rotates like the lidars and the
    /// error is certain.
    pub misalignment: Option<ImuMisalignment>,
}

/// An IMU whose mounting differs by a few degrees from the transforms.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuMisalignment {
    /// Its topic.
    pub imu: Arc<str>,
    /// Rotation vector from its measured axes to those of the transforms, in the tracking frame, radians.
    pub rotation: Vector3,
    /// Standard deviation of its length, radians.
    pub sigma: f64,
}

impl std::fmt::Display for ImuMisalignment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [degrees, sigma] = [self.rotation.norm(), self.sigma].map(f64::to_degrees);
        write!(
            f,
            "is rotated by {degrees:.1}° (sigma {sigma:.1}°) against its mounting in the transforms, as the rotation of the lidar shows"
        )
    }
}

impl ImuComparison {
    pub(super) fn add_to(&self, findings: &mut Findings) {
        self.offsets.iter().for_each(|offset| offset.add_to(findings));
        if let Some(mounting) = &self.mounting {
            findings.push(mounting_finding(&mounting.imu, mounting));
        }
        if let Some(misalignment) = &self.misalignment {
            findings.push(misalignment_finding(&misalignment.imu, misalignment));
        }
    }
}

/// How an IMU rotates that does not rotate like the lidar: its transform, its axes or its units differ from
/// those assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuMounting {
    /// Its topic.
    pub imu: Arc<str>,
    /// Angle between its axes and those of the transforms, radians.
    pub turned: f64,
    /// Ratio of its angular velocity to that of the lidar; negative if the directions are opposite.
    pub factor: f64,
}

/// Range of the ratio for a gyroscope in degrees per second: 57.3, within the accuracy of scans.
const DEGREES: std::ops::Range<f64> = 50.0..65.0;

impl ImuMounting {
    /// Whether only the unit of angular velocities is wrong: they are in degrees per second.
    pub fn is_in_degrees(&self) -> bool {
        self.turned == 0.0 && DEGREES.contains(&self.factor)
    }
}

impl std::fmt::Display for ImuMounting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { turned, factor, .. } = *self;
        if turned > 0.0 {
            write!(
                f,
                "rotates as the lidar does only if its axes are rotated by {:.0}°",
                turned.to_degrees()
            )?;
            return if (factor - 1.0).abs() > 0.1 {
                write!(f, " and its rates divided by {factor:.2}")
            } else {
                Ok(())
            };
        }
        match factor < 0.0 {
            true => write!(f, "rotates opposite to the lidar, {:.2} times as fast", -factor),
            false => write!(f, "rotates {factor:.2} times as fast as the lidar"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings_to_text;

    #[test]
    fn only_significant_offsets_are_reported() {
        let text = |seconds: f64, sigma: f64, has_point_times: bool| {
            let (lidar, imu) = ("/points".into(), "/imu".into());
            let mut findings = Findings::default();
            ClockOffset { lidar, imu, seconds, sigma, has_point_times }.add_to(&mut findings);
            findings_to_text(&findings.finish())
        };
        for (seconds, sigma, has_point_times) in
            [(0.004, 1e-4, true), (0.02, 0.005, true), (-0.04, 1e-4, false), (f64::NAN, 0.0, true)]
        {
            assert_eq!(text(seconds, sigma, has_point_times), "");
        }
        assert!(text(0.02, 0.001, true).contains("0.020 s later than those of /imu"));
        assert!(text(0.02, 0.001, true).contains("--time-offset /points=-0.020"));
        assert!(text(-0.05, 0.001, true).contains("0.050 s earlier than those of /imu"));
        assert!(text(-0.15, 0.001, false).contains("0.15 s earlier"));
    }
}
