//! Decodes IMU packets of Ouster sensors: one sample in units of gravity and degrees (`LEGACY`), or several
//! in SI units (`ACCEL32_GYRO32_NMEA`).

use portolan_geometry::{STANDARD_GRAVITY, Time};

use crate::bytes::{f32_at, u16_at, u64_at};
use crate::ouster::sensor_time;
use crate::ouster_header::{Contents, FRAME_BYTES, PacketHeader, is_other_ouster_data};
use crate::{ImuSample, SensorTime};
use portolan_issue::{IssueKind, IssueLog};

/// Bytes of a packet with a single sample.
const ONE_SAMPLE_BYTES: usize = 48;
/// Bytes of each sample in a packet with several.
const SAMPLE_BYTES: usize = 36;
/// Bytes of an NMEA sentence of a GNSS receiver and its time.
const SENTENCE_BYTES: usize = 100;
/// Maximum number of samples per packet; a revolution has 64. Lidar packets with the `LEGACY` layout may
/// begin with any byte, but are longer or not a whole number of samples.
const MAX_SAMPLES: usize = 128;

/// One sample as in the packet.
struct RawSample {
    measured: Time,
    angular_velocity: [f64; 3],
    linear_acceleration: [f64; 3],
}

/// Whether a packet is an IMU packet of an Ouster.
pub fn is_ouster_imu(packet: &[u8]) -> bool {
    packet.len() == ONE_SAMPLE_BYTES || samples(packet).is_some()
}

/// The serial number of the sensor that sent an IMU packet; packets with a single sample do not contain it.
pub fn ouster_imu_serial(packet: &[u8]) -> Option<u64> {
    samples(packet).and_then(|_| PacketHeader::of(packet).serial(packet))
}

/// The bytes of several samples; none for any other packet.
fn samples(packet: &[u8]) -> Option<&[u8]> {
    let around = 2 * FRAME_BYTES + SENTENCE_BYTES;
    let bytes = packet.len().checked_sub(around)?;
    let fits = bytes.is_multiple_of(SAMPLE_BYTES) && (1..=MAX_SAMPLES).contains(&(bytes / SAMPLE_BYTES));
    let is_imu = fits && PacketHeader::of(packet).contents(packet) == Contents::Imu;
    is_imu.then(|| packet.get(around - FRAME_BYTES..)?.get(..bytes)).flatten()
}

/// Time of measurement of the last sample of a packet, by the sensor's clock; it has the shortest delay until
/// sending.
pub(crate) fn imu_sensor_time(packet: &[u8]) -> Option<Time> {
    if packet.len() == ONE_SAMPLE_BYTES {
        // The packet contains the times of the system, of the accelerometer and of the gyroscope.
        return Some(sensor_time(u64_at(packet, 16)));
    }
    let mut valid = samples(packet)?.chunks_exact(SAMPLE_BYTES).filter(|sample| is_valid(sample));
    valid.next_back().map(|sample| sensor_time(u64_at(sample, 0)))
}

fn is_valid(sample: &[u8]) -> bool {
    u16_at(sample, 10) & 1 == 1
}

fn three(bytes: &[u8], at: usize, unit: f64) -> [f64; 3] {
    [0, 4, 8].map(|i| f64::from(f32_at(bytes, at + i)) * unit)
}

/// Decodes the samples of a packet with its time of arrival, in SI units.
pub(crate) fn imu_samples(
    (packet, arrival): (&[u8], Time),
    clock: &mut SensorTime,
    issues: &mut IssueLog,
    give: &mut dyn FnMut(ImuSample),
) {
    let mut place = |raw: RawSample, issues: &mut IssueLog| {
        give(ImuSample {
            time: clock.place(raw.measured, arrival, issues),
            angular_velocity: raw.angular_velocity,
            linear_acceleration: raw.linear_acceleration,
        });
    };
    if packet.len() == ONE_SAMPLE_BYTES {
        let raw = RawSample {
            measured: sensor_time(u64_at(packet, 16)),
            angular_velocity: three(packet, 36, std::f64::consts::PI / 180.0),
            linear_acceleration: three(packet, 24, STANDARD_GRAVITY),
        };
        return place(raw, issues);
    }
    let Some(samples) = samples(packet) else {
        if !is_other_ouster_data(packet) {
            issues.count(IssueKind::WrongOusterImuLength, 1);
        }
        return;
    };
    for sample in samples.chunks_exact(SAMPLE_BYTES) {
        if !is_valid(sample) {
            issues.count(IssueKind::InvalidOusterSample, 1);
            continue;
        }
        let raw = RawSample {
            measured: sensor_time(u64_at(sample, 0)),
            angular_velocity: three(sample, 24, 1.0),
            linear_acceleration: three(sample, 12, 1.0),
        };
        place(raw, issues);
    }
}
