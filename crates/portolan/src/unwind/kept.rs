//! Sweeps kept from mapping, so that a short recording need not be read a second time.

use portolan_sensor::{Measurement, TimedPoint, TimedPointCloudData};

/// What range sensors measured, as far as it fits into memory.
#[derive(Clone, Debug, Default)]
pub struct KeptSweeps {
    sweeps: Vec<TimedPointCloudData>,
    bytes: usize,
    max_bytes: usize,
    overflowed: bool,
}

impl KeptSweeps {
    /// Keeps at most so many bytes; with none nothing is kept.
    pub fn up_to(max_bytes: usize) -> Self {
        Self { max_bytes, ..Self::default() }
    }

    /// Keeps a sweep, without its intensities; forgets everything once it is too much.
    pub fn keep(&mut self, measurement: &Measurement) {
        let Measurement::Range(sweep) = measurement else { return };
        self.bytes += size_of_val(sweep) + sweep.points_in_tracking.len() * size_of::<TimedPoint>();
        if self.bytes > self.max_bytes || self.overflowed {
            self.overflowed = true;
            self.sweeps = Vec::new();
            return;
        }
        self.sweeps.push(TimedPointCloudData {
            time: sweep.time,
            origin_in_tracking: sweep.origin_in_tracking,
            points_in_tracking: sweep.points_in_tracking.clone(),
            intensities: Vec::new(),
        });
    }

    /// All sweeps; none unless every one could be kept.
    pub fn complete(&self) -> Option<&[TimedPointCloudData]> {
        (!self.overflowed && !self.sweeps.is_empty()).then_some(&self.sweeps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Point3f, Time};

    #[test]
    fn all_or_nothing_is_kept() {
        let sweep = |points: usize| {
            Measurement::Range(TimedPointCloudData {
                time: Time::from_ticks(5),
                origin_in_tracking: Point3f::origin(),
                points_in_tracking: vec![TimedPoint { position: Point3f::origin(), time: 0.0 }; points],
                intensities: vec![1.0; points],
            })
        };
        let mut kept = KeptSweeps::up_to(2000);
        kept.keep(&sweep(50));
        assert_eq!(kept.complete().map(|s| s[0].points_in_tracking.len()), Some(50));
        kept.keep(&sweep(100));
        kept.keep(&sweep(1));
        assert_eq!(kept.complete(), None);
        assert_eq!(KeptSweeps::default().complete(), None);
    }
}
