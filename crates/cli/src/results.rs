//! What mapping leaves in its folder.

mod pictures;

use std::path::{Path, PathBuf};

use portolan::pipeline::MappedRecording;
use portolan_export::{ConstraintLine, MapContent, TrajectoryLine, write_tum};
use portolan_mapfile::{MapSpace, PlacedTexture, submap_textures_2d, submap_textures_3d, write_map};
use portolan_mapping::{
    DegenerateInterval, DegenerateMotion, LatencyHistogram, Map, Planar, Space, Spatial, TrajectoryId,
};

use crate::error::CliError;
use crate::known_map::Localisation;
use crate::memory::resident_and_peak_bytes;
use crate::output::write_file;

/// A space whose maps can be shown from above.
pub trait ResultSpace: MapSpace {
    /// The submaps as textures.
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture>;
}

impl ResultSpace for Planar {
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture> {
        submap_textures_2d(map)
    }
}

impl ResultSpace for Spatial {
    fn textures(map: &Map<Self>) -> Vec<PlacedTexture> {
        submap_textures_3d(map)
    }
}

/// Files that were written.
pub struct Written {
    /// In order.
    pub files: Vec<PathBuf>,
}

/// Writes map, trajectory, pictures and report.
pub fn write_results<S: ResultSpace>(
    mapped: &MappedRecording<S>,
    folder: &Path,
    seconds: f64,
    all_poses: bool,
) -> Result<Written, CliError> {
    let map = &mapped.map;
    let memory_while_mapping = resident_and_peak_bytes();
    let mut files = Vec::new();
    let mut file = |name: &str| {
        files.push(folder.join(name));
        folder.join(name)
    };
    let failed = |e: &dyn std::error::Error| CliError::Failed(e.to_string());
    write_map(map, file("map.pbstream"), true).map_err(|e| failed(&e))?;
    // Trajectories that were known before are in the map; these files are of the recording.
    let id = mapped.trajectory_id;
    write_tum(&file("trajectory.tum"), &mapped.trajectory()).map_err(|e| failed(&e))?;
    if all_poses {
        write_tum(&file("all_poses.tum"), &map.scan_poses(id)).map_err(|e| failed(&e))?;
    }
    let textures = S::textures(map);
    let content = MapContent {
        textures: &textures,
        trajectories: &trajectory_lines(map),
        constraints: &constraint_lines(map),
    };
    files.extend(pictures::write_pictures(&content, folder)?);
    let report =
        serde_json::to_vec_pretty(&report(mapped, seconds, memory_while_mapping)).map_err(|e| failed(&e))?;
    files.push(folder.join("report.json"));
    write_file(&folder.join("report.json"), |out| out.write_all(&report))?;
    Ok(Written { files })
}

/// Adds a part to the report that [`write_results`] left.
pub fn add_to_report(folder: &Path, name: &str, part: &serde_json::Value) -> Result<(), CliError> {
    let path = folder.join("report.json");
    let failed = |e: &dyn std::error::Error| CliError::Failed(format!("{}: {e}", path.display()));
    let text = std::fs::read(&path).map_err(|source| CliError::File { path: path.clone(), source })?;
    let mut report: serde_json::Value = serde_json::from_slice(&text).map_err(|e| failed(&e))?;
    if let Some(fields) = report.as_object_mut() {
        fields.insert(name.to_owned(), part.clone());
    }
    let text = serde_json::to_vec_pretty(&report).map_err(|e| failed(&e))?;
    write_file(&path, |out| out.write_all(&text))
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

/// Milliseconds that local SLAM took for a scan, as quantiles and as a histogram.
fn scan_times(times: &LatencyHistogram) -> serde_json::Value {
    let ms = |time: std::time::Duration| (1e6 * time.as_secs_f64()).round() / 1e3;
    let bins: Vec<_> = times.bins().map(|(bound, count)| serde_json::json!([ms(bound), count])).collect();
    serde_json::json!({
        "scans": times.count(),
        "total_ms": ms(times.total()),
        "median_ms": ms(times.quantile(0.5)),
        "p99_ms": ms(times.quantile(0.99)),
        "longest_ms": ms(times.longest()),
        "histogram_upper_bound_ms_and_count": bins,
    })
}

/// How long scans did not tell each kind of motion, by its name.
fn weak_seconds(spans: &[DegenerateInterval]) -> serde_json::Value {
    let seconds = |motion: DegenerateMotion| -> f64 {
        spans.iter().filter(|s| s.motion == motion).map(|s| s.seconds).sum()
    };
    let all = DegenerateMotion::ALL.map(|m| (m.name().to_owned(), (10.0 * seconds(m)).round() / 10.0));
    all.into_iter()
        .map(|(name, seconds)| (name, serde_json::json!(seconds)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

/// Stretches of time in which scans left a direction open.
fn weak_stretches(spans: &[DegenerateInterval]) -> Vec<serde_json::Value> {
    let span = |s: &DegenerateInterval| {
        serde_json::json!({
            "from": s.start.unix_seconds(),
            "to": s.end.unix_seconds(),
            "scans": s.scans,
            "seconds": (1e3 * s.seconds).round() / 1e3,
            "not_told": s.motion.name(),
            "taken_instead": s.taken.name(),
            "direction_in_tracking_frame": s.direction_in_tracking.as_slice(),
        })
    };
    spans.iter().map(span).collect()
}

fn report<S: Space>(
    mapped: &MappedRecording<S>,
    seconds: f64,
    memory_while_mapping: Option<(u64, u64)>,
) -> serde_json::Value {
    let state = mapped.map.graph.state();
    let loops = state.constraints.iter().filter(|c| c.is_loop_closure()).count();
    let reading: Vec<_> = mapped
        .reading_repairs
        .iter()
        .map(|r| serde_json::json!({ "what": r.what, "count": r.count, "lost_data": r.lost_data }))
        .collect();
    let sensors: Vec<String> =
        mapped.plan.sensors().iter().map(|s| format!("{:?} {}", s.kind, s.id)).collect();
    serde_json::json!({
        "scans": mapped.scans,
        "nodes": state.nodes.len(),
        "submaps": state.submaps.len(),
        "constraints": state.constraints.len(),
        "loop_closures": loops,
        "contradicted_loop_closures": mapped.map.graph.contradicted_loop_closures(),
        "known_map": Localisation::of(mapped).map(|l| serde_json::json!({
            "loop_closures": l.loop_closures,
            "first_found_after_seconds": l.first_found_after_seconds,
            "placed_after_seconds": l.placed_after_seconds,
        })),
        "recording_seconds": mapped.recording_seconds,
        "wall_seconds": seconds,
        "real_time_factor": mapped.recording_seconds / seconds.max(1e-3),
        "local_slam": scan_times(&mapped.scan_times),
        "memory_bytes": {
            "peak_while_mapping": memory_while_mapping.map(|(_, peak)| peak),
            "peak": resident_and_peak_bytes().map(|(_, peak)| peak),
        },
        "lost": crate::lost::report(mapped),
        "weak_seconds": weak_seconds(&mapped.degenerate_intervals),
        "weak_stretches": weak_stretches(&mapped.degenerate_intervals),
        "interrupted": mapped.interrupted,
        "tracking_frame": mapped.plan.tracking_frame,
        "sensors": sensors,
        "options_fingerprint": mapped.map.options.fingerprint(),
        "options": mapped.map.options,
        "repairs": { "reading": reading, "mapping": mapped.mapping_repairs },
    })
}
