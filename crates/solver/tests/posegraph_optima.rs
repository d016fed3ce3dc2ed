//! Standard pose graphs reach their published optima. Needs the real data.

#![allow(clippy::unwrap_used)]

use std::fs::File;
use std::io::BufReader;

use portolan_solver::g2o::{Initialization, OptimizeOptions, Report, optimize_graph, read_g2o};
use portolan_testing::real_data;

fn optimize(name: &str, initialization: Initialization) -> Option<Report> {
    let file = File::open(real_data(&format!("posegraphs/{name}"))?).unwrap();
    let (mut graph, repairs) = read_g2o(BufReader::new(file)).unwrap();
    assert!(repairs.is_empty(), "{repairs:?}");
    let options = OptimizeOptions { initialization, ..Default::default() };
    let report = optimize_graph(&mut graph, &options).unwrap();
    assert!((graph.chi2(options.convention) / report.chi2_after - 1.0).abs() < 1e-12);
    Some(report)
}

const OPTIMA: [(&str, f64); 6] = [
    ("intel.g2o", 546.463),
    ("intel_sesync.g2o", 45.004),
    ("m3500.g2o", 137.915),
    ("parking-garage.g2o", 1.26838),
    ("sphere2500.g2o", 1351.40),
    ("smallgrid3d.g2o", 1035.85),
];

#[test]
fn the_automatic_start_reaches_every_optimum() {
    for (name, optimum) in OPTIMA {
        let Some(report) = optimize(name, Initialization::Automatic) else { return };
        assert!((report.chi2_after / optimum - 1.0).abs() < 1e-4, "{name}: {report:?}");
        assert!(report.termination.is_convergence() && report.components == 1, "{name}: {report:?}");
    }
}

#[test]
fn rotations_first_reach_every_optimum_alone() {
    for (name, optimum) in OPTIMA {
        let Some(report) = optimize(name, Initialization::RotationsFirst) else { return };
        assert!((report.chi2_after / optimum - 1.0).abs() < 1e-4, "{name}: {report:?}");
        assert!(report.chi2_initialized < report.chi2_before, "{name}: {report:?}");
    }
}
