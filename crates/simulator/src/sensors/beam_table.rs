//! Directions of the beams of a lidar, and the times at which they are fired.

use std::str::FromStr;

use crate::SimulatorError;

/// Scan pattern of a lidar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ScanPattern {
    /// One revolution about z per sweep: every sweep has the same pattern.
    Spinning,
    /// Two wedge prisms that rotate at different rates (Hz) deflect the beams from x, each by `deflection`
    /// radians: a rosette within a cone, with another pattern in every sweep (as in forward-looking lidars
    /// of Livox).
    Rosette { deflection: f64, rates: [f64; 2] },
    /// Beams go up and down between two elevations (radians) `waves` times per second while the head
    /// revolves at another rate, Hz: another pattern in every sweep (as in the Mid-360 of Livox).
    Wave { elevations: [f64; 2], waves: f64, revolutions: f64 },
}

impl ScanPattern {
    /// Azimuth (positive in the direction in which the head spins) and elevation of the axis of the beams,
    /// radians, at the fraction `share` of a sweep, `seconds` after the start of the first sweep.
    pub(crate) fn axis(self, share: f64, seconds: f64) -> [f64; 2] {
        let tau = std::f64::consts::TAU;
        match self {
            Self::Spinning => [tau * share, 0.0],
            Self::Rosette { deflection, rates } => {
                let [first, second] = rates.map(|rate| libm::sincos(tau * (rate * seconds).fract()));
                [deflection * (first.1 + second.1), deflection * (first.0 + second.0)]
            }
            Self::Wave { elevations: [low, high], waves, revolutions } => {
                let wave = (waves * seconds).fract();
                let up = 1.0 - (2.0 * wave - 1.0).abs();
                [tau * (revolutions * seconds).fract(), low + up * (high - low)]
            }
        }
    }
}

/// The beams of one firing of a lidar, and its scan pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamTable {
    /// Name of the model, for messages.
    pub name: String,
    /// Scan pattern.
    pub pattern: ScanPattern,
    /// Angle above the plane of rotation of each beam, radians.
    pub elevations: Vec<f64>,
    /// Angle ahead of the head's azimuth of each beam, radians; one per beam.
    pub azimuth_offsets: Vec<f64>,
    /// Delay of each beam from the start of its firing, seconds; one per beam.
    pub delays: Vec<f64>,
    /// Number of firings per revolution, or per sweep of a lidar that does not revolve once in it.
    pub columns: usize,
    /// Maximum range, metres.
    pub range_max: f64,
}

impl BeamTable {
    /// Names of the models that are known.
    pub const NAMES: [&str; 9] =
        ["vlp16", "vlp32", "hdl64", "os1-16", "os1-64", "os0-128", "xt32", "avia", "mid360"];

    /// Beams from the lowest to the highest elevation (degrees) at equal angles.
    pub fn even(name: &str, low: f64, high: f64, beams: usize, columns: usize, range_max: f64) -> Self {
        let step = if beams > 1 { (high - low) / (beams - 1) as f64 } else { 0.0 };
        let elevations = (0..beams).map(|i| (low + step * i as f64).to_radians()).collect();
        let zeros = vec![0.0; beams];
        let name = name.to_owned();
        let pattern = ScanPattern::Spinning;
        Self { name, pattern, elevations, azimuth_offsets: zeros.clone(), delays: zeros, columns, range_max }
    }

    /// 16 beams of ±15°, fired 2.304 µs apart (Velodyne, VLP-16 user manual); 1875 firings per revolution
    /// are 300,000 points per second at 10 revolutions.
    pub fn vlp16() -> Self {
        Self { delays: delays(16, 2.304e-6), ..Self::even("vlp16", -15.0, 15.0, 16, 1875, 100.0) }
    }

