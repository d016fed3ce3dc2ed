//! Lidar and IMU packets of Ouster's sensors, in all of their layouts with one or two returns.
//!
//! A lidar packet has columns, each measured at once, with a time (ns) and a number that stands for the
//! azimuth; a change of the frame number begins a new sweep. Points are in the sensor's frame.

use std::f64::consts::TAU;

use portolan_geometry::{Duration, Time};

use crate::bytes::{f32_at, u16_at, u32_at, u64_at};
use crate::ouster_metadata::{OusterMetadata, PacketProfile};
use crate::{ImuSample, PacketPoint, SensorTime, Sweep, SweepBuilder};
use portolan_issue::{IssueKind, IssueLog};

/// Bytes of an IMU packet.
pub const IMU_PACKET_BYTES: usize = 48;
const STANDARD_GRAVITY: f64 = 9.80665;

/// How the bytes of a lidar packet lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketLayout {
    /// Layout of a channel.
    pub profile: PacketProfile,
    /// Beams.
    pub channels: usize,
    /// Columns of a packet.
    pub columns: usize,
}

/// Columns of a packet unless its metadata say otherwise.
pub(crate) const USUAL_COLUMNS: usize = 16;

impl PacketLayout {
    /// Bytes of a packet.
    pub fn packet_bytes(&self) -> usize {
        let (head, foot) = self.profile.packet_frame();
        head + self.columns * self.column_bytes() + foot
    }

    fn column_bytes(&self) -> usize {
        let (head, foot) = self.profile.column_frame();
        head + self.channels * self.profile.channel_bytes() + foot
    }

    /// The largest number of a column in a packet of some layout; 0 if it has none.
    pub fn largest_column(packet: &[u8]) -> u16 {
        let Some(layout) = Self::guess(packet.len()) else { return 0 };
        layout.valid_columns(packet).map(|column| u16_at(column, 8)).max().unwrap_or(0)
    }

    /// When the first column of a packet was measured, by the sensor's clock.
    pub fn sensor_time(&self, packet: &[u8]) -> Option<Time> {
        self.valid_columns(packet).next().map(|column| sensor_time(u64_at(column, 0)))
    }

    fn valid_columns(self, packet: &[u8]) -> impl Iterator<Item = &[u8]> {
        let columns = packet.get(self.profile.packet_frame().0..).unwrap_or_default();
        let columns = columns.chunks_exact(self.column_bytes()).take(self.columns);
        columns.filter(move |column| self.profile.is_valid(column))
    }

    /// The layout of packets of a length, without metadata.
    pub fn guess(bytes: usize) -> Option<Self> {
        let candidates = PacketProfile::ALL.into_iter().flat_map(|profile| {
            [64, 128, 32, 16].map(|channels| Self { profile, channels, columns: USUAL_COLUMNS })
        });
        candidates.into_iter().find(|layout| layout.packet_bytes() == bytes)
    }
}

/// Turns lidar packets of one sensor into sweeps.
pub(crate) struct OusterDecoder {
    metadata: OusterMetadata,
    layout: PacketLayout,
    builder: SweepBuilder,
    frame_number: Option<u16>,
    /// By channel: sine and cosine of elevation, azimuth offset in radians, ring.
    beams: Vec<(f64, f64, f64, u16)>,
}

impl OusterDecoder {
    /// A sensor with what is known about it.
    pub fn new(metadata: OusterMetadata, layout: PacketLayout) -> Self {
        let mut rings = vec![0; metadata.altitudes.len()];
        let mut order: Vec<(f64, &mut u16)> = metadata.altitudes.iter().copied().zip(&mut rings).collect();
        order.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        for (number, (_, ring)) in order.into_iter().enumerate() {
            *ring = number as u16;
        }
        let beams = metadata.altitudes.iter().zip(&metadata.azimuths).zip(rings);
        let beams = beams.map(|((altitude, azimuth), ring)| {
            let (sine, cosine) = altitude.to_radians().sin_cos();
            (sine, cosine, -azimuth.to_radians(), ring)
        });
        Self {
            beams: beams.collect(),
            metadata,
            layout,
            builder: SweepBuilder::default(),
            frame_number: None,
        }
    }

