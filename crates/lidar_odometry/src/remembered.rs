//! Registration results of sweeps as they are remembered, so that an interrupted job can continue from
//! them.

use portolan_motion::DegenerateDirections;
use portolan_recall::{Answer, Fingerprint, Sink, Words};

use crate::predict::Reason;
use crate::registration::RegistrationResult;
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::sweep::Sweep;

/// Number of points of a sweep that identify it; using all of them would take as long as parts of the
/// registration.
const FINGERPRINT_POINTS: usize = 256;

/// Result of a sweep.
pub(crate) struct Finding {
    /// Number of sampled points.
    pub sampled: u64,
    /// The hypothesis that fits best; none for the first.
    pub reason: Option<Reason>,
    /// Its registration; none if it does not fit.
    pub found: Option<RegistrationResult>,
}

/// Adds the inputs of a registration, besides earlier sweeps, to the fingerprint.
pub(crate) fn ask(question: &mut Fingerprint, sweep: &Sweep, segment: &TrajectorySegment) {
    question.add((sweep.end, sweep.points.len() as u64));
    question.add([segment.start(), segment.end()]);
    let stride = (sweep.points.len() / FINGERPRINT_POINTS).max(1);
    let sampled = sweep.points.iter().step_by(stride);
    question.add_f32s(sampled.flat_map(|p| [p.time, p.position.x, p.position.y, p.position.z]));
}

impl Answer for Finding {
    fn write(&self, words: &mut impl Sink) {
        self.sampled.write(words);
        self.reason.write(words);
        self.found.write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        Some(Self {
            sampled: Answer::read(words)?,
            reason: Answer::read(words)?,
            found: Answer::read(words)?,
        })
    }
}

impl Answer for Reason {
    fn write(&self, words: &mut impl Sink) {
        let number: u64 = match self {
            Self::AccelerometerFails => 0,
            Self::LongGap => 1,
            Self::GyroscopeFails => 2,
            Self::OtherMotion => 3,
            Self::OdometryFails => 4,
        };
        number.write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        match u64::read(words)? {
            0 => Some(Self::AccelerometerFails),
            1 => Some(Self::LongGap),
            2 => Some(Self::GyroscopeFails),
            3 => Some(Self::OtherMotion),
            4 => Some(Self::OdometryFails),
            _ => None,
        }
    }
}

impl Answer for RegistrationResult {
    fn write(&self, words: &mut impl Sink) {
        self.pose.write(words);
        [self.correction.start, self.correction.growth].write(words);
        [self.matched_fraction, self.reliable_fraction, self.rms].write(words);
        self.information.write(words);
        self.degenerate.translations.write(words);
        self.degenerate.rotations.write(words);
        self.attenuation.write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let pose = Answer::read(words)?;
        let [start, growth] = Answer::read(words)?;
        let [matched_fraction, reliable_fraction, rms] = Answer::read(words)?;
        Some(Self {
            pose,
            correction: SegmentCorrection { start, growth },
            matched_fraction,
            reliable_fraction,
            rms,
            information: Answer::read(words)?,
            degenerate: DegenerateDirections {
                translations: Answer::read(words)?,
                rotations: Answer::read(words)?,
            },
            attenuation: Answer::read(words)?,
        })
    }
}
