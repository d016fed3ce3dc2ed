//! Reports why no scan of a recording could be used.

use std::fmt;

use portolan_geometry::Point3f;
use portolan_issue::{Issue, IssueLog};
use portolan_numeric::{counted, median};
use portolan_sensor::Measurement;

/// Number of scans, the first ones, of which distances are sampled.
const SCANS: u64 = 100;
/// Number of returns sampled in each of these scans.
const RETURNS: usize = 200;
/// Maximum number of kinds of issues that are reported.
const KINDS: usize = 3;

/// Counts the scans of a recording and their returns.
#[derive(Clone, Debug, Default)]
pub struct ScanTally {
    scans: u64,
    returns: u64,
    /// Distances of some returns of the first scans, metres.
    distances: Vec<f64>,
}

impl ScanTally {
    /// Adds a measurement.
    pub fn add(&mut self, measurement: &Measurement) {
        let Measurement::Range(scan) = measurement else { return };
        self.scans += 1;
        let points = &scan.points_in_tracking;
        self.returns += points.len() as u64;
        if self.scans <= SCANS {
            let distance = |point: &Point3f| f64::from((point - scan.origin_in_tracking).norm());
            let stride = points.len().div_ceil(RETURNS).max(1);
            self.distances.extend(points.iter().step_by(stride).map(|point| distance(&point.position)));
        }
    }

    /// Result: what is known about why no scan could be used.
    pub fn verdict(mut self, issues: &IssueLog) -> UnusableScans {
        let median_metres = median(&mut self.distances).filter(|metres| metres.is_finite());
        let mut lost: Vec<Issue> = issues.iter().filter(Issue::lost_data).collect();
        lost.sort_by_key(|issue| std::cmp::Reverse(issue.count));
        lost.truncate(KINDS);
        UnusableScans { scans: self.scans, returns: self.returns, median_metres, lost }
    }
}

/// Why no scan could be used, as far as known.
#[derive(Clone, Debug)]
pub struct UnusableScans {
    /// Scans that were read.
    pub scans: u64,
    /// Returns in all of them.
    pub returns: u64,
    /// Median distance of the returns of the first scans, metres.
    pub median_metres: Option<f64>,
    /// The most frequent issues with loss of data.
    pub lost: Vec<Issue>,
}

impl fmt::Display for UnusableScans {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scans = counted(self.scans, "scan that was read", "scans that were read");
        match self.scans {
            0 => write!(f, "not a single scan could be read")?,
            _ => write!(f, "not a single one of {scans} could be used")?,
        }
        if self.scans > 0 && self.returns == 0 {
            write!(f, ": none has a return")?;
        } else if let Some(metres) = self.median_metres {
            write!(
                f,
                ": half of their returns are farther than {metres:.3} m from the lidar (if they are not, ranges are in another unit than \
                 metres)"
            )?;
        }
        for issue in &self.lost {
            write!(f, "; {} ({}x)", issue.text(), issue.count)?;
        }
        Ok(())
    }
}