    /// A known model.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "vlp16" => Self::vlp16(),
            "vlp32" => vlp32(),
            // 64 beams in two blocks; the lower ones are twice as far apart.
            "hdl64" => {
                let upper = (0..32).map(|i| (2.0 - f64::from(i) / 3.0).to_radians());
                let lower = (0..32).map(|i| (-8.83 - f64::from(i) * 0.5).to_radians());
                let elevations: Vec<f64> = upper.chain(lower).collect();
                let even = Self::even("hdl64", 0.0, 0.0, 64, 2083, 120.0);
                Self { elevations, delays: delays(64, 0.6e-6), ..even }
            }
            "os1-16" => ouster(name, 16.6, 16, 120.0),
            "os1-64" => ouster(name, 22.5, 64, 120.0),
            "os0-128" => ouster(name, 45.0, 128, 50.0),
            "xt32" => Self { delays: delays(32, 1.5e-6), ..Self::even(name, -16.0, 15.0, 32, 2000, 120.0) },
            // 240,000 points per second within 77°, from prisms like those of the Mid-40, 7294 and -4664
            // rotations per minute.
            "avia" => {
                let deflection = 19.3_f64.to_radians();
                let pattern = ScanPattern::Rosette { deflection, rates: [7294.0 / 60.0, -4664.0 / 60.0] };
                Self { pattern, ..Self::even(name, -0.8, 0.8, 6, 4000, 190.0) }
            }
            // 200,000 points per second from -7° to 52° all around. Only the field of view and the number
            // of points are those of the device; the rates are chosen so that sweeps do not repeat.
            "mid360" => {
                let elevations = [-6.5_f64, 51.5].map(f64::to_radians);
                let pattern = ScanPattern::Wave { elevations, waves: 187.3, revolutions: 10.7 };
                Self { pattern, ..Self::even(name, -0.5, 0.5, 4, 5000, 70.0) }
            }
            _ => return None,
        })
    }

    /// Whether its lists have the same length, and its values are sensible.
    pub(crate) fn is_sensible(&self) -> bool {
        let beams = self.elevations.len();
        let is_list = |list: &[f64], bound: f64| {
            list.len() == beams && list.iter().all(|v| v.is_finite() && v.abs() <= bound)
        };
        (1..=1024).contains(&beams)
            && is_list(&self.elevations, std::f64::consts::FRAC_PI_2)
            && is_list(&self.azimuth_offsets, 7.0)
            && is_list(&self.delays, 0.1)
            && (8..=100_000).contains(&self.columns)
            && beams * self.columns <= 4_000_000
    }
}

/// Delays of beams that are fired one after the other, seconds.
fn delays(beams: usize, step: f64) -> Vec<f64> {
    (0..beams).map(|i| step * i as f64).collect()
}

/// Beams that are denser in the middle, in pairs, with staggered azimuths.
fn vlp32() -> BeamTable {
    let degrees = [
        -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333,
        1.333, 0.667, -4.0, -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0, 7.0, 4.667,
        -2.333, -2.0, 15.0, 10.333, -1.333,
    ];
    let offsets = [1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4];
    BeamTable {
        elevations: degrees.iter().map(|d: &f64| d.to_radians()).collect(),
        azimuth_offsets: (0..32).map(|i| f64::to_radians(offsets[i % 8])).collect(),
        delays: (0..32).map(|i| 2.304e-6 * (i / 2) as f64).collect(),
        ..BeamTable::even("vlp32", 0.0, 0.0, 32, 1800, 200.0)
    }
}

/// Ouster: all beams of a column at once, four staggered azimuths, 1024 columns.
fn ouster(name: &str, half_angle: f64, beams: usize, range_max: f64) -> BeamTable {
    let mut table = BeamTable::even(name, half_angle, -half_angle, beams, 1024, range_max);
    let offsets = [3.1_f64, 1.0, -1.0, -3.1];
    table.azimuth_offsets = (0..beams).map(|i| offsets[i % 4].to_radians()).collect();
    table
}

impl FromStr for BeamTable {
    type Err = SimulatorError;

