//! The clocks of sensors, put onto that of the recording.

use portolan_geometry::{Duration, Time};

use crate::PacketSource;
use portolan_issue::{IssueKind, IssueLog};

/// Puts the clock of a sensor onto that of the recording.
///
/// A sensor whose clock agrees with the time of arrival to 2 s is believed. Any other clock (time since
/// it was switched on, an hour that nobody set) is shifted once so that the first packet was measured
/// when it arrived. A clock that jumps on the way, as it does when a receiver of satellites finds its
/// time, goes on as before.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorTime {
    /// Arrival after measurement of the first packet, if it was looked at before.
    first_lag: Option<Duration>,
    shift: Option<Duration>,
    /// The shift before the last jump.
    shift_before: Option<Duration>,
    /// Arrival after measurement as at the start, with the shift.
    usual_lag: Duration,
    /// The packet before: by the sensor's clock, and its arrival.
    before: Option<(Time, Time)>,
}

/// Clocks nearer than this agree.
const AGREEMENT: f64 = 2.0;
/// Steps of a clock that differ from those of arrival by more are jumps; packets are never late by so much
/// without those before.
const JUMP: f64 = 1.0;
/// A clock that comes back to this near of where it was before a jump is there again.
const BACK: f64 = 0.1;

impl SensorTime {
    /// The time of a measurement by the sensor's clock, in the recording's clock.
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

    /// The shift with which times go on if the clock jumped.
    fn after_jump(&mut self, sensor: Time, arrival: Time, shift: Duration) -> Option<Duration> {
        let (last_sensor, last_arrival) = self.before?;
        let (step, waited) = (sensor - last_sensor, arrival - last_arrival);
        let is_jump = |step: Duration| step.seconds().abs() > JUMP;
        // A recorder that hangs shows as waiting without a step, packets lost by it as a step that ends
        // at the usual lag: neither is a jump of the sensor's clock.
        let lag = arrival - (sensor + shift);
        if !is_jump(step) || !is_jump(step - waited) || !is_jump(lag - self.usual_lag) {
            return None;
        }
        let continued = shift + (waited - step);
        let is_back = |before: &Duration| (continued - *before).seconds().abs() < BACK;
        Some(self.shift_before.replace(shift).filter(is_back).unwrap_or(continued))
    }
}

/// What is known of a stream of packets before it is read.
pub struct PacketStream<'a, Host> {
    /// Streams of the same sensor come from the same.
    pub host: Host,
    /// What sends it.
    pub source: &'a PacketSource,
    /// Its first packet, and when that arrived.
    pub first: (&'a [u8], Time),
}

impl<'a, Host> PacketStream<'a, Host> {
    /// A stream of which the first packet is at hand.
    pub fn new(host: Host, source: &'a PacketSource, first: &'a (Vec<u8>, Time)) -> Self {
        Self { host, source, first: (&first.0, first.1) }
    }

    fn serial(&self) -> Option<u64> {
        self.source.serial(self.first.0)
    }
}

/// By stream the number of its clock, and the clocks: as many as streams, of which some stay unused.
///
/// Lidar and IMU of one sensor have one: shifted by the first packets of each, their times would differ by
/// how long these two packets took.
pub fn clocks_of<Host: PartialEq>(streams: &[PacketStream<'_, Host>]) -> (Vec<usize>, Vec<SensorTime>) {
    let clock_of = |i: usize| lidar_of_imu(streams, i).unwrap_or(i);
    let numbers: Vec<usize> = (0..streams.len()).map(clock_of).collect();
    // The packet that took least tells best when it was measured.
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

/// The lidar that sits in one housing with an IMU: that of its serial number, or the only ones of their host, or of all.
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
