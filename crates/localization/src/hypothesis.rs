//! Hypotheses about the pose in the map, and how well recent scans fit each.

use std::collections::VecDeque;

use portolan_geometry::Rigid3;
use portolan_grids::ScanAgreement;

use crate::belief::PoseEstimate;
use crate::known_map::{KnownMap, ScanMatch, Window};
use crate::recent::RecentScans;
use crate::settings::matching::{GATE_SQUARED_SIGMAS, NARROWEST_WINDOW, WIDEST_WINDOW, WINDOW_SIGMAS};
use crate::settings::scans::KEPT_SCANS;
use crate::settings::search::{PROPOSED_SIGMAS, SAME_PLACE};

/// Fit of a place: fraction of beams explained minus fraction contradicted.
pub(crate) fn fit(agreement: &ScanAgreement) -> f64 {
    f64::from(agreement.explained - agreement.contradicted())
}

/// A hypothesis about the pose of the scanner.
#[derive(Clone, Debug)]
pub(crate) struct Hypothesis {
    pub belief: PoseEstimate,
    /// Agreement of the map with the newest scan that was matched.
    pub agreement: ScanAgreement,
    /// Agreement of the map with the recent scans, and the poses where they were found, oldest first.
    fits: VecDeque<(ScanAgreement, Rigid3)>,
}

impl Hypothesis {
    /// The place at which the newest of the recent scans has the pose `map_from_scan`; finds the earlier
    /// scans from there back along the path.
    pub fn along<M: KnownMap>(
        map: &M,
        recent: &RecentScans<M::Scan>,
        map_from_scan: &Rigid3,
    ) -> Option<Self> {
        let mut after = recent.iter().next_back()?;
        let mut place = *map_from_scan;
        let mut fits = VecDeque::new();
        let mut found = None;
        for kept in recent.iter().rev() {
            let guess = place * (after.local_from_scan.inverse() * kept.local_from_scan);
            let here = map.find(&kept.scan, &guess, NARROWEST_WINDOW);
            fits.push_front((here.agreement, here.pose));
            found.get_or_insert(here);
            (place, after) = (here.pose, kept);
        }
        let found: ScanMatch = found?;
        let belief = PoseEstimate::new(found.pose, M::FREEDOM, map.error(), PROPOSED_SIGMAS);
        Some(Self { belief, agreement: found.agreement, fits })
    }

    /// Stores the agreement and pose of a scan that is kept.
    pub fn remember(&mut self, oldest_left: bool) {
        self.fits.push_back((self.agreement, self.belief.pose));
        if oldest_left {
            self.fits.pop_front();
        }
    }

    /// Mean fit of the recent scans.
    pub fn fit(&self) -> f64 {
        self.fits.iter().map(|(seen, _)| fit(seen)).sum::<f64>() / self.fits.len().max(1) as f64
    }

    /// Lead in fit over another place: the least of the means over the recent scans and over the newest half
    /// and quarter of them. A place that the scanner has just entered does not fit the scans before.
    pub fn lead(&self, other: &Self) -> f64 {
        self.lead_of_newest(other, usize::MAX)
    }

    /// The same lead, over the newest `scans` scans only.
    pub fn lead_of_newest(&self, other: &Self, scans: usize) -> f64 {
        let differences = self.fits.iter().rev().zip(other.fits.iter().rev()).take(scans);
        let differences: Vec<f64> = differences.map(|(own, other)| fit(&own.0) - fit(&other.0)).collect();
        let mean = |scans: usize| {
            let newest = differences.get(..scans).unwrap_or(&differences);
            newest.iter().sum::<f64>() / newest.len().max(1) as f64
        };
        [KEPT_SCANS / 4, KEPT_SCANS / 2, KEPT_SCANS].into_iter().map(mean).fold(f64::INFINITY, f64::min)
    }

    /// Poses where the recent scans were found, the newest first.
    pub fn found(&self) -> impl Iterator<Item = &Rigid3> {
        self.fits.iter().rev().map(|(_, pose)| pose)
    }

