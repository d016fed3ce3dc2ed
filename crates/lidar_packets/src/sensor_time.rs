//! Maps the clocks of sensors to that of the recording.

use portolan_geometry::{Duration, Time};

use crate::PacketSource;
use portolan_issue::{IssueKind, IssueLog};

/// Maps the clock of a sensor to that of the recording.
///
/// A sensor clock within 2 s of the time of arrival is used as it is. Any other clock (time since power-on,
/// an hour that was never set) is shifted once, so that the first packet was measured when it arrived. If the
/// clock jumps later, as it does when a GNSS receiver gets its time, the shift is changed so that the times
/// continue without the jump.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorTime {
    /// Lag (arrival minus measurement) of the first packet, if that packet was read before.
    first_lag: Option<Duration>,
    shift: Option<Duration>,
    /// The shift before the last jump.
    shift_before: Option<Duration>,
    /// Lag (arrival minus measurement) at the start, with the shift.
    usual_lag: Duration,
    /// The previous packet: time by the sensor's clock, and time of arrival.
    before: Option<(Time, Time)>,
}

/// Maximum difference between clocks that agree, seconds.
const AGREEMENT: f64 = 2.0;
/// Minimum jump of a sensor clock, seconds: the difference between the step of the clock and the step of
/// arrival. Packets are never delayed by this much unless those before them are, too.
const JUMP: f64 = 1.0;
/// Maximum distance from the shift before a jump at which the clock has returned from that jump, seconds.
const BACK: f64 = 0.1;

impl SensorTime {
    /// Converts the time of a measurement from the sensor's clock to the recording's clock.
    pub fn place(&mut self, sensor: Time, arrival: Time, issues: &mut IssueLog) -> Time {
        let shift = self.shift.unwrap_or_else(|| self.begin(arrival - sensor, issues));
        let shift = self.after_jump(sensor, arrival, shift).map_or(shift, |shift| {
            issues.count(IssueKind::SensorClockJumped, 1);
            shift
        });
        self.shift = Some(shift);
        self.before = Some((sensor, arrival));
        sensor + shift
    }

    fn begin(&mut self, lag: Duration, issues: &mut IssueLog) -> Duration {
        let lag = self.first_lag.unwrap_or(lag);
        let agrees = lag.seconds().abs() <= AGREEMENT;
        if !agrees {
            issues.count(IssueKind::SensorClockNotSet, 1);
        }
        let shift = if agrees { Duration::ZERO } else { lag };
        self.usual_lag = lag - shift;
        shift
    }

    /// The new shift if the clock jumped, so that times continue without the jump.
    fn after_jump(&mut self, sensor: Time, arrival: Time, shift: Duration) -> Option<Duration> {
        let (last_sensor, last_arrival) = self.before?;
        let (step, waited) = (sensor - last_sensor, arrival - last_arrival);
        let is_jump = |step: Duration| step.seconds().abs() > JUMP;
        // If the recorder hangs, arrivals are delayed without a step of the sensor clock. If it loses
        // packets, the step of the sensor clock ends at the usual lag. Neither is a jump of the sensor's
        // clock.
        let lag = arrival - (sensor + shift);
        if !is_jump(step) || !is_jump(step - waited) || !is_jump(lag - self.usual_lag) {
            return None;
        }
        let continued = shift + (waited - step);
        let is_back = |before: &Duration| (continued - *before).seconds().abs() < BACK;
        Some(self.shift_before.replace(shift).filter(is_back).unwrap_or(continued))
    }
}

/// Properties of a stream of packets before it is read.
pub struct PacketStream<'a, Host> {
    /// The host; streams of the same sensor have the same host.
    pub host: Host,
    /// The sensor that sends it.
    pub source: &'a PacketSource,
    /// Its first packet and the packet's time of arrival.
    pub first: (&'a [u8], Time),
}

impl<'a, Host> PacketStream<'a, Host> {
    /// A stream with its first packet.
    pub fn new(host: Host, source: &'a PacketSource, first: &'a (Vec<u8>, Time)) -> Self {
        Self { host, source, first: (&first.0, first.1) }
    }

    fn serial(&self) -> Option<u64> {
        self.source.serial(self.first.0)
    }
}

/// The index of the clock of each stream, and the clocks: as many as streams, of which some are not used.
///
/// Lidar and IMU of one sensor share a clock. If each was shifted by its own first packet, their times would
/// differ by the difference of the transmission delays of these two packets.
pub fn clocks_of<Host: PartialEq>(streams: &[PacketStream<'_, Host>]) -> (Vec<usize>, Vec<SensorTime>) {
    let clock_of = |i: usize| lidar_of_imu(streams, i).unwrap_or(i);
    let numbers: Vec<usize> = (0..streams.len()).map(clock_of).collect();
    // The packet with the shortest delay gives the best estimate of the offset.
    let lag = |i: &usize| {
        let stream = streams.get(*i)?;
        let (packet, arrival) = stream.first;
        stream.source.sensor_time(packet).map(|sensor| arrival - sensor)
    };
    let least_lag = |clock: usize| {
        let own = (0..streams.len()).filter(|i| numbers.get(*i) == Some(&clock));
        own.filter_map(|i| lag(&i)).min()
    };
    let clocks = (0..streams.len())
        .map(|clock| SensorTime { first_lag: least_lag(clock), ..SensorTime::default() })
        .collect();
    (numbers, clocks)
}

/// The lidar in the same housing as an IMU: the one with the same serial number, else the only pair of the
/// same host, else the only pair of all.
fn lidar_of_imu<Host: PartialEq>(streams: &[PacketStream<'_, Host>], imu: usize) -> Option<usize> {
    let own = streams.get(imu).filter(|s| *s.source == PacketSource::OusterImu)?;
    let serial = own.serial();
    let is_other =
        |s: &PacketStream<'_, Host>| serial.is_some() && s.serial().is_some_and(|of| serial != Some(of));
    let only_pair = |is_near: &dyn Fn(&PacketStream<'_, Host>) -> bool| {
        let near = || streams.iter().enumerate().filter(|(_, s)| is_near(s) && !is_other(s));
        let mut lidars = near().filter(|(_, s)| matches!(s.source, PacketSource::OusterLidar(..)));
        let (lidar, _) = lidars.next()?;
        let imus = near().filter(|(_, s)| *s.source == PacketSource::OusterImu).count();
        (imus == 1 && lidars.next().is_none()).then_some(lidar)
    };
    only_pair(&|s| serial.is_some() && s.serial() == serial)
        .or_else(|| only_pair(&|s| s.host == own.host))
        .or_else(|| only_pair(&|_| true))
}
