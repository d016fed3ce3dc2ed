//! Estimates which part of the motion of a lidar is still in its clouds, and at which time of a turn each
//! azimuth was measured.
//!
//! A lidar moves while it turns, so each point of a raw cloud is displaced by the motion between its own time
//! and the middle of the turn. Drivers and authors of data sets may have de-skewed the clouds already, and a
//! cloud does not say so. Nor does it say at which azimuth the turn began and in which direction the head
//! turned, since many drivers write the points in another order. All of that becomes observable as soon as
//! the lidar moves: a few sweeps later the same surface is seen under another azimuth, where the displacement
//! differs, so that sweeps do not fit rigidly.
//!
//! A few sweeps are registered, point to plane, to those some sweeps before (`follow`). Each residual depends
//! linearly on the times of the two azimuths, in units of the motion of one turn, which is estimated with the
//! poses. So the times of all azimuths, and the *skew factors* of translation and of rotation (1: all motion
//! is in the points, 0: none), follow from linear least squares with the poses eliminated (`evidence`). As
//! nearest points are paired anew when points move, one such step finds only a third of the correction. The
//! factor is therefore where the step vanishes, on the line through the steps at 0 and at 1. Its standard
//! deviation is that of sums over directions taken as independent. The state that the factors imply is
//! accepted unless sweeps fit clearly better with another one (`fit`). Where every other cloud is missing, a
//! turn takes half of the interval between clouds, and half of the motion in that interval is in the points
//! (`hypotheses`).

mod beams;
mod evidence;
mod fit;
mod follow;
mod hypotheses;
mod target;
#[cfg(test)]
mod tests;
mod times;

use std::f32::consts::{PI, TAU};

use portolan_geometry::{Point3f, Time, Vector2};

use crate::azimuth_time::Turn;
use crate::beam_elevation::ElevationOffset;
use evidence::{Clock, Pair, Phases, Step, TurnTimes};
use follow::{Followed, Sample};
pub(crate) use hypotheses::Times;
#[cfg(test)]
use times::RightTimes;

/// Number of sweeps in a batch, which are evaluated together.
const SWEEPS_OF_A_BATCH: usize = 16;
/// Maximum number of batches with motion that are evaluated.
const MAX_BATCHES: usize = 5;
/// Standard deviation of a factor below which it counts as known.
const SURE: f64 = 0.12;
/// Distance of a factor from 0 or 1 up to which it counts as 0 or 1.
const NEAR: f64 = 0.35;
/// Standard deviation below which a factor between 0 and 1 counts as known. It is smaller than [`SURE`], as
/// clouds that were de-skewed in part are rare.
const SURE_OF_PART: f64 = 0.05;
/// Factor by which formal standard deviations are enlarged: directions are not quite independent, and the
/// factors of real and simulated recordings scatter this much more.
const INFLATION: f64 = 1.5;
/// Maximum number of searches for a better seam, the azimuth at which turns begin.
const SEAM_ROUNDS: usize = 2;

/// Estimate of the motion that is still in the clouds.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Skew {
    /// Skew factor of the translation.
    pub translation: SkewFactor,
    /// Skew factor of the rotation.
    pub rotation: SkewFactor,
    /// Azimuth at which turns begin, in the frame of the lidar, radians from −π to π. Without meaning if points have
    /// times.
    pub begin_radians: f32,
    /// Whether the head turns clockwise, seen from above. Without meaning if points have times.
    pub is_clockwise: bool,
    /// Duration of a turn, in intervals between clouds: 1, or less where clouds are missing regularly.
    /// Factors are in units of the motion during a turn.
    pub turn_in_intervals: f64,
    /// Whether sweeps fit better with another motion in their points than the one that the factors imply.
    pub is_contradicted: bool,
    /// Offset of the elevations of all beams, once it is known which part of the motion is in the points.
    pub elevation: Option<ElevationOffset>,
}

/// Part of a motion that is in the points: 1 for the motion of the whole turn, 0 if the cloud was de-skewed.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SkewFactor {
    /// The factor.
    pub factor: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Largest likely factor over all turns (begin and direction).
    pub at_most: f64,
}