    /// A model by its name; or `LOW:HIGH:BEAMS[:COLUMNS[:RANGE]]`; or the elevation of each beam, separated by commas
    /// (`-15,-7,-3,0,3[:COLUMNS[:RANGE]]`). Angles are in degrees.
    fn from_str(text: &str) -> Result<Self, SimulatorError> {
        if let Some(table) = Self::named(text) {
            return Ok(table);
        }
        let bad = || SimulatorError::BadNames {
            detail: format!(
                "\"{text}\" is no lidar; choose one of {} or write LOW:HIGH:BEAMS[:COLUMNS[:RANGE]] with angles \
                 in degrees, as -15:15:16:1800:100, or the angle of each beam, as -15,-7,-3,0,3:1800:100",
                Self::NAMES.join(", ")
            ),
        };
        let number = |part: &str| part.trim().parse::<f64>().ok().filter(|v| v.is_finite());
        let numbers =
            |text: &str, separator| -> Option<Vec<f64>> { text.split(separator).map(number).collect() };
        let (first, behind) = text.split_once(':').map_or((text, None), |(first, rest)| (first, Some(rest)));
        if first.contains(',') {
            let elevations = numbers(first, ',').ok_or_else(bad)?;
            let rest = behind.map_or_else(|| Some(Vec::new()), |rest| numbers(rest, ':')).ok_or_else(bad)?;
            return Self::own(&elevations, &rest).ok_or_else(bad);
        }
        let parts = numbers(text, ':').ok_or_else(bad)?;
        let [low, high, beams, rest @ ..] = parts.as_slice() else { return Err(bad()) };
        if !is_count(*beams, 1024.0) {
            return Err(bad());
        }
        let step = if *beams > 1.0 { (high - low) / (beams - 1.0) } else { 0.0 };
        let elevations: Vec<f64> = (0..*beams as usize).map(|i| low + step * i as f64).collect();
        Self::own(&elevations, rest).ok_or_else(bad)
    }
}

fn is_count(value: f64, most: f64) -> bool {
    value >= 1.0 && value <= most && value.fract() == 0.0
}

impl BeamTable {
    /// Beams at these elevations, degrees; `rest` may have the firings of a revolution and the range, metres.
    fn own(elevations: &[f64], rest: &[f64]) -> Option<Self> {
        let columns = rest.first().copied().unwrap_or(1800.0);
        let range = rest.get(1).copied().unwrap_or(100.0);
        if rest.len() > 2 || !is_count(columns, 1e5) || !(0.5..=1000.0).contains(&range) {
            return None;
        }
        let even = Self::even("own", 0.0, 0.0, elevations.len(), columns as usize, range);
        let elevations = elevations.iter().map(|degrees| degrees.to_radians()).collect();
        Some(Self { elevations, ..even }).filter(Self::is_sensible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_sensible_and_texts_are_read() {
        for name in BeamTable::NAMES {
            let table: BeamTable = name.parse().unwrap();
            assert!(table.is_sensible() && table.name == name, "{name}");
        }
        let own: BeamTable = "-30:10:5:900:40".parse().unwrap();
        assert_eq!((own.elevations.len(), own.columns, own.range_max), (5, 900, 40.0));
        assert!((own.elevations[1].to_degrees() + 20.0).abs() < 1e-12);
        let listed: BeamTable = "-25,-3.5,0,3:600:80".parse().unwrap();
        assert_eq!((listed.elevations.len(), listed.columns, listed.range_max), (4, 600, 80.0));
        assert!((listed.elevations[1].to_degrees() + 3.5).abs() < 1e-12);
        for wrong in [
            "-95,0",
            "1,x",
            "1,2:0",
            ",",
            "",
            "vlp17",
            "1:2",
            "-15:15:0",
            "-15:15:2.5",
            "-95:15:16",
            "-15:15:16:1800:100:7",
        ] {
            assert!(wrong.parse::<BeamTable>().unwrap_err().to_string().contains("vlp16"), "{wrong}");
        }
    }
}
