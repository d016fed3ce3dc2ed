//! Faults of the data that were repaired or left out: counted, and named.

use std::collections::BTreeMap;

use portolan_issue::IssueKind;
use portolan_motion::ExtrapolatorError;

/// What was wrong with a measurement.
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
    /// A sweep that fits where the platform is without odometry, and not where odometry says; odometry was not used.
    OdometryOverruled,
    /// A sweep that fits no plane; its pose is predicted, or another map's.
    NoPlaneFits,
    /// A sweep that contradicts the map; the map is not shown it.
    ContradictsMap,
    /// A sweep in which something hides the place; it was left out.
    PlaceHidden,
    /// A sweep before which nothing had told for seconds how far it went: constant velocity was assumed.
    TravelGuessed,
}

impl Issue {
    /// Why an IMU sample was left out before the trajectory began.
    pub fn of_imu_sample(error: ExtrapolatorError) -> Self {
        match error {
            ExtrapolatorError::NotFinite => Self::ImuSampleNotFinite,
            ExtrapolatorError::OlderThanLastPose | ExtrapolatorError::OutOfOrder => Self::ImuSampleTooOld,
        }
    }

    /// The kind that reports know it by, which has its text and severity.
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
        }
    }
}

/// How often each issue occurred.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Issues {
    counts: BTreeMap<Issue, u64>,
}

impl Issues {
    /// Counts an issue once more.
    pub fn count(&mut self, issue: Issue) {
        *self.counts.entry(issue).or_default() += 1;
    }

    /// Counts all of these, too.
    pub fn add(&mut self, others: &Self) {
        others.iter().for_each(|(issue, count)| *self.counts.entry(issue).or_default() += count);
    }

    /// All issues that occurred, and how often.
    pub fn iter(&self) -> impl Iterator<Item = (Issue, u64)> + '_ {
        self.counts.iter().map(|(issue, count)| (*issue, *count))
    }

    /// How often one occurred.
    pub fn of(&self, issue: Issue) -> u64 {
        self.counts.get(&issue).copied().unwrap_or_default()
    }
}
