//! Decides whether a registration can be trusted: ICP converges for scans that do not overlap, too.

use portolan_registration::{IcpOptions, IcpResult};

/// Minimum fraction of the points of a scan that have a partner.
const LEAST_SHARE: f64 = 0.2;
/// Factor for that fraction with reciprocal pairs, each the nearest of the other, of which there are fewer.
const RECIPROCAL: f64 = 0.5;
/// Root mean square distance of the pairs from which they count as unrelated, as a fraction of the maximum
/// pair distance. Evenly spread distances would give 0.58; matching reduces them as far as it can.
const CHANCE: f64 = 0.36;

/// Reason not to trust a result; none if it can be trusted. `points`: number of points of the scan.
pub fn reason_for_distrust(result: &IcpResult, points: usize, icp: &IcpOptions) -> Option<String> {
    let asked = points as f64 / icp.every.max(1) as f64 * icp.keep;
    let least = if icp.reciprocal { RECIPROCAL * LEAST_SHARE } else { LEAST_SHARE };
    let share = result.pairs as f64 / asked.max(1.0);
    if share < least {
        return Some(format!(
            "only {:.0} % of its points are within {} m of the scans before it",
            100.0 * share,
            icp.max_distance
        ));
    }
    if !result.converged {
        return Some("matching did not converge".to_owned());
    }
    (result.rms > CHANCE * icp.max_distance).then(|| {
        format!(
            "its point pairs are {:.3} m apart, as those of unrelated scans would be within --max-distance {}",
            result.rms, icp.max_distance
        )
    })
}
