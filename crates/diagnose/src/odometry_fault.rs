//! Detects odometry in other units or another frame than assumed: it rotates in the opposite direction, moves
//! a hundred times as far, or sideways.
//!
//! Over windows of a second, the motions of odometry, as complex numbers in the frame of the scanner, are
//! fitted to those of scans by one complex factor (least squares). The length of the factor gives the units,
//! its angle the direction in which the scanner is mounted. It is a fault only where the two agree well with
//! the factor and badly without.

use std::fmt;

use portolan_geometry::nalgebra::Complex;
use portolan_geometry::{Duration, Rigid2, Rigid3, TransformBuffer, project_2d};

use crate::rotation::{Agreement, ENOUGH_TURNS, Turn, compare};
use crate::scan_motion::TimedMotion;

/// Duration over which motions are compared, seconds.
const WINDOW: f64 = 1.0;
/// Minimum distance that the scanner moves in a window for the window to count, metres.
const LEAST_DISTANCE: f64 = 0.1;
/// Minimum number of windows for a result.
const ENOUGH_WINDOWS: usize = 30;
/// Fraction of windows that is used, those that fit best: scans are matched wrongly now and then, and wheels
/// slip.
const KEPT: f64 = 0.8;
/// Fraction of the motions (root mean square) that is left unexplained without a factor, above which they do
/// not agree.
const LEFT: f64 = 0.5;
/// Fraction that is left unexplained with the factor, below which the factor explains the difference.
const LEFT_OTHERWISE: f64 = 0.2;
/// Ratio of the distance of odometry to that of scans below which odometry stands still in a window. In
/// other units it may move as little, but then a factor explains it.
const OF_STANDING: f64 = 1e-4;
/// Fraction of windows at rest from which odometry stands still altogether.
const MOSTLY_STANDS: f64 = 0.95;
/// Correlation of rotations from which they agree except for a factor.
const ALIKE: f64 = 0.8;
/// Correlation of rotations below which they do not agree.
const UNLIKE: f64 = 0.5;
/// Range of factors that are a matter of calibration and no fault.
const CALIBRATION: std::ops::Range<f64> = 0.5..2.0;

/// Difference between the motions of odometry and those of scans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OdometryFault {
    /// Its rotations are this multiple of those of scans; negative if in the opposite direction.
    Turns(f64),
    /// Its translations have another length or direction.
    Translations {
        /// Ratio of their lengths to those of scans.
        factor: f64,
        /// Angle from the translations of scans to those of odometry, counter-clockwise (to the left),
        /// radians.
        angle: f64,
    },
    /// It stays where it is while scans move.
    Stands,
    /// Neither its rotations nor its translations agree with scans, and no factor makes them agree.
    Unlike,
}

impl OdometryFault {
    /// Compares rotations of odometry and scanner, and poses of odometry with motions of the scanner. Also
    /// takes the pose of the scanner in the frame of the odometry, and the delay of its stamps, seconds.
    pub(crate) fn find(
        (of_wheels, of_scans): (&[Turn], &[Turn]),
        (poses, motions): (&TransformBuffer, &[TimedMotion]),
        (odometry_from_scanner, lag): (&Rigid3, f64),
    ) -> Option<Self> {
        let windows = windows(poses, motions, odometry_from_scanner, lag);
        if stands(&windows) {
            return Some(Self::Stands);
        }
        let agreement = compare(of_wheels, of_scans).filter(|agreement| agreement.turned >= ENOUGH_TURNS);
        if let Some(Agreement { correlation, slope, .. }) = agreement
            && correlation.abs() > ALIKE
            && !CALIBRATION.contains(&(1.0 / slope))
        {
            // Odometry with wrong rotations has translations in wrong directions.
            return Some(Self::Turns(1.0 / slope));
        }
        let fit = Fit::of(windows.into_iter().map(|window| window.translations).collect())?;
        if fit.as_reported < LEFT {
            return None;
        }
        if fit.explained < LEFT_OTHERWISE {
            let odometry_from_scans = fit.factor.inv();
            return Some(Self::Translations {
                factor: odometry_from_scans.norm(),
                angle: odometry_from_scans.arg(),
            });
        }
        agreement.is_some_and(|agreement| agreement.correlation < UNLIKE).then_some(Self::Unlike)
    }

    /// Whether left and right are exchanged: the scanner is mounted upside down, or the odometry is
    /// mirrored.
    pub fn is_mirrored(&self) -> bool {
        matches!(self, Self::Turns(factor) if *factor < 0.0)
    }
}

