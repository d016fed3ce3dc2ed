//! When scans support, question or refute a place (`evidence.rs`), and which scans are trusted once the
//! whole recording is known (`trust.rs`).

use super::search::CONFIRMING_SEARCHES;
use super::tracking::SURE_CHECK_SECONDS;

/// Minimum fraction of the beams of a scan that the map explains for the scan to support the place.
pub(crate) const SUPPORTING_FRACTION: f32 = 0.45;
/// Maximum fraction contradicted, of the beams about which the map knows something, for a scan to support
/// the place.
pub(crate) const MOST_CONTRADICTED: f32 = 0.35;
/// Minimum fraction contradicted, of the beams about which the map knows something, for a scan to contradict
/// the place.
pub(crate) const CONTRADICTING_FRACTION: f32 = 0.5;
/// Fraction of beams, explained or contradicted, below which the map knows too little for a verdict.
pub(crate) const LEAST_KNOWN_FRACTION: f32 = 0.25;
/// Duration of supporting scans that raises support from none to full, seconds.
pub(crate) const SECONDS_TO_SUPPORT: f64 = 1.5;
/// Duration of contradicting scans that lowers support from full to none, seconds.
pub(crate) const SECONDS_TO_CONTRADICT: f64 = 1.6;
/// Duration of scans without a clear verdict that lowers support from full to none, seconds.
pub(crate) const SECONDS_WITHOUT_VERDICT: f64 = 6.0;
/// Maximum change of support by one scan, as a fraction of full support, however long the gap before it.
pub(crate) const MAX_CHANGE_PER_SCAN: f64 = 0.25;
/// Support from which the place is known again.
pub(crate) const SURE_SUPPORT: f64 = 0.7;
/// Support below which the place is no longer known.
pub(crate) const UNSURE_SUPPORT: f64 = 0.4;
/// Limit of the support when other evidence questions the place: just below [`UNSURE_SUPPORT`].
pub(crate) const QUESTIONED_SUPPORT: f64 = 0.9 * UNSURE_SUPPORT;
/// Number of contradicting scans after which a place without support is lost.
pub(crate) const SCANS_TO_LOSE: u32 = 4;

/// Minimum distance travelled in a run of localised scans for the run to be trusted, metres.
pub(crate) const LEAST_TRUSTED_METRES: f64 = 5.0;
/// Time before the place became uncertain from which scans are not trusted, seconds: contradictions are
/// noticed after about a second.
pub(crate) const UNTRUSTED_BEFORE_UNCERTAIN: f64 = 2.0;
/// Time before the place was lost from which scans are not trusted, seconds: a place is given up after
/// several searches of the whole map.
pub(crate) const UNTRUSTED_BEFORE_LOSS: f64 = CONFIRMING_SEARCHES as f64 * SURE_CHECK_SECONDS;
/// Difference between the motion in the map and that of local SLAM, from one scan to the next, above which
/// the place before was wrong, metres.
pub(crate) const MOST_TRUSTED_STEP: f64 = 0.25;
/// Maximum mean contradicted fraction, of what the map knows there, for scans of a place to be trusted.
/// Single scans may contradict [`MOST_CONTRADICTED`] and still support a place.
pub(crate) const MOST_TRUSTED_CONTRADICTED: f64 = 0.25;
