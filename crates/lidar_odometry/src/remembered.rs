//! What registration of a sweep found, as it is remembered: a job that was cut off takes it from there.

use portolan_motion::DegenerateDirections;
use portolan_recall::{Answer, Fingerprint, Sink, Words};

use crate::predict::Reason;
use crate::registration::RegistrationResult;
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::sweep::Sweep;

/// Points of a sweep that tell it from others; all of them would take as long as parts of the work.
const TELLING_POINTS: usize = 256;

/// What was found of a sweep.
pub(crate) struct Finding {
    /// Points that were sampled.
    pub sampled: u64,
    /// Which hypothesis fits best; none for the first.
    pub reason: Option<Reason>,
    /// Where it fits; none if nowhere.
    pub found: Option<RegistrationResult>,
}

/// Adds what a registration depends on beside what came before.
pub(crate) fn ask(question: &mut Fingerprint, sweep: &Sweep, segment: &TrajectorySegment) {
    question.add((sweep.end, sweep.points.len() as u64));
    question.add([segment.start(), segment.end()]);
    let stride = (sweep.points.len() / TELLING_POINTS).max(1);
    let telling = sweep.points.iter().step_by(stride);
    question.add_f32s(telling.flat_map(|p| [p.time, p.position.x, p.position.y, p.position.z]));
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
