//! Serialises estimates, so that those of a long recording can be kept in a file.

use portolan_grids::ScanAgreement;
use portolan_recall::{Answer, Sink, Words};

use crate::{Estimate, Place, Reason, State};

impl Answer for Estimate {
    fn write(&self, words: &mut impl Sink) {
        (self.time, [state_number(self.state), reason_number(self.reason)]).write(words);
        (self.local_from_tracking, self.place).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (time, [state, reason]) = <(_, [u32; 2])>::read(words)?;
        let state = State::ALL.into_iter().find(|known| state_number(*known) == state)?;
        let reason = Reason::ALL.into_iter().find(|known| reason_number(*known) == reason)?;
        let (local_from_tracking, place) = Answer::read(words)?;
        Some(Self { time, state, reason, local_from_tracking, place })
    }
}

impl Answer for Place {
    fn write(&self, words: &mut impl Sink) {
        (self.map_from_tracking, self.covariance).write(words);
        let ScanAgreement { explained, in_free_space, through_solid } = self.agreement;
        [explained, in_free_space, through_solid].write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (map_from_tracking, covariance) = Answer::read(words)?;
        let [explained, in_free_space, through_solid] = Answer::read(words)?;
        let agreement = ScanAgreement { explained, in_free_space, through_solid };
        Some(Self { map_from_tracking, covariance, agreement })
    }
}

fn state_number(state: State) -> u32 {
    state as u32
}

fn reason_number(reason: Reason) -> u32 {
    reason as u32
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Rigid3, Time, Vector3};

    use super::*;
    use crate::Matrix6;

    #[test]
    fn estimates_come_back_bit_by_bit() {
        let pose = |x| Rigid3::new(Vector3::new(x, 2.0, 3.0), Vector3::new(0.1, -0.2, 0.3));
        let agreement = ScanAgreement { explained: 0.9, in_free_space: 0.01, through_solid: 0.02 };
        let covariance = Matrix6::from_fn(|i, j| 1.0 / (1 + i + j) as f64);
        let place = Some(Place { map_from_tracking: pose(1.0), covariance, agreement });
        for place in [place, None] {
            for state in State::ALL {
                for reason in Reason::ALL {
                    let time = Time::from_ticks(-5);
                    let estimate = Estimate { time, state, reason, local_from_tracking: pose(-7.0), place };
                    let mut words = Vec::new();
                    estimate.write(&mut words);
                    assert_eq!(Words::new(&words).whole(), Some(estimate));
                }
            }
        }
    }
}