    /// Adds a packet that arrived at a time; complete sweeps go to `sweeps`.
    pub fn push(
        &mut self,
        (packet, arrival): (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        sweeps: &mut dyn FnMut(Sweep),
    ) {
        if packet.len() != self.layout.packet_bytes() {
            issues.count(IssueKind::WrongOusterLength, 1);
            return;
        }
        let (profile, bytes) = (self.layout.profile, self.layout.column_bytes());
        let head = profile.packet_frame().0;
        let mut invalid = 0;
        for column in packet.get(head..).unwrap_or_default().chunks_exact(bytes).take(self.layout.columns) {
            if !profile.is_valid(column) {
                invalid += 1;
                continue;
            }
            let frame_number = profile.frame_number(packet, column);
            if self.frame_number.replace(frame_number).is_some_and(|last| last != frame_number)
                || self.builder.is_full()
            {
                self.builder.take().map(&mut *sweeps);
            }
            let time = clock.place(sensor_time(u64_at(column, 0)), arrival, issues);
            self.add_column(column, time);
        }
        if invalid > 0 {
            issues.count(IssueKind::InvalidOusterColumn, invalid);
        }
    }

    /// The sweep that is not complete yet.
    pub fn finish(&mut self) -> Option<Sweep> {
        self.frame_number = None;
        self.builder.take()
    }

    fn add_column(&mut self, column: &[u8], time: Time) {
        let profile = self.layout.profile;
        // Columns are numbered in the direction of the turn, clockwise.
        let number = f64::from(u16_at(column, 8));
        let encoder = TAU * (1.0 - number / self.metadata.columns_per_frame as f64);
        let (encoder_sine, encoder_cosine) = encoder.sin_cos();
        let offset = self.metadata.beam_origin;
        let start = profile.column_frame().0;
        for (channel, (sine, cosine, azimuth, ring)) in self.beams.iter().enumerate() {
            let at = start + channel * profile.channel_bytes();
            let Some(bytes) = column.get(at..at + profile.channel_bytes()) else { break };
            let (s, c) = (encoder + azimuth).sin_cos();
            for (range, intensity) in profile.returns(bytes).into_iter().flatten() {
                let along = f64::from(range) * 0.001 - offset;
                let in_lidar = [
                    along * c * cosine + offset * encoder_cosine,
                    along * s * cosine + offset * encoder_sine,
                    along * sine,
                ];
                self.builder.push(&PacketPoint {
                    position: self.metadata.sensor_from_lidar(in_lidar),
                    intensity,
                    ring: *ring,
                    time,
                });
            }
        }
    }
}

fn sensor_time(nanoseconds: u64) -> Time {
    Time::UNIX_EPOCH + Duration::from_ticks(i64::try_from(nanoseconds / 100).unwrap_or(i64::MAX))
}

/// When a sample was measured: a packet has the times of the system, of the accelerometer and of the
/// gyroscope.
pub(crate) fn imu_sensor_time(packet: &[u8]) -> Option<Time> {
    (packet.len() == IMU_PACKET_BYTES).then(|| sensor_time(u64_at(packet, 16)))
}

/// The sample of a packet that arrived at a time, in SI units.
pub(crate) fn imu_sample(
    (packet, arrival): (&[u8], Time),
    clock: &mut SensorTime,
    issues: &mut IssueLog,
) -> Option<ImuSample> {
    let Some(measured) = imu_sensor_time(packet) else {
        issues.count(IssueKind::WrongOusterImuLength, 1);
        return None;
    };
    let three = |at: usize, unit: f64| [0, 4, 8].map(|i| f64::from(f32_at(packet, at + i)) * unit);
    Some(ImuSample {
        time: clock.place(measured, arrival, issues),
        angular_velocity: three(36, std::f64::consts::PI / 180.0),
        linear_acceleration: three(24, STANDARD_GRAVITY),
    })
}

impl PacketProfile {
    /// Bytes before and behind the columns of a packet.
    fn packet_frame(self) -> (usize, usize) {
        if self == Self::Legacy { (0, 0) } else { (32, 32) }
    }

    /// Bytes before and behind the channels of a column.
    fn column_frame(self) -> (usize, usize) {
        if self == Self::Legacy { (16, 4) } else { (12, 0) }
    }

    fn channel_bytes(self) -> usize {
        match self {
            Self::Legacy | Self::Single => 12,
            Self::LowData => 4,
            Self::Dual => 16,
            Self::LowDataDual => 8,
        }
    }

    fn is_valid(self, column: &[u8]) -> bool {
        match self {
            Self::Legacy => u32_at(column, column.len().saturating_sub(4)) == u32::MAX,
            _ => u16_at(column, 10) & 1 == 1,
        }
    }

    fn frame_number(self, packet: &[u8], column: &[u8]) -> u16 {
        if self == Self::Legacy { u16_at(column, 10) } else { u16_at(packet, 2) }
    }

    /// Range in millimetres and reflectivity of up to two returns.
    fn returns(self, bytes: &[u8]) -> [Option<(u32, f32)>; 2] {
        let byte = |at: usize| f32::from(bytes.get(at).copied().unwrap_or(0));
        let one = |range: u32, intensity: f32| (range > 0).then_some((range, intensity));
        match self {
            Self::Legacy => [one(u32_at(bytes, 0) & 0x000f_ffff, f32::from(u16_at(bytes, 4))), None],
            Self::Single => [one(u32_at(bytes, 0) & 0x0007_ffff, byte(4)), None],
            // Ranges of 15 bits count in 8 mm.
            Self::LowData => [one(8 * (u32::from(u16_at(bytes, 0)) & 0x7fff), byte(2)), None],
            Self::Dual => {
                [one(u32_at(bytes, 0) & 0x0007_ffff, byte(3)), one(u32_at(bytes, 4) & 0x0007_ffff, byte(7))]
            }
            Self::LowDataDual => [
                one(8 * (u32::from(u16_at(bytes, 0)) & 0x7fff), byte(2)),
                one(8 * (u32::from(u16_at(bytes, 4)) & 0x7fff), byte(6)),
            ],
        }
    }
}
