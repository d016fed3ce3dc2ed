//! When a place is supported, in doubt and lost (`evidence.rs`), and what is believed once all is known (`trust.rs`).

use super::search::CONFIRMING_SEARCHES;
use super::tracking::SURE_CHECK_SECONDS;

/// A scan supports the place if the map explains at least this fraction of its beams …
pub(crate) const SUPPORTING_FRACTION: f32 = 0.45;
/// … and contradicts at most this fraction of what it knows; …
pub(crate) const MOST_CONTRADICTED: f32 = 0.35;
/// … it speaks against it if the map contradicts so much of what it knows, …
pub(crate) const CONTRADICTING_FRACTION: f32 = 0.5;
/// … where it knows at least this fraction.
pub(crate) const LEAST_KNOWN_FRACTION: f32 = 0.25;
/// So many seconds of scans that support bring full support, …
pub(crate) const SECONDS_TO_SUPPORT: f64 = 1.5;
/// … so many that contradict take it all, …
pub(crate) const SECONDS_TO_CONTRADICT: f64 = 1.6;
/// … and so many that say nothing clear.
pub(crate) const SECONDS_OF_NOTHING: f64 = 6.0;
/// A scan counts for at most so much of the whole support, however long nothing came before it.
pub(crate) const MOST_OF_ONE_SCAN: f64 = 0.25;
/// Above this support the place is known again, …
pub(crate) const SURE_SUPPORT: f64 = 0.7;
/// … below this not any more.
pub(crate) const UNSURE_SUPPORT: f64 = 0.4;
/// What is left of support when something else makes the place doubtful.
pub(crate) const DOUBTED_SUPPORT: f64 = 0.9 * UNSURE_SUPPORT;
/// With no support left it is lost after so many scans that spoke against it.
pub(crate) const SCANS_TO_LOSE: u32 = 4;

/// What a recording that was localised for less way than this, metres, says of the map is not believed.
pub(crate) const LEAST_TRUSTED_METRES: f64 = 5.0;
/// Where the place came to be in doubt, scans this long before are doubted, seconds: it takes about a second of contradictions to
/// notice …
pub(crate) const DOUBTED_BEFORE_DOUBT: f64 = 2.0;
/// … and up to the searches of the whole map until a place is given up.
pub(crate) const DOUBTED_BEFORE_LOSS: f64 = CONFIRMING_SEARCHES as f64 * SURE_CHECK_SECONDS;
/// A place that goes another way than local SLAM from one scan to the next by more than this, metres, was wrong before.
pub(crate) const MOST_TRUSTED_STEP: f64 = 0.25;
/// Scans of a place that contradict more than this fraction of what the map knows there, in the mean, are not believed: single ones
/// may contradict [`MOST_CONTRADICTED`] and still support a place.
pub(crate) const MOST_TRUSTED_CONTRADICTED: f64 = 0.25;
