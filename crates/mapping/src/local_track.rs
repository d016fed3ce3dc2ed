//! Result of local SLAM for a recording that was localised in a map, to be added to that map.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Rigid3, Time};
use portolan_sensor::ImuData;

use crate::{InsertedNode, InsertionSubmap, MatchingResult, Space};

/// What is known of the pose of a node in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placement {
    /// No accepted pose.
    Unknown,
    /// Its pose (`map_from_tracking`), propagated by local SLAM and not reliable.
    Carried(Rigid3),
    /// Its pose (`map_from_tracking`), as accurate as a match to the map.
    Found(Rigid3),
}

impl Placement {
    /// The pose of the tracking frame in the map, if it is known.
    pub fn map_from_tracking(&self) -> Option<Rigid3> {
        match self {
            Self::Unknown => None,
            Self::Carried(pose) | Self::Found(pose) => Some(*pose),
        }
    }
}

/// A node of local SLAM, with its localised pose.
#[derive(Clone, Debug)]
pub struct TrackedNode<S: Space> {
    /// As local SLAM inserted it.
    pub inserted: InsertedNode<S>,
    /// Nodes with the same number belong to the same local map.
    pub piece: u32,
    /// Its pose in the map.
    pub placement: Placement,
}

impl<S: Space> TrackedNode<S> {
    /// Time of its scan.
    pub fn time(&self) -> Time {
        self.inserted.data.time
    }
}

/// Nodes and submaps of local SLAM, one local map after the other, with the localised poses of nodes.
#[derive(Clone, Debug)]
pub struct LocalTrack<S: Space> {
    nodes: Vec<TrackedNode<S>>,
    submaps: BTreeMap<(u32, u32), Arc<S::Submap>>,
    imu: Vec<ImuData>,
    piece: u32,
}

impl<S: Space> Default for LocalTrack<S> {
    fn default() -> Self {
        Self { nodes: Vec::new(), submaps: BTreeMap::new(), imu: Vec::new(), piece: 0 }
    }
}

impl<S: Space> LocalTrack<S> {
    /// Adds the result of a scan, with its localised pose.
    pub fn add(&mut self, scan: &MatchingResult<S>, placement: Placement) {
        if let Some(lost) = &scan.lost {
            self.take_submaps(&lost.remaining);
            self.piece += 1;
        }
        if let Some(inserted) = &scan.inserted {
            self.take_submaps(&inserted.submaps);
            self.nodes.push(TrackedNode { inserted: inserted.clone(), piece: self.piece, placement });
        }
    }

    /// Adds an IMU sample; kept where the optimisation uses it.
    pub fn add_imu(&mut self, data: &ImuData) {
        if S::OPTIMIZES_WITH_IMU {
            self.imu.push(*data);
        }
    }

    /// Adds the submaps that were being filled at the end.
    pub fn finish(&mut self, remaining: &[InsertionSubmap<S>]) {
        self.take_submaps(remaining);
    }

    /// Its nodes, in order of time.
    pub fn nodes(&self) -> &[TrackedNode<S>] {
        &self.nodes
    }

    /// Updates the placement of nodes.
    pub fn judge(&mut self, judge: impl Fn(&TrackedNode<S>) -> Placement) {
        for node in &mut self.nodes {
            node.placement = judge(node);
        }
    }

    /// Complete submaps, by their pieces and by their indices in these.
    pub fn submaps(&self) -> &BTreeMap<(u32, u32), Arc<S::Submap>> {
        &self.submaps
    }

    /// Samples of the IMU, in order of time.
    pub fn imu(&self) -> &[ImuData] {
        &self.imu
    }

    fn take_submaps(&mut self, submaps: &[InsertionSubmap<S>]) {
        for submap in submaps {
            if let Some(grid) = &submap.finished {
                self.submaps.insert((self.piece, submap.index), Arc::clone(grid));
            }
        }
    }
}