impl fmt::Display for OdometryFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Turns(factor) if factor < 0.0 => {
                write!(f, "rotates opposite to scans, {:.2} times as much", -factor)
            }
            Self::Turns(factor) => write!(f, "rotates {factor:.2} times as much as scans"),
            Self::Translations { factor, angle } => {
                write!(f, "measures {factor:.2} times the distance of scans")?;
                let degrees = angle.to_degrees();
                let side = if degrees > 0.0 { "left" } else { "right" };
                match degrees.abs() < 5.0 {
                    true => Ok(()),
                    false => write!(f, ", {:.0}° to the {side} of them", degrees.abs()),
                }
            }
            Self::Stands => write!(f, "does not move while scans do"),
            Self::Unlike => write!(f, "moves differently than scans"),
        }
    }
}

/// Translations measured by scans and odometry, metres in the frame of the scanner.
type Pair = (Complex<f64>, Complex<f64>);

/// Motion in a window in which the scanner moved.
struct Window {
    translations: Pair,
    /// Distance that the frame of the odometry moved, metres. A scanner beside it also moves if that frame
    /// rotates.
    distance: f64,
}

fn windows(
    poses: &TransformBuffer,
    motions: &[TimedMotion],
    odometry_from_scanner: &Rigid3,
    lag: f64,
) -> Vec<Window> {
    let lag = Duration::from_seconds(lag);
    let scanner = |pose: &Rigid3| project_2d(&(pose * odometry_from_scanner));
    let (mut windows, mut window): (_, Option<TimedMotion>) = (Vec::new(), None);
    for (begin, end, motion) in motions {
        let joined =
            window.filter(|(_, until, _)| until == begin).map(|(from, _, so_far)| (from, so_far * *motion));
        let (from, moved) = joined.unwrap_or((*begin, *motion));
        window = Some((from, *end, moved));
        if end.seconds_since(from) < WINDOW {
            continue;
        }
        window = None;
        if moved.translation.norm() >= LEAST_DISTANCE
            && let (Some(first), Some(second)) = (poses.lookup(from - lag), poses.lookup(*end - lag))
        {
            let distance = (second.translation.vector - first.translation.vector).norm();
            let (first, second) = (scanner(&first), scanner(&second));
            let translation = |motion: Rigid2| Complex::new(motion.translation.x, motion.translation.y);
            windows.push(Window {
                translations: (translation(moved), translation(first.inverse() * second)),
                distance,
            });
        }
    }
    windows
}

/// Whether odometry does not move in nearly all windows in which the scanner moves.
fn stands(windows: &[Window]) -> bool {
    let standing =
        windows.iter().filter(|window| window.distance < OF_STANDING * window.translations.0.norm()).count();
    windows.len() >= ENOUGH_WINDOWS && standing as f64 >= MOSTLY_STANDS * windows.len() as f64
}

/// Fit of the translations of odometry to those of scans.
struct Fit {
    /// Factor for the translations of odometry.
    factor: Complex<f64>,
    /// Fraction of the translations of scans that is left unexplained without the factor (root mean square).
    as_reported: f64,
    /// The same with the factor.
    explained: f64,
}

impl Fit {
    fn of(mut pairs: Vec<Pair>) -> Option<Self> {
        if pairs.len() < ENOUGH_WINDOWS {
            return None;
        }
        // Jumps of the odometry would dominate a mean.
        let mut factors: Vec<Complex<f64>> =
            pairs.iter().filter(|p| p.1.norm() > 0.0).map(|p| p.0 / p.1).collect();
        let median = Complex::new(median(&mut factors, |c| c.re)?, median(&mut factors, |c| c.im)?);
        let left = |(scans, wheels): &Pair, factor: Complex<f64>| (scans - factor * wheels).norm_sqr();
        pairs.sort_by(|a, b| left(a, median).total_cmp(&left(b, median)));
        pairs.truncate((KEPT * pairs.len() as f64) as usize);
        let common: Complex<f64> = pairs.iter().map(|(scans, wheels)| scans * wheels.conj()).sum();
        let of_wheels: f64 = pairs.iter().map(|pair| pair.1.norm_sqr()).sum();
        let of_scans: f64 = pairs.iter().map(|pair| pair.0.norm_sqr()).sum();
        if of_wheels <= 0.0 || of_scans <= 0.0 || common.norm() <= 0.0 {
            return None;
        }
        let factor = common / of_wheels;
        let share = |factor| (pairs.iter().map(|pair| left(pair, factor)).sum::<f64>() / of_scans).sqrt();
        Some(Self { factor, as_reported: share(Complex::new(1.0, 0.0)), explained: share(factor) })
    }
}