/// Conclusion from a [`Skew`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkewState {
    /// Points are as measured, displaced by the motion of the lidar during the sweep.
    Raw,
    /// Points are de-skewed: as if measured from one pose.
    Removed,
    /// Part of the motion is in the points.
    Partial,
    /// There was too little motion, or there were too few surfaces.
    Unknown,
}

impl SkewFactor {
    /// State that the factor implies. `turn_in_intervals`: duration of a turn in intervals between clouds.
    fn state(&self, turn_in_intervals: f64) -> SkewState {
        if self.sigma.is_nan() || self.sigma * turn_in_intervals > SURE {
            SkewState::Unknown
        } else if self.factor.abs() <= NEAR && self.at_most < 1.0 - NEAR {
            SkewState::Removed
        } else if (self.factor - 1.0).abs() <= NEAR {
            SkewState::Raw
        } else if self.sigma < SURE_OF_PART {
            SkewState::Partial
        } else {
            SkewState::Unknown
        }
    }

    /// The same factor in units of the motion during the fraction `part` of its present unit.
    fn of_part(self, part: f64) -> Self {
        // With a negative part, where time runs backwards, there is no upper bound.
        let at_most = if part > 0.0 { self.at_most / part } else { f64::INFINITY };
        Self { factor: self.factor / part, sigma: self.sigma / part.abs(), at_most }
    }
}

impl Skew {
    /// State that both factors imply.
    pub fn state(&self) -> SkewState {
        if self.is_contradicted {
            return SkewState::Unknown;
        }
        let state = |factor: SkewFactor| factor.state(self.turn_in_intervals);
        match (state(self.translation), state(self.rotation)) {
            (SkewState::Unknown, _) | (_, SkewState::Unknown) => state(self.combined()),
            (translation, rotation) if translation == rotation => translation,
            _ => SkewState::Partial,
        }
    }

    /// One factor for the whole motion: the mean, weighted by the information of the two.
    fn combined(&self) -> SkewFactor {
        let (a, b) = (self.translation, self.rotation);
        let weight = |part: &SkewFactor| if part.sigma.is_finite() { part.sigma.powi(-2) } else { 0.0 };
        let (of_a, of_b) = (weight(&a), weight(&b));
        // A factor without information may have any value and is left out.
        let mean = |a: f64, b: f64| {
            if of_b == 0.0 {
                a
            } else if of_a == 0.0 {
                b
            } else {
                (of_a * a + of_b * b) / (of_a + of_b)
            }
        };
        SkewFactor {
            factor: mean(a.factor, b.factor),
            sigma: (of_a + of_b).sqrt().recip(),
            at_most: mean(a.at_most, b.at_most),
        }
    }

    /// The same factors in units of the motion during the fraction `part` of their present unit.
    pub(crate) fn of_part(self, part: f64) -> Self {
        let (translation, rotation) = (self.translation.of_part(part), self.rotation.of_part(part));
        Self { translation, rotation, ..self }
    }

    /// Whether more of the motion is in the points than was taken out.
    pub(crate) fn is_mostly_raw(&self) -> bool {
        self.combined().factor > 0.5
    }

    /// Whether the begin and the direction of turns are known: only raw clouds determine them.
    pub(crate) fn is_turn_known(&self) -> bool {
        matches!(self.state(), SkewState::Raw | SkewState::Partial)
    }

    /// How the lidar turns: begin, direction and duration.
    pub(crate) fn turn(&self) -> Turn {
        let Self { begin_radians, is_clockwise, turn_in_intervals, .. } = *self;
        Turn { begin_radians, is_clockwise, in_intervals: turn_in_intervals }
    }
}

/// Collects sweeps until they determine the skew.
#[derive(Clone, Debug, Default)]
pub(crate) struct SkewEstimator {
    pending: Vec<Sample>,
    batches: Vec<Batch>,
    has_times: bool,
    /// Seconds between the last two sweeps.
    interval: f64,
    last: Option<Time>,
    /// Edge of the voxels that thin sweeps, metres; follows from the sweeps before.
    edge: f32,
    /// Whether the lidar stood still during some batch.
    stood: bool,
    skew: Option<Skew>,
    /// Whether recorded times gave the state `Removed`, but times by azimuth leave the state unknown.
    is_open: bool,
}

