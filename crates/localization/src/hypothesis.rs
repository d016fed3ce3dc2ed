//! Places where the scanner may be, and which of them what was seen speaks for.

use std::collections::VecDeque;

use portolan_geometry::Rigid3;
use portolan_matching::ScanAgreement;

use crate::belief::Belief;
use crate::known_map::{KnownMap, ScanMatch, Window};
use crate::recent::{KEPT, RecentScans};

/// Scans are looked for within so many standard deviations of their prediction, and within these bounds, metres and
/// radians.
const WITHIN_SIGMAS: f64 = 3.0;
const NARROWEST: Window = Window { metres: 0.1, radians: 0.03 };
const WIDEST: Window = Window { metres: 1.5, radians: 0.6 };
/// A match that lies farther from its prediction is none: the square of a Mahalanobis distance in three dimensions.
const GATE: f64 = 25.0;
/// What is known of a place that was just proposed: standard deviations, metres and radians.
const PROPOSED: (f64, f64) = (0.1, 0.02);
/// Where earlier scans of the way are looked for.
const ON_THE_WAY: Window = Window { metres: 0.1, radians: 0.03 };
/// Places nearer to each other, metres and radians, are the same.
const SAME_PLACE: (f64, f64) = (0.6, 0.2);

/// The way that is remembered, in kept scans: some 25 m.
const PATH: usize = 64;

/// How well what was seen fits a place: shares of beams explained less contradicted, the mean of recent scans.
pub(crate) fn fit(agreement: &ScanAgreement) -> f64 {
    f64::from(agreement.explained - agreement.contradicted())
}

/// A place where the scanner may be.
#[derive(Clone, Debug)]
pub(crate) struct Hypothesis {
    pub belief: Belief,
    /// What the map says to the newest scan that was matched.
    pub agreement: ScanAgreement,
    /// How well each scan that was kept fits, along the whole way since it was proposed, oldest first; at most [`PATH`].
    fits: VecDeque<f64>,
}

impl Hypothesis {
    /// The place where the newest of the recent scans lies at `map_from_scan`: finds the others from there back along
    /// the way.
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
            let here = map.find(&kept.scan, &guess, ON_THE_WAY);
            fits.push_front(fit(&here.agreement));
            found.get_or_insert(here);
            (place, after) = (here.pose, kept);
        }
        let found: ScanMatch = found?;
        let belief = Belief::new(found.pose, M::FREEDOM, PROPOSED.0, PROPOSED.1);
        Some(Self { belief, agreement: found.agreement, fits })
    }

    /// Remembers what the map says to a scan that is kept.
    pub fn remember(&mut self) {
        self.fits.push_back(fit(&self.agreement));
        if self.fits.len() > PATH {
            self.fits.pop_front();
        }
    }

    /// How well the recent scans fit: their mean.
    pub fn fit(&self) -> f64 {
        let recent = self.fits.len().min(KEPT);
        self.fits.iter().rev().take(KEPT).sum::<f64>() / recent.max(1) as f64
    }

    /// By how much the scans fit better here than at another place: the same scans at both, the recent ones or those of the
    /// whole common way, whichever says more. Scans are kept after equal ways, so that their log likelihood ratios add up;
    /// the sum is told in units of the recent ones: what leads a little all along leads as much as what leads clearly now.
    pub fn lead_over(&self, other: &Self) -> f64 {
        let pairs = self.fits.iter().rev().zip(other.fits.iter().rev());
        let (count, sum) = pairs.fold((0, 0.0), |(n, sum), (own, others)| (n + 1, sum + own - others));
        let recent = self.fit() - other.fit();
        if count > KEPT { recent.max(sum / KEPT as f64) } else { recent }
    }

    /// Takes over the pose of a proposal that is the same place and fits better, without forgetting the way before.
    pub fn renew(&mut self, proposal: Self) {
        let before = self.fits.len().saturating_sub(proposal.fits.len());
        let known = std::mem::replace(self, proposal);
        for fit in known.fits.iter().take(before).rev() {
            self.fits.push_front(*fit);
        }
    }

    /// Goes along with local SLAM, without looking.
    pub fn predict(&mut self, motion: &Rigid3, seconds: f64) {
        self.belief.predict(motion, seconds);
    }

    /// Finds a scan near the prediction.
    pub fn look<M: KnownMap>(&mut self, map: &M, scan: &M::Scan) {
        let found = map.find(scan, &self.belief.pose, self.window());
        if self.belief.distance(&found.pose, &found.information) < GATE {
            self.belief.update(&found.pose, &found.information);
        }
        // What decides is the pose that is told, not the one that fits best.
        self.agreement = map.agreement(scan, &self.belief.pose);
    }

    /// Is where the newest scan was found, far from the prediction, with these standard deviations (metres, radians).
    pub fn slip<M: KnownMap>(&mut self, found: &ScanMatch, (metres, radians): (f64, f64)) {
        self.belief = Belief::new(found.pose, M::FREEDOM, metres, radians);
        self.agreement = found.agreement;
    }

    fn window(&self) -> Window {
        let (metres, radians) = self.belief.sigmas();
        Window {
            metres: (WITHIN_SIGMAS * metres).clamp(NARROWEST.metres, WIDEST.metres),
            radians: (WITHIN_SIGMAS * radians).clamp(NARROWEST.radians, WIDEST.radians),
        }
    }

    /// Whether both are one place.
    pub fn is_same_place(&self, other: &Self) -> bool {
        self.is_at(&other.belief.pose)
    }

    /// Whether a pose is that of this place.
    pub fn is_at(&self, b: &Rigid3) -> bool {
        let a = &self.belief.pose;
        (a.translation.vector - b.translation.vector).norm() < SAME_PLACE.0
            && a.rotation.angle_to(&b.rotation) < SAME_PLACE.1
    }
}
