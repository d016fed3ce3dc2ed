//! Decodes lidar packets of Ouster sensors, in all of their layouts, with one or two returns.
//!
//! A lidar packet has columns. All beams of a column are measured at one time, and the column has that time
//! (ns) and a number that corresponds to the azimuth. A change of the frame number starts a new sweep. Points
//! are in the sensor's frame.

use std::f64::consts::TAU;

use portolan_geometry::{Duration, Time};

use crate::bytes::{u16_at, u32_at, u64_at};
use crate::ouster_header::{FRAME_BYTES, is_other_ouster_data};
use crate::{OusterMetadata, PacketHeader, PacketPoint, PacketProfile, SensorTime, Sweep, SweepBuilder};
use portolan_issue::{IssueKind, IssueLog};

/// Layout of the bytes of a lidar packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketLayout {
    /// Layout of a channel.
    pub profile: PacketProfile,
    /// Layout of the header; packets with the legacy layout have none.
    pub header: PacketHeader,
    /// Number of beams.
    pub channels: usize,
    /// Number of columns per packet.
    pub columns: usize,
}

/// Columns per packet, unless the metadata give another number.
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

    /// The largest column number in a packet of some layout; 0 if there is none.
    pub fn largest_column(packet: &[u8]) -> u16 {
        let Some(layout) = Self::guess(packet) else { return 0 };
        layout.valid_columns(packet).map(|column| u16_at(column, 8)).max().unwrap_or(0)
    }

    /// Time of measurement of the first column of a packet, by the sensor's clock.
    pub fn sensor_time(&self, packet: &[u8]) -> Option<Time> {
        self.valid_columns(packet).next().map(|column| sensor_time(u64_at(column, 0)))
    }

    /// The frame number of a column.
    fn frame_number(&self, packet: &[u8], column: &[u8]) -> u32 {
        match self.profile {
            PacketProfile::Legacy => u32::from(u16_at(column, 10)),
            _ => self.header.frame_number(packet),
        }
    }

    fn valid_columns(self, packet: &[u8]) -> impl Iterator<Item = &[u8]> {
        let columns = packet.get(self.profile.packet_frame().0..).unwrap_or_default();
        let columns = columns.chunks_exact(self.column_bytes()).take(self.columns);
        columns.filter(move |column| self.profile.is_valid(column))
    }

    /// The serial number of the sensor that sent a packet; none if packets do not contain it.
    pub fn serial(&self, packet: &[u8]) -> Option<u64> {
        (self.profile != PacketProfile::Legacy).then(|| self.header.serial(packet)).flatten()
    }

    /// A number that changes with each start of the sensor; none if packets do not contain it.
    pub fn initialization(&self, packet: &[u8]) -> Option<u32> {
        (self.profile != PacketProfile::Legacy).then(|| self.header.initialization(packet)).flatten()
    }

    /// Guesses the layout of a packet from its length, without metadata.
    pub fn guess(packet: &[u8]) -> Option<Self> {
        let header = PacketHeader::of(packet);
        let candidates = PacketProfile::USUAL.into_iter().flat_map(|profile| {
            [64, 128, 32, 16].map(|channels| Self { profile, header, channels, columns: USUAL_COLUMNS })
        });
        candidates.into_iter().find(|layout| layout.packet_bytes() == packet.len())
    }
}

/// Assembles the lidar packets of one sensor to sweeps.
pub(crate) struct OusterDecoder {
    metadata: OusterMetadata,
    layout: PacketLayout,
    builder: SweepBuilder,
    frame_number: Option<u32>,
    /// By channel: sine and cosine of elevation, azimuth offset in radians, ring.
    beams: Vec<(f64, f64, f64, u16)>,
}

impl OusterDecoder {
    /// A decoder for a sensor with this metadata and packet layout.
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

    /// Adds a packet with its time of arrival; complete sweeps go to `sweeps`.
    pub fn push(
        &mut self,
        (packet, arrival): (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        sweeps: &mut dyn FnMut(Sweep),
    ) {
        if packet.len() != self.layout.packet_bytes() {
            if !is_other_ouster_data(packet) {
                issues.count(IssueKind::WrongOusterLength, 1);
            }
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
            let frame_number = self.layout.frame_number(packet, column);
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

    /// The last, incomplete sweep.
    pub fn finish(&mut self) -> Option<Sweep> {
        self.frame_number = None;
        self.builder.take()
    }

    fn add_column(&mut self, column: &[u8], time: Time) {
        let profile = self.layout.profile;
        // Columns are numbered in the direction of rotation, clockwise.
        let number = f64::from(u16_at(column, 8));
        let encoder = TAU * (1.0 - number / self.metadata.columns_per_frame as f64);
        let (encoder_sine, encoder_cosine) = encoder.sin_cos();
        let [ahead, above] = self.metadata.beam_origin;
        // Ranges include the distance from the origin of the lidar's frame to the origin of the beams.
        let offset = if above == 0.0 { ahead } else { ahead.hypot(above) };
        let start = profile.column_frame().0;
        for (channel, (sine, cosine, azimuth, ring)) in self.beams.iter().enumerate() {
            let at = start + channel * profile.channel_bytes();
            let Some(bytes) = column.get(at..at + profile.channel_bytes()) else { break };
            let (s, c) = (encoder + azimuth).sin_cos();
            for (range, intensity) in profile.returns(bytes).into_iter().flatten() {
                let along = f64::from(range) * 0.001 - offset;
                let in_lidar = [
                    along * c * cosine + ahead * encoder_cosine,
                    along * s * cosine + ahead * encoder_sine,
                    along * sine + above,
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

/// A time of the sensor's clock, from nanoseconds.
pub(crate) fn sensor_time(nanoseconds: u64) -> Time {
    Time::UNIX_EPOCH + Duration::from_ticks(i64::try_from(nanoseconds / 100).unwrap_or(i64::MAX))
}

impl PacketProfile {
    /// Bytes before and behind the columns of a packet.
    fn packet_frame(self) -> (usize, usize) {
        if self == Self::Legacy { (0, 0) } else { (FRAME_BYTES, FRAME_BYTES) }
    }

    /// Bytes before and behind the channels of a column.
    fn column_frame(self) -> (usize, usize) {
        if self == Self::Legacy { (16, 4) } else { (12, 0) }
    }

    fn is_valid(self, column: &[u8]) -> bool {
        match self {
            Self::Legacy => u32_at(column, column.len().saturating_sub(4)) == u32::MAX,
            _ => u16_at(column, 10) & 1 == 1,
        }
    }
}
