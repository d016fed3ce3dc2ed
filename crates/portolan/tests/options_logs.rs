//! Options whose effect is a line in the log.
//!
//! In a file of its own: what is logged is counted for the whole process.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

#[path = "options/run.rs"]
#[allow(dead_code)]
mod run;
#[path = "options/world.rs"]
#[allow(dead_code)]
mod world;

use std::fmt::Debug;
use std::sync::Mutex;

use portolan::config::Options;
use portolan::mapping::{Space, Space2d, Space3d};
use portolan::sensor::Measurement;
use tracing::field::{Field, Visit};
use tracing::{Event, Metadata, Subscriber, span};

static LINES: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Collector;

struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

impl Subscriber for Collector {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }
    fn new_span(&self, _: &span::Attributes<'_>) -> span::Id {
        span::Id::from_u64(1)
    }
    fn record(&self, _: &span::Id, _: &span::Record<'_>) {}
    fn record_follows_from(&self, _: &span::Id, _: &span::Id) {}
    fn event(&self, event: &Event<'_>) {
        let mut message = Message(String::new());
        event.record(&mut message);
        LINES.lock().unwrap().push(message.0);
    }
    fn enter(&self, _: &span::Id) {}
    fn exit(&self, _: &span::Id) {}
}

/// Lines that a run logs and that begin like this.
fn logged<S: Space>(settings: &[&str], beginning: &str) -> usize {
    let space = std::any::type_name::<S>().ends_with("Space3d");
    let mut options = if space { Options::for_3d() } else { Options::for_2d() };
    for setting in [
        "trajectory_builder_2d.submaps.num_range_data=3",
        "trajectory_builder_3d.submaps.num_range_data=3",
        "constraint_builder.min_score=0.1",
        "constraint_builder.sampling_ratio=1",
        "trajectory_builder_2d.use_imu_data=false",
    ] {
        options.set(setting).unwrap();
    }
    for setting in settings {
        options.set(setting).unwrap();
    }
    let mut measurements = Vec::new();
    for step in 0..12 {
        let seconds = 0.6 * f64::from(step);
        let place = world::on_circle(seconds);
        if space {
            measurements.push(Measurement::Imu(world::imu(seconds, 0.0, 0.4)));
            measurements.push(Measurement::Range(world::scan_3d(&place, seconds)));
            let between = (1..6).map(|i| world::imu(seconds + 0.1 * f64::from(i), 0.0, 0.4));
            measurements.extend(between.map(Measurement::Imu));
        } else {
            measurements.push(Measurement::Odometry(world::odometry(place, seconds)));
            measurements.push(Measurement::Range(world::scan_2d(&place, seconds)));
        }
    }
    LINES.lock().unwrap().clear();
    run::run::<S>(&options, measurements);
    LINES.lock().unwrap().iter().filter(|line| line.starts_with(beginning)).count()
}

#[test]
fn options_of_logs_have_their_effects() {
    tracing::subscriber::set_global_default(Collector).unwrap();
    for beginning in ["Node ", "Scores of matches"] {
        assert!(logged::<Space2d>(&["log_matches=true"], beginning) > 0, "{beginning}");
        assert_eq!(logged::<Space2d>(&["log_matches=false"], beginning), 0, "{beginning}");
    }
    for beginning in ["Gravity was: ", "IMU correction was: "] {
        let logs = |value: &str| {
            let setting = format!("log_solver_summary={value}");
            logged::<Space3d>(&[&setting, "constraint_builder.sampling_ratio=0"], beginning)
        };
        assert!(logs("true") > 0, "{beginning}");
        assert_eq!(logs("false"), 0, "{beginning}");
    }
    assert!(logged::<Space2d>(&["log_solver_summary=true"], "Summary") > 0);
    assert_eq!(logged::<Space2d>(&["log_solver_summary=false"], "Summary"), 0);
    let residuals = "Rotation residuals within submaps";
    assert!(
        logged::<Space3d>(
            &["log_residual_histograms=true", "constraint_builder.sampling_ratio=0"],
            residuals
        ) > 0
    );
    assert_eq!(
        logged::<Space3d>(
            &["log_residual_histograms=false", "constraint_builder.sampling_ratio=0"],
            residuals
        ),
        0
    );
    assert_eq!(logged::<Space2d>(&["log_residual_histograms=true"], residuals), 0, "only in 3D");
}