    /// Mean fit of the newest `scans` scans.
    pub fn fit_of_newest(&self, scans: usize) -> f64 {
        let scans = scans.min(self.fits.len());
        self.fits.iter().rev().take(scans).map(|(seen, _)| fit(seen)).sum::<f64>() / scans.max(1) as f64
    }

    /// The least of the mean fits of the recent scans, of the newest half and of the newest quarter of them.
    pub fn fit_lately(&self) -> f64 {
        [KEPT_SCANS / 4, KEPT_SCANS / 2, KEPT_SCANS]
            .map(|scans| self.fit_of_newest(scans))
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }

    /// Moves along with local SLAM, without matching.
    pub fn predict(&mut self, motion: &Rigid3, seconds: f64) {
        self.belief.predict(motion, seconds);
    }

    /// Matches a scan near the prediction and updates the pose.
    pub fn match_scan<M: KnownMap>(&mut self, map: &M, scan: &M::Scan) {
        let found = map.find(scan, &self.belief.pose, self.window());
        let distance = self.belief.distance(&found.pose, &found.information);
        self.belief.note_distance(distance);
        if distance < GATE_SQUARED_SIGMAS {
            self.belief.update(&found.pose, &found.information);
        }
        // The estimated pose is judged, not the match that fits best.
        self.agreement = map.agreement(scan, &self.belief.pose);
    }

    /// Moves the estimate to a match of the newest scan far from the prediction, with these standard
    /// deviations (metres, radians).
    pub fn move_to(&mut self, found: &ScanMatch, sigmas: (f64, f64)) {
        self.belief = self.belief.elsewhere(found.pose, sigmas);
        self.agreement = found.agreement;
    }

    fn window(&self) -> Window {
        let (metres, radians) = self.belief.sigmas();
        Window {
            metres: (WINDOW_SIGMAS * metres).clamp(NARROWEST_WINDOW.metres, WIDEST_WINDOW.metres),
            radians: (WINDOW_SIGMAS * radians).clamp(NARROWEST_WINDOW.radians, WIDEST_WINDOW.radians),
        }
    }

    /// Whether both are one place.
    pub fn is_same_place(&self, other: &Self) -> bool {
        self.is_at(&other.belief.pose)
    }

    /// Whether a pose is that of this place.
    pub fn is_at(&self, b: &Rigid3) -> bool {
        let a = &self.belief.pose;
        (a.translation.vector - b.translation.vector).norm() < SAME_PLACE.metres
            && a.rotation.angle_to(&b.rotation) < SAME_PLACE.radians
    }
}

/// A place along x with these fits of scans, the oldest first.
#[cfg(test)]
pub(crate) fn test_place(x: f64, fits: &[f32]) -> Hypothesis {
    let agreement = |fit: &f32| ScanAgreement { explained: *fit, ..ScanAgreement::default() };
    let pose = Rigid3::translation(x, 0.0, 0.0);
    let belief = PoseEstimate::new(
        pose,
        crate::belief::Freedom::TwoD,
        crate::settings::maps::USUAL_MAP_ERROR,
        PROPOSED_SIGMAS,
    );
    Hypothesis {
        belief,
        agreement: fits.last().map(agreement).unwrap_or_default(),
        fits: fits.iter().map(|fit| (agreement(fit), pose)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lead_counts_only_if_it_lasts() {
        let steady = test_place(0.0, &[0.8; 12]);
        let behind = test_place(5.0, &[0.5; 12]);
        assert!((steady.lead(&behind) - 0.3).abs() < 1e-6 && (behind.lead(&steady) + 0.3).abs() < 1e-6);
        // Behind by 0.45 over all scans, and by nothing over the newest quarter.
        let mut fits = [0.2; 12];
        fits[9..].fill(0.8);
        let entered = test_place(5.0, &fits);
        assert!(steady.lead(&entered).abs() < 1e-6);
        assert!(entered.fit() < 0.4 && (entered.fit_of_newest(3) - 0.8).abs() < 1e-6);
        assert!((entered.fit_lately() - entered.fit()).abs() < 1e-6);
        assert!((entered.lead_of_newest(&steady, 2)).abs() < 1e-6);
    }
}