fn median(factors: &mut [Complex<f64>], of: impl Fn(&Complex<f64>) -> f64) -> Option<f64> {
    factors.sort_by(|a, b| of(a).total_cmp(&of(b)));
    factors.get(factors.len() / 2).map(of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, embed_3d};

    /// Scans and odometry of a drive with bends, in which odometry reports each step as `measured`.
    fn fault(measured: impl Fn(Rigid2) -> Rigid2) -> Option<OdometryFault> {
        let at = |i: i32| Time::from_ticks(i64::from(i) * 2_000_000);
        let (mut of_wheels, mut of_scans, mut poses) = (Vec::new(), Vec::new(), TransformBuffer::default());
        let (mut motions, mut pose) = (Vec::new(), Rigid2::identity());
        poses.push(at(0), embed_3d(&pose));
        for i in 0..600 {
            let step = Rigid2::new(0.08, 0.0, 0.15 * (0.07 * f64::from(i)).sin());
            let of_odometry = measured(step);
            pose = pose * of_odometry;
            poses.push(at(i + 1), embed_3d(&pose));
            of_wheels.push((at(i), at(i + 1), of_odometry.normalized_angle()));
            of_scans.push((at(i), at(i + 1), step.angle));
            motions.push((at(i), at(i + 1), step));
        }
        OdometryFault::find((&of_wheels, &of_scans), (&poses, &motions), (&Rigid3::identity(), 0.0))
    }

    #[test]
    fn odometry_that_never_moves_is_reported_and_wheels_that_stall_for_a_while_are_not() {
        assert_eq!(fault(|_| Rigid2::identity()), Some(OdometryFault::Stands));
        assert_eq!(fault(|m| Rigid2::new(0.0, 0.0, m.angle)), Some(OdometryFault::Stands));
        let steps = std::cell::Cell::new(0);
        let stalls = |m| {
            steps.set(steps.get() + 1);
            if steps.get() % 3 == 0 || steps.get() > 400 { Rigid2::identity() } else { m }
        };
        assert_ne!(fault(stalls), Some(OdometryFault::Stands));
    }

    #[test]
    fn other_units_and_frames_are_reported_and_calibration_errors_are_not() {
        let turned =
            |m: Rigid2, angle: f64| Rigid2::new(0.0, 0.0, angle).inverse() * m * Rigid2::new(0.0, 0.0, angle);
        let scaled = |m: Rigid2, factor: f64| Rigid2 { translation: m.translation * factor, ..m };
        assert_eq!(fault(|m| m), None);
        assert_eq!(fault(|m| scaled(m, 1.2)), None);
        assert_eq!(fault(|m| turned(m, 0.17)), None);
        assert_eq!(fault(|m| Rigid2 { angle: 0.8 * m.angle, ..m }), None);
        let close = |a: f64, b: f64| (a / b - 1.0).abs() < 0.05;
        let is_scale = |f| matches!(f, Some(OdometryFault::Translations { factor, angle }) if close(factor, 100.0) && angle.abs() < 0.05);
        assert!(is_scale(fault(|m| scaled(m, 100.0))));
        let is_turned = |f| matches!(f, Some(OdometryFault::Translations { factor, angle }) if close(factor, 1.0) && close(angle, -1.57));
        assert!(is_turned(fault(|m| turned(m, 1.57))), "{:?}", fault(|m| turned(m, 1.57)));
        let mirrored = fault(|m| Rigid2::new(m.translation.x, -m.translation.y, -m.angle)).unwrap();
        assert!(
            mirrored.is_mirrored() && matches!(mirrored, OdometryFault::Turns(f) if close(f, -1.0)),
            "{mirrored}"
        );
        let steps = std::cell::Cell::new(0.0_f64);
        let of_another_robot = |_| {
            steps.set(steps.get() + 1.0);
            Rigid2::new(0.2 * (0.023 * steps.get()).sin(), 0.0, 0.3 * (0.11 * steps.get()).cos())
        };
        assert_eq!(fault(of_another_robot), Some(OdometryFault::Unlike));
    }
}
