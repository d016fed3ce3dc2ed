//! Detects jitter of the stamps of a planar scanner from its motion between scans.
//!
//! Uneven intervals come from the stamps or from the scanner: a driver may take scans as irregularly as it
//! stamps them. A robot has inertia, so that its velocity is smoother at the right times than at wrong ones.

use portolan_geometry::nalgebra::Vector3;
use portolan_geometry::{Rigid2, Time};
use portolan_ingest::StampJitter;
use portolan_recording::StampPattern;

use crate::scan_motion::{PlacedScan, ScanMotions};

/// Jitter below which it is harmless, seconds: half a degree in a fast turn.
const LEAST: f64 = 0.005;
/// Distance that counts as much as one radian, metres.
const ARM: f64 = 1.0;
/// Speed below which motion is not used, m/s.
const LEAST_SPEED: f64 = 0.1;
/// Number of standard deviations above chance by which changes of velocity have to be smaller more often.
const SURE: f64 = 4.0;
/// Minimum number of changes of velocity.
const ENOUGH: f64 = 50.0;

/// The jitter of stamps and the corrected times, where those are certainly better.
pub(crate) fn stamp_jitter(stamps: &[Time], motions: &ScanMotions) -> Option<(StampJitter, Vec<Time>)> {
    let StampPattern { period, noise, .. } = StampPattern::of(stamps)?;
    if noise.of_stamps < LEAST {
        return None;
    }
    let jitter = StampJitter { period, noise };
    let times = jitter.times(stamps)?;
    is_more_even(&motions.scans, &times).then_some((jitter, times))
}

/// Whether the motion of the scanner is certainly smoother if scans were taken at these times, in the order
/// of the scans.
fn is_more_even(scans: &[PlacedScan], times: &[Time]) -> bool {
    let (mut smaller, mut larger) = (0.0, 0.0);
    for (scans, times) in scans.windows(3).zip(times.windows(3)) {
        let ([before, this, after], [t0, t1, t2]) = (scans, times) else { continue };
        let (Some(to), Some(on)) = (this.motion, after.motion) else { continue };
        let change = |t0: Time, t1: Time, t2: Time| {
            let (before, after) = (velocity(&to, t1.seconds_since(t0)), velocity(&on, t2.seconds_since(t1)));
            (after - before).norm()
        };
        let mean = velocity(&to, 1.0) + velocity(&on, 1.0);
        if mean.norm() < LEAST_SPEED * after.time.seconds_since(before.time) {
            continue;
        }
        let (as_stamped, steady) = (change(before.time, this.time, after.time), change(*t0, *t1, *t2));
        smaller += f64::from(u8::from(steady < as_stamped));
        larger += f64::from(u8::from(steady > as_stamped));
    }
    // Sign test: by chance half of the changes are smaller. Neighbouring changes share a motion, so that
    // half as many are independent.
    let count: f64 = smaller + larger;
    count >= ENOUGH && smaller - larger > SURE * (2.0 * count).sqrt()
}

fn velocity(motion: &Rigid2, seconds: f64) -> Vector3<f64> {
    let motion = Vector3::new(motion.translation.x, motion.translation.y, ARM * motion.normalized_angle());
    motion / seconds.max(f64::MIN_POSITIVE)
}
