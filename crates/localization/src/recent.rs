//! Keeps the last scans along the path.

use std::collections::VecDeque;

use portolan_geometry::{Rigid3, Time};

use crate::settings::scans::{KEPT_SCAN_METRES, KEPT_SCANS, NEW_VIEW_RADIANS};

/// A scan that is kept for judging places.
#[derive(Clone, Debug)]
pub(crate) struct KeyScan<S> {
    pub time: Time,
    pub local_from_scan: Rigid3,
    pub scan: S,
}

/// The last scans along the path, oldest first.
#[derive(Clone, Debug)]
pub struct RecentScans<S> {
    scans: VecDeque<KeyScan<S>>,
}

impl<S> Default for RecentScans<S> {
    fn default() -> Self {
        Self { scans: VecDeque::new() }
    }
}

/// Result of offering a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Offered {
    /// It is like the last one and is dropped.
    LeftOut,
    /// It is kept; `oldest_left` if the oldest one was dropped for it.
    Kept { oldest_left: bool },
}

/// Whether the scanner hardly moved between two poses.
pub(crate) fn is_alike(a: &Rigid3, b: &Rigid3) -> bool {
    let motion = a.inverse() * b;
    motion.translation.vector.norm() < KEPT_SCAN_METRES && motion.rotation.angle() < NEW_VIEW_RADIANS
}

impl<S> RecentScans<S> {
    pub(crate) fn offer(&mut self, scan: KeyScan<S>) -> Offered {
        if let Some(last) = self.scans.back()
            && is_alike(&last.local_from_scan, &scan.local_from_scan)
        {
            return Offered::LeftOut;
        }
        self.scans.push_back(scan);
        let oldest_left = self.scans.len() > KEPT_SCANS;
        if oldest_left {
            self.scans.pop_front();
        }
        Offered::Kept { oldest_left }
    }

    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = &KeyScan<S>> + ExactSizeIterator {
        self.scans.iter()
    }

    pub(crate) fn clear(&mut self) {
        self.scans.clear();
    }

    /// Forgets scans before a time.
    pub(crate) fn forget_before(&mut self, time: Time) {
        self.scans.retain(|scan| scan.time >= time);
    }

    /// Distance and rotation from the first kept scan to the last, metres and radians, along the kept scans.
    pub(crate) fn motion(&self) -> (f64, f64) {
        let steps = self.scans.iter().zip(self.scans.iter().skip(1));
        steps.fold((0.0, 0.0), |(metres, turn), (a, b)| {
            let step = a.local_from_scan.inverse() * b.local_from_scan;
            (metres + step.translation.vector.norm(), turn + step.rotation.angle())
        })
    }

    /// The kept scans with their poses in the frame of the newest, the newest first.
    pub fn seen_from_newest(&self) -> impl Iterator<Item = (Rigid3, &S)> {
        let newest = self.scans.back().map_or_else(Rigid3::identity, |scan| scan.local_from_scan);
        self.scans.iter().rev().map(move |kept| (newest.inverse() * kept.local_from_scan, &kept.scan))
    }
}
