//! Writes the results of mapping.

use std::path::PathBuf;

use portolan_export::{ConstraintLine, MapContent, TrajectoryLine, write_tum};
use portolan_mapfile::{MapFileSpace, PlacedTexture, submap_textures_2d, submap_textures_3d, write_map};
use portolan_mapping::{Map, Space, Space2d, Space3d, TrajectoryId};

use super::error::{JobError, write_file};
use super::event::{Event, Observer, Remark, remark};
use super::memory::resident_and_peak_bytes;
use super::output_folder::OutputFolder;
use super::pictures::write_pictures;
use super::report::report;
use crate::known_places::KnownMapSpace;
use crate::pipeline::MappedRecording;

/// A space whose maps can be drawn from above.
pub trait ResultSpace: MapFileSpace + KnownMapSpace {
    /// The submaps as textures.
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture>;
}

impl ResultSpace for Space2d {
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture> {
        submap_textures_2d(map)
    }
}

impl ResultSpace for Space3d {
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture> {
        submap_textures_3d(map)
    }
}

/// Which results are written.
#[derive(Clone, Copy, Debug)]
pub struct ResultFiles {
    /// The map and pictures of it.
    pub map: bool,
    /// Whether the trajectory with the times of the map is written, too.
    pub all_poses: bool,
}

/// Writes map, trajectory, pictures and report; returns their files in order. `seconds` is the time of
/// mapping.
///
/// # Errors
/// Fails if something cannot be written.
pub fn write_results<S: ResultSpace>(
    mapped: &MappedRecording<S>,
    folder: &OutputFolder,
    seconds: f64,
    what: ResultFiles,
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let map = &mapped.map;
    let memory_while_mapping = resident_and_peak_bytes();
    let mut files = Vec::new();
    let whole = || map.whole().map_err(|source| JobError::file(folder.path(), source));
    // Known trajectories are in the map; these files are of the recording. The trajectory is written first:
    // for its size it took longest to compute, in case there is no room for the rest.
    let trajectory = folder.file("trajectory.tum")?;
    let poses = mapped.trajectory();
    whole()?;
    write_tum(&trajectory, &poses)?;
    if what.map {
        write_map(map, folder.add("map.pbstream", &mut files)?, true)?;
    }
    files.push(trajectory);
    if what.all_poses {
        let poses = mapped.scan_poses();
        whole()?;
        write_tum(&folder.add("all_poses.tum", &mut files)?, &poses)?;
    }
    if !what.map {
        remark(observe, Remark::NoMap { left: folder.path().join("map.pbstream").exists() });
    } else {
        files.extend(draw(map, folder, observe)?);
    }
    let report = serde_json::to_vec_pretty(&report(mapped, seconds, memory_while_mapping))?;
    whole()?;
    write_file(&folder.add("report.json", &mut files)?, &report)?;
    Ok(files)
}

/// Draws the map, unless the user stops the job: pictures can be made from the map later.
fn draw<S: ResultSpace>(
    map: &Map<S>,
    folder: &OutputFolder,
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let mut stops = || observe(&Event::Drawing).is_break();
    let textures = if stops() { Vec::new() } else { S::textures(map) };
    if stops() {
        remark(observe, Remark::StoppedBeforePictures);
        return Ok(Vec::new());
    }
    let trajectories = trajectory_lines(map);
    map.whole().map_err(|source| JobError::file(folder.path(), source))?;
    let content =
        MapContent { textures: &textures, trajectories: &trajectories, constraints: &constraint_lines(map) };
    write_pictures(&content, folder, observe)
}

/// Adds a part to the report that [`write_results`] wrote.
///
/// # Errors
/// Fails if the report cannot be read or written.
pub fn add_to_report(folder: &OutputFolder, name: &str, part: &serde_json::Value) -> Result<(), JobError> {
    let path = folder.path().join("report.json");
    let failed = |reason| JobError::UnreadableReport { path: path.clone(), reason };
    let text = std::fs::read(&path).map_err(|source| JobError::file(&path, source))?;
    let mut report: serde_json::Value = serde_json::from_slice(&text).map_err(failed)?;
    if let Some(fields) = report.as_object_mut() {
        fields.insert(name.to_owned(), part.clone());
    }
    let text = serde_json::to_vec_pretty(&report).map_err(failed)?;
    write_file(&folder.file("report.json")?, &text)
}

fn trajectory_ids<S: Space>(map: &Map<S>) -> impl Iterator<Item = TrajectoryId> + '_ {
    map.graph.state().trajectories.keys().copied()
}

fn trajectory_lines<S: Space>(map: &Map<S>) -> Vec<TrajectoryLine> {
    trajectory_ids(map)
        .map(|id| TrajectoryLine {
            index: id.0 as usize,
            points: map.node_poses(id).iter().map(|(_, p)| [p.translation.x, p.translation.y]).collect(),
        })
        .collect()
}

fn constraint_lines<S: Space>(map: &Map<S>) -> Vec<ConstraintLine> {
    let state = map.graph.state();
    let loops = state.constraints.iter().filter(|c| c.is_loop_closure());
    loops
        .filter_map(|c| {
            let from = state.map_from_submap(c.submap_id)?.translation;
            let to = state.nodes.get(&c.node_id)?.map_from_tracking.translation;
            let between_trajectories = c.submap_id.trajectory_id != c.node_id.trajectory_id;
            Some(ConstraintLine { from: [from.x, from.y], to: [to.x, to.y], between_trajectories })
        })
        .collect()
}
