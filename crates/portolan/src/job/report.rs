//! Content of `report.json`.

use portolan_geometry::Time;
use portolan_mapping::{DegenerateInterval, DegenerateMotion, Loss, Space, Substitute};
use portolan_numeric::LatencyHistogram;

use super::REPORT_VERSION;
use super::localisation::Localisation;
use super::memory::resident_and_peak_bytes;
use crate::pipeline::MappedRecording;

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

/// The key of a component of motion.
fn motion_key(motion: DegenerateMotion) -> &'static str {
    match motion {
        DegenerateMotion::Along => "along_travel",
        DegenerateMotion::Across => "across_travel",
        DegenerateMotion::Up => "vertical",
        DegenerateMotion::Heading => "heading",
        DegenerateMotion::Tilt => "roll_pitch",
    }
}

/// The name of the motion source that was used instead.
fn substitute_key(substitute: Substitute) -> &'static str {
    match substitute {
        Substitute::Odometry => "odometry",
        Substitute::Gyroscope => "gyroscope",
        Substitute::Rest => "zero_velocity",
        Substitute::Accelerometer => "accelerometer",
        Substitute::Correlation => "correlation",
        Substitute::Velocity => "constant_velocity",
    }
}

/// Total duration for which scans did not constrain each component of motion.
fn degenerate_seconds(intervals: &[DegenerateInterval]) -> serde_json::Value {
    // Not `sum`, which is -0 for no values.
    let seconds = |motion: DegenerateMotion| {
        intervals.iter().filter(|i| i.motion == motion).fold(0.0, |sum, i| sum + i.seconds)
    };
    let all = DegenerateMotion::ALL.map(|m| (motion_key(m).to_owned(), (10.0 * seconds(m)).round() / 10.0));
    all.into_iter()
        .map(|(name, seconds)| (name, serde_json::json!(seconds)))
        .collect::<serde_json::Map<_, _>>()
        .into()
}

fn rounded(number: f64) -> f64 {
    (1e3 * number).round() / 1e3
}

/// Intervals in which scans did not constrain a component of motion.
fn degenerate_intervals(intervals: &[DegenerateInterval]) -> Vec<serde_json::Value> {
    let entry = |i: &DegenerateInterval| {
        serde_json::json!({
            "from": i.start.unix_seconds(),
            "to": i.end.unix_seconds(),
            "scans": i.scans,
            "seconds": rounded(i.seconds),
            "motion": motion_key(i.motion),
            "substitute": substitute_key(i.taken),
            "sigma_m": i.sigma.filter(|_| !i.motion.is_rotation()).map(rounded),
            "sigma_deg": i.sigma.filter(|_| i.motion.is_rotation()).map(|s| rounded(s.to_degrees())),
            "direction_in_tracking_frame": i.direction_in_tracking.as_slice(),
        })
    };
    intervals.iter().map(entry).collect()
}

pub(super) fn report<S: Space>(
    mapped: &MappedRecording<S>,
    seconds: f64,
    memory_while_mapping: Option<(u64, u64)>,
) -> serde_json::Value {
    let state = mapped.map.graph.state();
    let loops = state.constraints.iter().filter(|c| c.is_loop_closure()).count();
    let sensors: Vec<String> =
        mapped.plan.sensors().iter().map(|s| format!("{:?} {}", s.kind, s.id)).collect();
    serde_json::json!({
        "version": REPORT_VERSION,
        "scans": mapped.scans,
        "nodes": state.nodes.len(),
        "submaps": state.submaps.len(),
        "constraints": state.constraints.len(),
        "loop_closures": loops,
        "contradicted_loop_closures": mapped.map.graph.contradicted_loop_closures(),
        "unsupported_loop_closures": mapped.map.graph.unsupported_loop_closures(),
        "self_consistency": self_consistency(mapped),
        "drift": {
            "sigma_m": mapped.map.graph.drift().translation,
            "sigma_deg": mapped.map.graph.drift().rotation.to_degrees(),
        },
        "known_map": Localisation::of(mapped).map(|localisation| known_map(&localisation)),
        "recording_seconds": mapped.recording_seconds,
        "wall_seconds": seconds,
        "real_time_factor": mapped.recording_seconds / seconds.max(1e-3),
        "local_slam": scan_times(&mapped.scan_times),
        "memory_bytes": {
            "peak_while_mapping": memory_while_mapping.map(|(_, peak)| peak),
            "peak": resident_and_peak_bytes().map(|(_, peak)| peak),
        },
        "lost": losses(mapped),
        "degenerate_seconds": degenerate_seconds(&mapped.degenerate_intervals),
        "degenerate_intervals": degenerate_intervals(&mapped.degenerate_intervals),
        "interrupted": mapped.interrupted,
        "tracking_frame": mapped.plan.tracking_frame,
        "sensors": sensors,
        "choices": mapped.plan.notices,
        "engine": mapped.map.options.engine().to_string(),
        "options_fingerprint": mapped.map.options.fingerprint(),
        "options": mapped.map.options,
        "issues": mapped.issues,
        "data_lost": mapped.lost_data(),
    })
}

/// Whether places that the recording passed several times agree with each other.
fn self_consistency<S: Space>(mapped: &MappedRecording<S>) -> serde_json::Value {
    let consistency = mapped.map.graph.self_consistency();
    serde_json::json!({
        "places": consistency.places,
        "contradicted": consistency.contradicted,
        "longest_row": consistency.longest_row,
        "contradictory": consistency.is_contradictory(),
    })
}

/// Pose of the recording in the known map, and whether it can be trusted.
fn known_map(localisation: &Localisation) -> serde_json::Value {
    serde_json::json!({
        "loop_closures": localisation.loop_closures,
        "first_found_after_seconds": localisation.first_found_after_seconds,
        "placed_after_seconds": localisation.placed_after_seconds,
        "places": localisation.agreement.places,
        "contradicted": localisation.agreement.contradicted,
        "confirmed": localisation.agreement.confirmed,
        "place": localisation.place().name(),
        "start_error_m": localisation.error_of_given_start.map(|(metres, _)| metres),
        "trusted": localisation.is_trusted(),
    })
}

/// Intervals in which nothing constrained the pose of the scanner, and their outcome.
fn losses<S: Space>(mapped: &MappedRecording<S>) -> Vec<serde_json::Value> {
    let recorded = |time: Time| mapped.recorded_times.get(&time).copied().unwrap_or(time).unix_seconds();
    let entry = |(loss, without_pose): (&Loss, usize)| {
        serde_json::json!({
            "from": recorded(loss.since),
            "to": recorded(loss.until),
            "trajectory": loss.piece.map(|piece| piece.0),
            "is_connected": !mapped.is_apart(loss),
            "is_gap_without_scans": loss.is_gap,
            "scans_without_pose": without_pose,
            "is_tied_by_odometry_alone": mapped.is_tied_by_odometry_alone(loss),
        })
    };
    mapped.losses.iter().zip(mapped.scans_without_pose()).map(entry).collect()
}