/// Consecutive sweeps, registered as they came.
#[derive(Clone, Debug)]
struct Batch {
    samples: Vec<Sample>,
    as_is: Followed,
}

impl SkewEstimator {
    /// Adds the points of the next sweep, in the frame of the lidar, metres. `shares` are the times of the
    /// points as fractions of the sweep (0 to 1), if known. Sweeps must be consecutive.
    pub fn add(&mut self, stamp: Time, points: &[Point3f], shares: Option<&[f32]>) {
        if self.is_done() {
            return;
        }
        self.interval = self.last.replace(stamp).map_or(0.0, |last| stamp.seconds_since(last));
        self.has_times = shares.is_some();
        let phases = |(i, p): (usize, &Point3f)| Phases {
            azimuth: (p.y.atan2(p.x) + PI) / TAU,
            recorded: shares.and_then(|shares| shares.get(i).copied()).unwrap_or(0.5),
        };
        let phases: Vec<Phases> = points.iter().enumerate().map(phases).collect();
        self.pending.push(Sample::thinned(points, &phases, &mut self.edge));
        if self.pending.len() == SWEEPS_OF_A_BATCH {
            self.judge();
        }
    }

    /// Whether more sweeps would add no information.
    pub fn is_done(&self) -> bool {
        let is_open = |offset: ElevationOffset| !offset.is_clear() && offset.may_be_there();
        let is_known = |skew: Skew| {
            skew.state() != SkewState::Unknown && !self.is_open && !skew.elevation.is_some_and(is_open)
        };
        self.batches.len() >= MAX_BATCHES || self.skew.is_some_and(is_known)
    }

    /// Whether the lidar stood still in all batches so far.
    pub fn only_stood(&self) -> bool {
        self.stood && self.batches.is_empty()
    }

    /// Current estimate; none as long as nothing moved.
    pub fn skew(&self) -> Option<Skew> {
        self.skew
    }

    fn judge(&mut self) {
        let samples = std::mem::take(&mut self.pending);
        if follow::stands(&samples) {
            self.stood = true;
            return;
        }
        let Some(as_is) = follow::follow(&samples, None, None) else { return };
        self.batches.push(Batch { samples, as_is });
        if let Some((skew, is_open)) = self.estimate() {
            (self.skew, self.is_open) = (Some(skew), is_open);
        }
    }

    /// Current estimate, and whether times by azimuth leave the state unknown.
    fn estimate(&self) -> Option<(Skew, bool)> {
        let Judged { mut skew, times, deskewed } = match self.has_times {
            true => self.judged(TurnTimes::RECORDED)?,
            false => self.judged_by_azimuth()?,
        };
        // With recorded times the points look de-skewed. That may also be because the times are wrong, those
        // of other points.
        let may_be_raw = self.has_times && skew.state() == SkewState::Removed;
        let by_azimuth = if may_be_raw { self.other_state_by_azimuth() } else { None };
        skew.is_contradicted = matches!(by_azimuth, Some(SkewState::Raw | SkewState::Partial))
            || self.is_contradicted(skew.state(), &deskewed);
        skew.elevation = match skew.state() {
            SkewState::Raw => beams::elevation(&self.batches, &deskewed, Some(times)),
            SkewState::Removed => beams::elevation(&self.batches, &self.as_is(), None),
            SkewState::Partial | SkewState::Unknown => None,
        };
        Some((skew, by_azimuth == Some(SkewState::Unknown)))
    }
}

/// Skew estimated with given times of the points, and the sweeps de-skewed with these times.
struct Judged {
    skew: Skew,
    times: TurnTimes,
    deskewed: Vec<Followed>,
}

impl SkewEstimator {
    fn judged(&self, times: TurnTimes) -> Option<Judged> {
        let as_is = self.pairs_as_is();
        let deskewed = self.deskewed(times)?;
        let (at_none, at_all) = (evidence::step(&as_is, times)?, evidence::step(&pairs(&deskewed), times)?);
        let largest = match times.clock {
            Clock::Recorded => at_none.factors + at_none.sigmas * evidence::LIKELY,
            Clock::Azimuth => evidence::largest_steps(&as_is, at_none, times)?,
        };
        Some(Judged { skew: skew(at_none, at_all, largest, times), times, deskewed })
    }

