//! Decodes data packets of Velodyne sensors.
//!
//! A packet has twelve blocks, each with an azimuth (hundredths of a degree, clockwise) and 32 distances with
//! intensities, followed by the time of its first firing (µs since the full hour), the return mode and the
//! product. Beams fire one after another while the head turns, so each gets its own azimuth and time. Points
//! are in the frame of Velodyne's ROS driver: x at azimuth 0, y to the left, z up.

use std::f64::consts::PI;

use portolan_geometry::{Duration, Time};

use crate::bytes::{u16_at, u32_at};
use crate::velodyne_models::{
    BLOCK_BYTES, BLOCKS, CHANNELS, LOWER, Laser, PACKET_BYTES, UPPER, VelodyneModel,
};
use crate::{PacketPoint, SensorTime, Sweep, SweepBuilder};
use portolan_issue::{IssueKind, IssueLog};

/// Return mode of packets whose blocks come in pairs of the same azimuth.
const DUAL: u8 = 0x39;
const HOUR_MICROSECONDS: i64 = 3_600_000_000;
/// Maximum gap between two packets of a recording: a year, in microseconds.
const LONGEST_WAIT: i64 = 366 * 24 * HOUR_MICROSECONDS;
const TICKS_PER_MICROSECOND: i64 = 10;
/// A full turn in hundredths of a degree.
const TURN: i32 = 36_000;
/// Maximum duration of a sweep, seconds, if its azimuth never passes 0.
const LONGEST_SWEEP: f64 = 1.5;

/// Whether a packet is one of Velodyne's data packets.
pub fn is_velodyne(packet: &[u8]) -> bool {
    packet.len() == PACKET_BYTES && matches!(u16_at(packet, 0), UPPER | LOWER)
}

/// Assembles the packets of one sensor to sweeps; a sweep ends where the azimuth passes 0.
pub(crate) struct VelodyneDecoder {
    model: Option<VelodyneModel>,
    /// By beam number: the beam, and sine and cosine of its elevation.
    lasers: Vec<(Laser, f64, f64)>,
    calibration: Option<Vec<Laser>>,
    builder: SweepBuilder,
    last_azimuth: Option<i32>,
    /// Time of the previous packet, unwrapped, microseconds, and its time of arrival.
    last_time: Option<(i64, Time)>,
}

impl VelodyneDecoder {
    /// A decoder for a sensor; a calibration, if given, replaces the nominal angles.
    pub fn new(calibration: Option<Vec<Laser>>) -> Self {
        Self {
            model: None,
            lasers: Vec::new(),
            calibration,
            builder: SweepBuilder::default(),
            last_azimuth: None,
            last_time: None,
        }
    }

