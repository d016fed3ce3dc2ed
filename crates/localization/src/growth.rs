//! Adds a recording to the map in which it was localised.

use portolan_geometry::Time;
use portolan_mapping::{Extension, LocalTrack, Placement, PoseGraph, TrackedNode, TrajectoryId};

use crate::known_map::KnownMap;
use crate::renewal::Renewal;
use crate::state::{Estimate, State};
use crate::trust::trusted_spans;
use crate::voxel_changes::KeptSweep;

/// How a recording changes the map in which it was localised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Growth {
    /// All localised scans are added; the rest of the map stays unchanged.
    Extend,
    /// Submaps that show a change, or something new, are added; submaps that they replace are removed.
    Renew,
}

/// Result of adding a recording to a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grown {
    /// The trajectory that was added. If a map was renewed and nothing had changed, it is removed again.
    pub trajectory_id: TrajectoryId,
    /// Number of nodes whose localisation is trusted.
    pub trusted_nodes: usize,
    /// Number of all nodes.
    pub nodes: usize,
    /// What was added before the renewal.
    pub extension: Extension,
    /// What of it stayed and what it replaced, if the map was renewed.
    pub renewal: Option<Renewal>,
}

/// Why nothing is added to a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GrowthError {
    /// No scan was localised.
    #[error("it was never localised in the map")]
    NeverLocalised,
    /// It was not localised far enough, or its localisation was always called into question soon after.
    #[error(
        "it was localised, but on no path of 5 m or more without contradictions soon after, so that none of its poses \
         is trusted; record a longer path through parts that the map contains"
    )]
    NothingTrusted,
}

/// Adds a recording to the pose graph of the map that it was localised in.
pub(crate) fn grow<M: KnownMap>(
    map: &M,
    graph: &mut PoseGraph<M::Space>,
    (track, sweeps): (LocalTrack<M::Space>, &[KeptSweep]),
    estimates: &[Estimate],
    growth: Growth,
) -> Result<Grown, GrowthError> {
    if !estimates.iter().any(|e| e.state == State::Localised) {
        return Err(GrowthError::NeverLocalised);
    }
    let mut track = track;
    let spans = trusted_spans(estimates);
    let is_trusted = |time: Time| spans.iter().any(|(first, last)| (*first..=*last).contains(&time));
    track.judge(|node: &TrackedNode<M::Space>| match node.placement {
        _ if !is_trusted(node.time()) => Placement::Unknown,
        Placement::Carried(_) if growth == Growth::Renew => Placement::Unknown,
        placement => placement,
    });
    let last = graph.state().trajectories.keys().next_back();
    let trajectory_id = TrajectoryId(last.map_or(0, |id| id.0.saturating_add(1)));
    let extension = graph.extend(trajectory_id, &track).ok_or(GrowthError::NothingTrusted)?;
    let renewal = match growth {
        Growth::Extend => None,
        Growth::Renew => {
            let sweeps: Vec<&KeptSweep> = sweeps.iter().filter(|sweep| is_trusted(sweep.time)).collect();
            Some(map.renew(graph, trajectory_id, &sweeps))
        }
    };
    let trusted = track.nodes().iter().filter(|node| node.placement != Placement::Unknown);
    Ok(Grown {
        trajectory_id,
        trusted_nodes: trusted.count(),
        nodes: track.nodes().len(),
        extension,
        renewal,
    })
}
