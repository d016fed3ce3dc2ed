//! Recognising a measurement that comes again.

use portolan_recording::Message;

/// A number that equal measurements share (FNV-1a); none for a measurement without any return, which may
/// well come again.
pub fn fingerprint(message: &Message) -> Option<u64> {
    let mut hash = Fingerprint::default();
    match message {
        Message::LaserScan(scan) => scan.ranges.iter().for_each(|range| hash.range(*range)),
        Message::MultiEchoLaserScan(scan) => {
            scan.ranges.iter().flatten().for_each(|range| hash.range(*range));
        }
        Message::PointCloud2(cloud) => {
            hash.returns = cloud.data.iter().any(|byte| *byte != 0);
            let words = cloud.data.chunks(8);
            words.for_each(|word| hash.word(word.iter().fold(0, |all, byte| all << 8 | u64::from(*byte))));
        }
        _ => return None,
    }
    hash.returns.then_some(hash.hash)
}

struct Fingerprint {
    hash: u64,
    returns: bool,
}

impl Default for Fingerprint {
    fn default() -> Self {
        Self { hash: 0xcbf2_9ce4_8422_2325, returns: false }
    }
}

impl Fingerprint {
    fn word(&mut self, word: u64) {
        self.hash = (self.hash ^ word).wrapping_mul(0x0100_0000_01b3);
        self.hash ^= self.hash >> 29;
    }

    fn range(&mut self, range: f32) {
        self.returns |= range.is_finite() && range > 0.0;
        self.word(u64::from(range.to_bits()));
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Time;
    use portolan_recording::{Header, LaserScan};

    use super::*;

    fn scan(ranges: &[f32]) -> Message {
        Message::LaserScan(LaserScan {
            header: Header { stamp: Time::UNIX_EPOCH, frame_id: "laser".into() },
            angle_min: 0.0,
            angle_max: 1.0,
            angle_increment: 0.1,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: 0.1,
            range_max: 10.0,
            ranges: ranges.to_vec(),
            intensities: Vec::new(),
        })
    }

    #[test]
    fn equal_measurements_share_a_fingerprint_and_empty_ones_have_none() {
        assert_eq!(fingerprint(&scan(&[1.0, f32::NAN])), fingerprint(&scan(&[1.0, f32::NAN])));
        assert_ne!(fingerprint(&scan(&[1.0, 2.0])), fingerprint(&scan(&[2.0, 1.0])));
        assert_eq!(fingerprint(&scan(&[f32::INFINITY, 0.0])), None);
    }
}
