//! Whether a registration can be trusted: scans that do not overlap come to rest somewhere, too.

use portolan_registration::{IcpOptions, IcpResult};

/// Least fraction of the points of a scan that have a partner.
const LEAST_SHARE: f64 = 0.2;
/// Of pairs that are each the nearest of the other there are fewer.
const RECIPROCAL: f64 = 0.5;
/// Pairs of surfaces that have nothing to do with each other lie this fraction of the greatest distance apart, or more.
/// Evenly spread distances would give 0.58; matching draws them together as far as it can.
const CHANCE: f64 = 0.36;

/// What speaks against a result; nothing if it can be trusted. The scan has so many points.
pub fn reason_for_distrust(result: &IcpResult, points: usize, icp: &IcpOptions) -> Option<String> {
    let asked = points as f64 / icp.every.max(1) as f64 * icp.keep;
    let least = if icp.reciprocal { RECIPROCAL * LEAST_SHARE } else { LEAST_SHARE };
    let share = result.pairs as f64 / asked.max(1.0);
    if share < least {
        return Some(format!(
            "only {:.0} % of its points lie within {} m of the scans before it",
            100.0 * share,
            icp.max_distance
        ));
    }
    if !result.converged {
        return Some("it did not come to rest".to_owned());
    }
    (result.rms > CHANCE * icp.max_distance).then(|| {
        format!(
            "its pairs lie {:.3} m apart, which is what chance gives within --max-distance {}",
            result.rms, icp.max_distance
        )
    })
}
