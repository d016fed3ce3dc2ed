//! Beam directions and range limits of the scans of a CARMEN log.

use std::f64::consts::PI;

use super::line::{LaserConfig, LaserKind};
use super::survey::Survey;

/// Maximum range of the SICK scanners of the old format, metres.
const SICK_MAXIMUM: f32 = 80.0;
/// Smallest valid reading, metres.
pub(crate) const MINIMUM_RANGE: f32 = 0.02;

/// Angles and limits of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ScanGeometry {
    /// Angle of the first beam, radians, counter-clockwise from ahead.
    pub start: f64,
    /// Radians from beam to beam.
    pub increment: f64,
    /// Largest reading that is a return, metres; larger ones mean "no return".
    pub range_max: f32,
}

impl ScanGeometry {
    /// Angle of the last beam.
    pub fn end(&self, count: usize) -> f64 {
        self.start + count.saturating_sub(1) as f64 * self.increment
    }
}

/// The geometry of a scan of `count` readings: from the line itself, else from the parameters of the log,
/// else that of the usual scanners with that number of beams.
pub(crate) fn scan_geometry(
    kind: LaserKind,
    config: Option<&LaserConfig>,
    count: usize,
    survey: &Survey,
) -> ScanGeometry {
    match config {
        Some(config) => configured(config, count),
        None => {
            let side = if kind == LaserKind::Rear { "rear" } else { "front" };
            let declared_maximum = survey.number(&format!("robot_{side}_laser_max"));
            let maximum = declared_maximum.filter(|m| *m > 0.0).map_or(SICK_MAXIMUM, |m| m as f32);
            let range_max = if maximum < SICK_MAXIMUM { maximum.next_down() } else { SICK_MAXIMUM };
            let (start, increment) = declared(side, count, survey).unwrap_or_else(|| usual(count));
            ScanGeometry { start, increment, range_max }
        }
    }
}

fn configured(config: &LaserConfig, count: usize) -> ScanGeometry {
    let gaps = count.saturating_sub(1).max(1) as f64;
    let resolution = config.resolution;
    let fits = |gaps: f64| (resolution * gaps - config.field_of_view).abs() < 1.5 * resolution.abs();
    let increment = if resolution > 0.0 && (config.field_of_view <= 0.0 || fits(gaps)) {
        resolution
    } else if config.field_of_view > 0.0 {
        config.field_of_view / gaps
    } else {
        usual(count).1
    };
    let maximum = config.maximum_range as f32;
    let range_max = if maximum > MINIMUM_RANGE { maximum.next_down() } else { SICK_MAXIMUM };
    ScanGeometry { start: config.start_angle, increment, range_max }
}

/// `laser_front_laser_fov` and `…_resolution` (degrees), if both are given and fit the number of readings.
fn declared(side: &str, count: usize, survey: &Survey) -> Option<(f64, f64)> {
    let field_of_view = survey.number(&format!("laser_{side}_laser_fov"))?;
    let resolution = survey.number(&format!("laser_{side}_laser_resolution"))?;
    let beams = field_of_view / resolution;
    let fits = resolution > 0.0 && (beams - count as f64).abs() < 1.5;
    fits.then(|| (-field_of_view.to_radians() / 2.0, resolution.to_radians()))
}

/// Start angle and increment (radians) of the usual scanner with this number of beams.
fn usual(count: usize) -> (f64, f64) {
    let degrees =
        |field_of_view: f64, increment: f64| (-field_of_view.to_radians() / 2.0, increment.to_radians());
    match count {
        // SICK LMS with a field of view of 100°, at 1°, 0.5° and 0.25°.
        101 => degrees(100.0, 1.0),
        201 => degrees(100.0, 0.5),
        401 => degrees(100.0, 0.25),
        // Hokuyo with a field of view of 270°.
        541 => degrees(270.0, 0.5),
        1081 => degrees(270.0, 0.25),
        // Hokuyo URG with 1024 steps per revolution; the middle beam points straight ahead.
        682 | 683 => (-340.0 * PI / 512.0, PI / 512.0),
        726 => (-363.0 * PI / 512.0, PI / 512.0),
        769 => (-384.0 * PI / 512.0, PI / 512.0),
        // A field of view of 180° with a beam at both ends.
        count if count % 2 == 1 && count > 1 => (-PI / 2.0, PI / (count - 1) as f64),
        // A field of view of 180° without the last beam.
        count => (-PI / 2.0, PI / count.max(1) as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn old(count: usize) -> ScanGeometry {
        scan_geometry(LaserKind::Front, None, count, &Survey::default())
    }

    #[test]
    fn half_a_turn_with_and_without_the_last_beam() {
        for (count, step, end) in [(180, 1.0, 89.0), (181, 1.0, 90.0), (360, 0.5, 89.5), (361, 0.5, 90.0)] {
            let geometry = old(count);
            assert!((geometry.start + PI / 2.0).abs() < 1e-12);
            assert!((geometry.increment.to_degrees() - step).abs() < 1e-9);
            assert!((geometry.end(count).to_degrees() - end).abs() < 1e-9);
            assert_eq!(geometry.range_max, 80.0);
        }
        for count in [101, 201, 401] {
            assert!((old(count).end(count).to_degrees() - 50.0).abs() < 1e-9);
        }
    }

    #[test]
    fn parameters_change_the_limits() {
        let mut survey = Survey::default();
        survey.params.insert("robot_front_laser_max".into(), "50".into());
        survey.params.insert("laser_front_laser_fov".into(), "100".into());
        survey.params.insert("laser_front_laser_resolution".into(), "1.0".into());
        let geometry = scan_geometry(LaserKind::Front, None, 100, &survey);
        assert!(geometry.range_max < 50.0 && geometry.range_max > 49.99);
        assert!((geometry.start.to_degrees() + 50.0).abs() < 1e-9);
        assert_eq!(scan_geometry(LaserKind::Front, None, 181, &survey).increment, PI / 180.0);
    }

    #[test]
    fn the_newer_format_has_its_geometry() {
        let mut config =
            LaserConfig { start_angle: -1.0, field_of_view: 2.0, resolution: 0.1, maximum_range: 30.0 };
        let geometry = configured(&config, 21);
        assert_eq!((geometry.start, geometry.increment), (-1.0, 0.1));
        assert!(geometry.range_max < 30.0);
        config.resolution = 5.0;
        assert!((configured(&config, 21).increment - 0.1).abs() < 1e-12);
        config.field_of_view = f64::from(0);
        assert_eq!(configured(&LaserConfig { resolution: 0.0, ..config }, 0).increment, PI);
    }
}