    /// Adds a packet with its time of arrival; complete sweeps go to `sweeps`.
    pub fn push(
        &mut self,
        (packet, arrival): (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        sweeps: &mut dyn FnMut(Sweep),
    ) {
        if !is_velodyne(packet) {
            issues.count(IssueKind::NotVelodyne, 1);
            return;
        }
        let model = self.recognise(packet, issues);
        let start = clock.place(self.sensor_time(packet, arrival), arrival, issues);
        let is_dual = packet.get(PACKET_BYTES - 2) == Some(&DUAL) && model != VelodyneModel::Hdl64e;
        let is_paired = is_dual || model == VelodyneModel::Hdl64e;
        let rate = azimuth_rate(packet, is_paired, model);
        for block in 0..BLOCKS {
            let bytes = packet.get(block * BLOCK_BYTES..(block + 1) * BLOCK_BYTES).unwrap_or_default();
            let flag = u16_at(bytes, 0);
            let azimuth = i32::from(u16_at(bytes, 2));
            if !matches!(flag, UPPER | LOWER) || azimuth >= TURN {
                issues.count(IssueKind::DamagedVelodyneBlock, 1);
                continue;
            }
            // A new sweep starts where the head passed azimuth 0, or if the sweep is too long.
            let wrapped = self.last_azimuth.replace(azimuth).is_some_and(|last| azimuth + TURN / 2 < last);
            let offset = if is_paired { block / 2 } else { block } as f64 * model.block_time();
            let block_time = start + Duration::from_seconds(offset);
            if wrapped || self.builder.is_full() || self.builder.age(block_time) > LONGEST_SWEEP {
                self.builder.take().map(&mut *sweeps);
            }
            let same_as_before = is_dual && block % 2 == 1;
            let before =
                same_as_before.then(|| packet.get((block - 1) * BLOCK_BYTES..block * BLOCK_BYTES)).flatten();
            self.add_block(model, (bytes, before), (azimuth, rate), block_time);
        }
    }

    /// The last, incomplete sweep.
    pub fn finish(&mut self) -> Option<Sweep> {
        self.last_azimuth = None;
        self.builder.take()
    }

    fn recognise(&mut self, packet: &[u8], issues: &mut IssueLog) -> VelodyneModel {
        if let Some(model) = self.model {
            return model;
        }
        let (model, is_known) = VelodyneModel::of(packet);
        if !is_known {
            issues.count(IssueKind::UnknownVelodyne, 1);
        }
        let nominal = model.lasers();
        let calibration = self.calibration.take().filter(|table| table.len() == nominal.len());
        if model == VelodyneModel::Hdl64e && calibration.is_none() {
            issues.count(IssueKind::NoVelodyneCalibration, 1);
        }
        let lasers = calibration.unwrap_or(nominal);
        self.lasers = lasers.into_iter().map(|l| (l, l.elevation.sin(), l.elevation.cos())).collect();
        self.model = Some(model);
        model
    }

    /// Time of the first firing of a packet by the sensor's clock. The packet only has the time since the
    /// full hour.
    fn sensor_time(&mut self, packet: &[u8], arrival: Time) -> Time {
        let raw = i64::from(u32_at(packet, BLOCKS * BLOCK_BYTES)) % HOUR_MICROSECONDS;
        let nearest = |time: i64| {
            raw + (time - raw + HOUR_MICROSECONDS / 2).div_euclid(HOUR_MICROSECONDS) * HOUR_MICROSECONDS
        };
        let microseconds = match self.last_time {
            // A wrong time of arrival does not move a packet that continues the one before it.
            Some((last, _)) if (nearest(last) - last).abs() < 1_000_000 => nearest(last),
            Some((last, last_arrival)) => {
                let waited = (arrival - last_arrival).ticks() / TICKS_PER_MICROSECOND;
                nearest(last.saturating_add(waited.clamp(-LONGEST_WAIT, LONGEST_WAIT)))
            }
            None => nearest(arrival.unix_nanoseconds() / 1000),
        };
        self.last_time = Some((microseconds, arrival));
        Time::UNIX_EPOCH + Duration::from_ticks(microseconds.saturating_mul(TICKS_PER_MICROSECOND))
    }

    /// Adds the returns of a block; of two equal returns only one is added.
    fn add_block(
        &mut self,
        model: VelodyneModel,
        (bytes, before): (&[u8], Option<&[u8]>),
        (azimuth, rate): (i32, f64),
        block_time: Time,
    ) {
        let is_lower = u16_at(bytes, 0) == LOWER;
        for channel in 0..CHANNELS {
            let at = 4 + 3 * channel;
            let raw = u16_at(bytes, at);
            if raw == 0 || before.is_some_and(|before| u16_at(before, at) == raw) {
                continue;
            }
            let Some((laser, sine, cosine)) = self.lasers.get(model.laser_of(channel, is_lower)) else {
                continue;
            };
            let delay = model.channel_delay(channel);
            let angle = (f64::from(azimuth) + rate * delay) * (PI / 18_000.0) - laser.azimuth;
            let distance = f64::from(raw) * model.distance_unit() + laser.distance;
            let across = distance * cosine - laser.vertical_offset * sine;
            let (s, c) = angle.sin_cos();
            let right = across * s - laser.horizontal_offset * c;
            let ahead = across * c + laser.horizontal_offset * s;
            self.builder.push(&PacketPoint {
                position: [ahead, -right, distance * sine + laser.vertical_offset * cosine],
                intensity: f32::from(bytes.get(at + 2).copied().unwrap_or(0)),
                ring: laser.ring,
                time: block_time + Duration::from_seconds(delay),
            });
        }
    }
}

/// Rotation rate of the head, hundredths of a degree per second, from the first and the last block.
fn azimuth_rate(packet: &[u8], is_paired: bool, model: VelodyneModel) -> f64 {
    let step = if is_paired { 2 } else { 1 };
    let azimuth = |block: usize| i32::from(u16_at(packet, block * BLOCK_BYTES + 2));
    let last = BLOCKS - step;
    let turned = (azimuth(last) - azimuth(0)).rem_euclid(TURN);
    // More than a quarter turn within a packet is an error.
    if turned > TURN / 4 {
        return 0.0;
    }
    f64::from(turned) / ((last / step) as f64 * model.block_time())
}
