//! Faults of the data that were repaired or left out: kinds and counts.

use std::collections::BTreeMap;

use portolan_issue::IssueKind;
use portolan_motion::ExtrapolatorError;

/// Fault of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Issue {
    /// An IMU sample from before the last registered sweep, or out of order; it was left out.
    ImuSampleTooOld,
    /// An IMU sample that is not finite; it was left out.
    ImuSampleNotFinite,
    /// An IMU sample that came after the trajectory began without an IMU.
    ImuAfterStart,
    /// An odometry pose from before the last registered sweep, or out of order; it was left out.
    OdometryTooOld,
    /// A sweep without a point; it was left out.
    EmptySweep,
    /// A sweep that ends before the last registered one; it was left out.
    SweepTooOld,
    /// A sweep that fits clearly better without the rotation that the gyroscope measured.
    GyroscopeOverruled,
    /// A sweep that fits at the pose without odometry, and not at that of odometry; odometry was not used.
    OdometryOverruled,
    /// A sweep that fits no plane; its pose is predicted, or that of the fallback map.
    NoPlaneFits,
    /// A sweep that contradicts the map; it is not inserted.
    ContradictsMap,
    /// A sweep that is occluded; it was left out.
    PlaceHidden,
    /// A sweep before which the distance travelled had been unmeasured for seconds: constant velocity was
    /// assumed.
    TravelGuessed,
    /// The first sweep after a gap in which no sensor measured the motion; its pose is uncertain.
    GapUncertain,
}

impl Issue {
    /// Why an IMU sample was left out before the trajectory began.
    pub fn of_imu_sample(error: ExtrapolatorError) -> Self {
        match error {
            ExtrapolatorError::NotFinite => Self::ImuSampleNotFinite,
            ExtrapolatorError::OlderThanLastPose | ExtrapolatorError::OutOfOrder => Self::ImuSampleTooOld,
        }
    }

    /// The kind in reports, which has its text and severity.
    pub fn kind(self) -> IssueKind {
        match self {
            Self::ImuSampleTooOld => IssueKind::ImuSampleTooOld,
            Self::ImuSampleNotFinite => IssueKind::ImuSampleNotFinite,
            Self::ImuAfterStart => IssueKind::ImuAfterStart,
            Self::OdometryTooOld => IssueKind::OdometryTooOld,
            Self::EmptySweep => IssueKind::ScanWithoutReturn,
            Self::SweepTooOld => IssueKind::ScanTooOld,
            Self::GyroscopeOverruled => IssueKind::GyroscopeOverruled,
            Self::OdometryOverruled => IssueKind::OdometryOverruled,
            Self::NoPlaneFits => IssueKind::ScanFitsNoPlane,
            Self::ContradictsMap => IssueKind::ScanContradictsMap,
            Self::PlaceHidden => IssueKind::ScanOccluded,
            Self::TravelGuessed => IssueKind::TravelGuessed,
            Self::GapUncertain => IssueKind::GapUncertain,
        }
    }
}

/// Number of occurrences of each issue.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Issues {
    counts: BTreeMap<Issue, u64>,
}

impl Issues {
    /// Counts an issue once more.
    pub fn count(&mut self, issue: Issue) {
        *self.counts.entry(issue).or_default() += 1;
    }

    /// Adds the counts of others.
    pub fn add(&mut self, others: &Self) {
        others.iter().for_each(|(issue, count)| *self.counts.entry(issue).or_default() += count);
    }

    /// All issues that occurred, with their counts.
    pub fn iter(&self) -> impl Iterator<Item = (Issue, u64)> + '_ {
        self.counts.iter().map(|(issue, count)| (*issue, *count))
    }

    /// Count of one issue.
    pub fn of(&self, issue: Issue) -> u64 {
        self.counts.get(&issue).copied().unwrap_or_default()
    }
}
