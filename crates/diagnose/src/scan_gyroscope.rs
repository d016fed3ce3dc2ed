//! Checks that a gyroscope measures the same rotation about the axis of a planar scanner as the scans, and
//! estimates the offset between their time stamps.

use portolan_geometry::{Rigid3, Vector3};
use portolan_ingest::{Inventory, PlannedImu, PlannedSensor};
use portolan_recording::Message;

use crate::clock_offset::ImuMounting;
use crate::rotation::{ENOUGH_TURNS, Turn, compare, sure_offset};
use crate::scan_comparison::SensorDelay;
use crate::turns::{AGREES, ImuTurns};

/// Range of the ratio of gyroscope rotation to scan rotation in which both agree. Scan rotation comes out
/// too small, because rotation between two profiles is partly missed.
const AS_FAST: std::ops::RangeInclusive<f64> = 0.75..=1.33;

/// Rotation measured by an IMU.
pub(crate) struct ScanGyroscope<'a> {
    pub planned: &'a PlannedImu,
    turns: ImuTurns,
}

impl<'a> ScanGyroscope<'a> {
    pub fn new(planned: &'a PlannedImu) -> Self {
        Self { planned, turns: ImuTurns::default() }
    }

    pub fn add(&mut self, message: &Message) {
        if let Message::Imu(imu) = message {
            self.turns.add(imu);
        }
    }

    /// Compares the rotation with that of a given scanner. Returns how the gyroscope differs, and by how
    /// many seconds scans are stamped too late against it; each only where it is certain.
    pub fn compare(
        &self,
        inventory: &Inventory,
        (scanner, turns): (&PlannedSensor, &[Turn]),
    ) -> (Option<ImuMounting>, Option<SensorDelay>) {
        let PlannedImu { source, scale, .. } = self.planned;
        let imu_from_scanner = inventory.tree.lookup_static(&source.frame, &scanner.frame);
        let axis = imu_from_scanner.unwrap_or_else(Rigid3::identity).rotation * Vector3::z();
        let measured = self.turns.about(&(axis * scale.angular_velocity));
        let Some(agreement) = compare(turns, &measured) else { return (None, None) };
        let is_sure = agreement.turned >= ENOUGH_TURNS && agreement.correlation.abs() >= AGREES;
        if is_sure && !AS_FAST.contains(&agreement.slope) {
            let imu = source.topic.clone();
            return (Some(ImuMounting { imu, turned: 0.0, factor: agreement.slope }), None);
        }
        let delay = sure_offset(&measured, turns, false);
        // The offset is reported between the stamps as recorded.
        let shift = (scanner.clock_shift - source.clock_shift).seconds();
        (None, delay.map(|(lag, sigma)| SensorDelay { seconds: lag + shift, sigma }))
    }
}