    /// The same with times by azimuth, for the most likely turn.
    fn judged_by_azimuth(&self) -> Option<Judged> {
        let mut judged = self.judged(evidence::most_likely_turn(&self.pairs_as_is())?)?;
        for _ in 0..SEAM_ROUNDS {
            let Some(better) = evidence::better_turn(&pairs(&judged.deskewed), judged.times) else {
                break;
            };
            judged = self.judged(better)?;
        }
        if let Some((times, deskewed)) = self.shorter_turn(&judged) {
            let skew = Skew { turn_in_intervals: times.part, ..judged.skew.of_part(times.part) };
            judged = Judged { skew, times, deskewed };
        }
        Some(judged)
    }

    fn pairs_as_is(&self) -> Vec<&Pair> {
        self.batches.iter().flat_map(|batch| &batch.as_is.pairs).collect()
    }

    /// Whether sweeps that are estimated to be raw fit better as they came, or sweeps that are estimated to
    /// be de-skewed fit better with motion taken out.
    fn is_contradicted(&self, state: SkewState, deskewed: &[Followed]) -> bool {
        let fits_worse_as_is = |deskewed: &[Followed]| fit::is_better(&self.as_is(), deskewed);
        match state {
            SkewState::Raw => {
                fit::is_better(deskewed, &self.as_is())
                    || (self.has_times && self.turns_begin_elsewhere(deskewed))
            }
            SkewState::Removed => {
                (self.has_times && fits_worse_as_is(deskewed))
                    || fit::usual_turns()
                        .filter_map(|turn| self.deskewed(turn))
                        .any(|deskewed| fits_worse_as_is(&deskewed))
            }
            SkewState::Partial | SkewState::Unknown => false,
        }
    }

    /// The same turn in a part of the interval between clouds, with the sweeps de-skewed accordingly, if the
    /// factors suggest it and sweeps then fit clearly better.
    fn shorter_turn(&self, judged: &Judged) -> Option<(TurnTimes, Vec<Followed>)> {
        let one_in = hypotheses::one_cloud_in(&judged.skew, self.interval);
        let times = TurnTimes { part: one_in?.recip(), ..judged.times };
        let shorter = self.deskewed(times)?;
        fit::is_better(&judged.deskewed, &shorter).then_some((times, shorter))
    }

    /// All sweeps de-skewed with these times; none if they cannot be registered then.
    fn deskewed(&self, times: TurnTimes) -> Option<Vec<Followed>> {
        self.batches.iter().map(|batch| batch.deskewed(times)).collect()
    }

    fn as_is(&self) -> Vec<Followed> {
        self.batches.iter().map(|batch| batch.as_is.clone()).collect()
    }
}

fn pairs(followed: &[Followed]) -> Vec<&Pair> {
    followed.iter().flat_map(|followed| &followed.pairs).collect()
}

impl Batch {
    fn deskewed(&self, times: TurnTimes) -> Option<Followed> {
        follow::follow(&self.samples, Some(times), Some(&self.as_is))
    }
}

/// Zero of the steps on the line through those at factors 0 and 1. `largest` is the largest likely step at 0.
fn skew(at_none: Step, at_all: Step, largest: Vector2, times: TurnTimes) -> Skew {
    let part = |part: fn(Vector2) -> f64| {
        let (none, all) = (part(at_none.factors), part(at_all.factors));
        let (of_none, of_all) = (INFLATION * part(at_none.sigmas), INFLATION * part(at_all.sigmas));
        let largest = part(largest);
        let slope = none - all;
        let factor = none / slope;
        // Both steps are uncertain, and each shifts the zero in proportion to its weight.
        let sigma = ((1.0 - factor) * of_none).hypot(factor * of_all) / slope.abs();
        let is_observable = slope > 2.0 * of_none.hypot(of_all);
        SkewFactor {
            factor,
            sigma: if is_observable { sigma } else { f64::INFINITY },
            at_most: largest / slope,
        }
    };
    Skew {
        translation: part(|both| both.x),
        rotation: part(|both| both.y),
        begin_radians: times.begin * TAU - PI,
        is_clockwise: times.sense < 0.0,
        turn_in_intervals: 1.0,
        is_contradicted: false,
        elevation: None,
    }
}
