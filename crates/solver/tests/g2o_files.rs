//! Reading and writing g2o files: round trips, repairs, damage of all kinds.

#![allow(clippy::unwrap_used, clippy::panic)]

use portolan_geometry::{Rigid2, Rigid3};
use portolan_solver::g2o::{
    G2oError, Graph, GraphError, Initialization, OptimizeOptions, PoseGraph, optimize_graph, read_g2o,
    write_g2o,
};
use portolan_solver::{Loss, Termination};
use proptest::prelude::*;

const GRAPH_2D: &str = "\
# a square with a chord
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1.1 0.1 1.5
VERTEX_SE2 2 0.9 1.2 3.1
VERTEX_SE2 3 0.1 0.9 -1.6
FIX 0
EDGE_SE2 0 1 1 0 1.5707963267948966 100 0 0 100 0 400
EDGE_SE2 1 2 1 0 1.5707963267948966 100 0 0 100 0 400
EDGE_SE2 2 3 1 0 1.5707963267948966 100 0 0 100 0 400
EDGE_SE2 3 0 1 0 1.5707963267948966 100 0 0 100 0 400
EDGE_SE2 0 2 1 1 3.141592653589793 50 1 0 50 0 100
";

const GRAPH_3D: &str = "\
VERTEX_SE3:QUAT 7 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 8 1 0.1 0 0 0 0.1 0.9949874371066199
VERTEX_SE3:QUAT -3 2 0 0.2 0.1 0 0 0.9949874371066199
EDGE_SE3:QUAT 7 8 1 0 0 0 0 0 1 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40
EDGE_SE3:QUAT 8 -3 1 0 0 0 0 0 1 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40
EDGE_SE3:QUAT 7 -3 2.1 0 0 0 0 0 1 10 1 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40
";

fn read(text: &str) -> Result<(Graph, portolan_solver::g2o::G2oRepairs), G2oError> {
    read_g2o(text.as_bytes())
}

fn graph_2d(graph: &Graph) -> &PoseGraph<Rigid2> {
    match graph {
        Graph::TwoD(graph) => graph,
        Graph::ThreeD(_) => panic!("not in 2D"),
    }
}

#[test]
fn files_round_trip_unchanged() {
    for text in [GRAPH_2D, GRAPH_3D] {
        let (graph, repairs) = read(text).unwrap();
        assert!(repairs.is_empty());
        let mut written = Vec::new();
        write_g2o(&graph, &mut written).unwrap();
        assert_eq!(read_g2o(written.as_slice()).unwrap().0, graph);
    }
    let graph = read(GRAPH_2D).unwrap().0;
    let graph = graph_2d(&graph);
    assert!(graph.vertices[0].fixed && !graph.vertices[1].fixed);
    assert_eq!(graph.edges[4].information.0[(1, 0)], 1.0);
}

#[test]
fn optimisation_closes_the_square() {
    for initialization in [
        Initialization::Automatic,
        Initialization::FromFile,
        Initialization::Odometry,
        Initialization::SpanningTree,
        Initialization::RotationsFirst,
    ] {
        for text in [GRAPH_2D, GRAPH_3D] {
            let mut graph = read(text).unwrap().0;
            let options = OptimizeOptions { initialization, estimate_condition: true, ..Default::default() };
            let report = optimize_graph(&mut graph, &options).unwrap();
            assert!(report.termination.is_convergence(), "{report:?}");
            assert!(report.chi2_after <= report.chi2_before && report.chi2_after < 0.05, "{report:?}");
            assert!(report.condition.is_some_and(|c| c > 1.0 && c < 1e4), "{report:?}");
            assert_eq!((report.components, report.repaired_information), (1, 0));
            assert!(report.worst_edges.is_sorted_by(|a, b| a.chi2 >= b.chi2));
        }
    }
    let mut graph = read(GRAPH_2D).unwrap().0;
    let report = optimize_graph(&mut graph, &OptimizeOptions::default()).unwrap();
    assert!(report.anchored.is_empty() && report.unknowns == 9 && report.redundancy() == 6);
    assert!((graph_2d(&graph).vertices[2].pose.translation - nalgebra::Vector2::new(1.0, 1.0)).norm() < 1e-6);
}

#[test]
fn irregularities_are_counted_and_repaired() {
    let text = format!(
        "{GRAPH_2D}VERTEX_SE2 0 5 5 5\nVERTEX_SE2 9 nan 0 0\nVERTEX_XY 4 1 1\nVERTEX_XY 5 1 1\n\
         EDGE_SE2 3 9 1 0 0 1 0 0 1 0 1\nEDGE_SE2 10 9 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 0 1 0 0 1 0 0 1 0 1\n\
         EDGE_SE2 0 1 inf 0 0 1 0 0 1 0 1\nFIX 77\n\n"
    );
    let (graph, repairs) = read(&text).unwrap();
    assert_eq!(repairs.ignored_tags.get("VERTEX_XY"), Some(&2));
    assert_eq!((repairs.duplicate_vertices, repairs.unusable_vertices), (1, 1));
    assert_eq!((repairs.created_vertices, repairs.unusable_edges, repairs.self_edges), (2, 1, 1));
    assert_eq!(repairs.unknown_fixed, 1);
    // The vertices that were missing were put where the measurements say.
    let created = &graph_2d(&graph).vertices[4];
    let expected = graph_2d(&graph).vertices[3].pose * Rigid2::new(1.0, 0.0, 0.0);
    assert_eq!((created.id, created.pose), (9, expected));
}

#[test]
fn immense_numbers_are_not_accepted_as_poses() {
    let edge = "EDGE_SE2 0 1 1 0 1e308 100 0 0 100 0 400\n";
    let text =
        format!("VERTEX_SE2 0 0 0 1e308\nVERTEX_SE2 2 0 0 1e99\n{edge}EDGE_SE2 2 1 1 0 1e99 1 0 0 1 0 1\n");
    let (graph, repairs) = read(&text).unwrap();
    assert_eq!((repairs.unusable_vertices, repairs.unusable_edges, repairs.created_vertices), (1, 1, 1));
    assert!(graph_2d(&graph).vertices.iter().all(|vertex| vertex.pose.angle.is_finite()));
    let mut written = Vec::new();
    write_g2o(&graph, &mut written).unwrap();
    assert!(read_g2o(written.as_slice()).unwrap().1.is_empty());
    let vertex = "VERTEX_SE3:QUAT 7 0 1e200 0 0 0 0 1\n";
    assert_eq!(read(&format!("{GRAPH_3D}{vertex}")).unwrap().1.unusable_vertices, 1);
}

#[test]
fn quaternions_are_normalised_or_refused() {
    let vertex = |q: &str| format!("VERTEX_SE3:QUAT 1 0 0 0 {q}\n{GRAPH_3D}");
    let (graph, repairs) = read(&vertex("0 0 0 2")).unwrap();
    assert_eq!(repairs.normalized_quaternions, 1);
    let Graph::ThreeD(graph) = graph else { panic!("not in 3D") };
    assert_eq!(graph.vertices[0].pose, Rigid3::identity());
    assert_eq!(read(&vertex("0 0 0 0")).unwrap().1.unusable_vertices, 1);
}

#[test]
fn damage_is_reported_with_its_line() {
    let line_of = |text: &str| match read(text) {
        Err(G2oError::Malformed { line, .. } | G2oError::MixedDimensions { line, .. }) => line,
        other => panic!("{other:?}"),
    };
    assert_eq!(line_of(&format!("{GRAPH_2D}EDGE_SE2 0 1 1 0 1.57 100 0 0 10")), 12);
    assert_eq!(line_of(&format!("{GRAPH_2D}VERTEX_SE2 x 1 0 1")), 12);
    assert_eq!(line_of(&format!("{GRAPH_2D}VERTEX_SE2 5 1 0 zero")), 12);
    assert_eq!(line_of(&format!("{GRAPH_2D}FIX")), 12);
    assert_eq!(line_of(&format!("{GRAPH_2D}{GRAPH_3D}")), 12);
    assert!(matches!(read("# nothing\nFIX 1\n"), Err(G2oError::Empty)));
    assert!(matches!(read("EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1"), Err(G2oError::Empty)));
}

#[test]
fn parts_without_a_fixed_vertex_are_anchored() {
    let text = format!(
        "{GRAPH_2D}EDGE_SE2 20 21 1 0 0 1 0 0 1 0 1\nEDGE_SE2 21 20 -1.1 0 0 1 0 0 1 0 1\nVERTEX_SE2 30 1 1 1\n"
    );
    let mut graph = read(&text).unwrap().0;
    let report = optimize_graph(&mut graph, &OptimizeOptions::default()).unwrap();
    assert_eq!((report.components, report.anchored.as_slice()), (3, [30, 20].as_slice()));
    assert!(report.termination.is_convergence());
    let isolated = graph_2d(&graph).vertices.iter().find(|v| v.id == 30).unwrap();
    assert_eq!(isolated.pose, Rigid2::new(1.0, 1.0, 1.0));
}

#[test]
fn indefinite_and_empty_information_is_handled() {
    let text = GRAPH_2D
        .replace("50 1 0 50 0 100", "50 90 0 50 0 -100")
        .replace("2 3 1 0 1.5707963267948966 100 0 0 100 0 400", "2 3 1 0 1.5 0 0 0 0 0 0");
    let mut graph = read(&text).unwrap().0;
    let options = OptimizeOptions { estimate_condition: true, ..Default::default() };
    let report = optimize_graph(&mut graph, &options).unwrap();
    assert_eq!(report.repaired_information, 1);
    assert!(report.termination.is_usable());
    // A vertex that nothing determines is recognised by the condition.
    let loose = format!("{GRAPH_2D}EDGE_SE2 0 5 1 0 0 0 0 0 0 0 0\n");
    let mut graph = read(&loose).unwrap().0;
    let report = optimize_graph(&mut graph, &options).unwrap();
    assert_eq!(report.condition, Some(f64::INFINITY));
}

#[test]
fn a_robust_loss_rejects_a_false_loop_closure() {
    let chain: String =
        (0..20).map(|i| format!("EDGE_SE2 {i} {} 1 0 0.1 100 0 0 100 0 400\n", i + 1)).collect();
    let good = (0..15).map(|i| {
        let (x, y, a) =
            (0..5).fold((0.0, 0.0, 0.0), |(x, y, a): (f64, f64, f64), _| (x + a.cos(), y + a.sin(), a + 0.1));
        format!("EDGE_SE2 {i} {} {x} {y} {a} 100 0 0 100 0 400\n", i + 5)
    });
    let text = chain.clone() + &good.collect::<String>() + "EDGE_SE2 2 17 0 0 0 100 0 0 100 0 400\n";
    let mut graph = read(&text).unwrap().0;
    let options = OptimizeOptions {
        loss: Loss::GemanMcClure(1.0),
        initialization: Initialization::Odometry,
        ..Default::default()
    };
    let report = optimize_graph(&mut graph, &options).unwrap();
    assert_eq!((report.worst_edges[0].from, report.worst_edges[0].to), (2, 17));
    assert!(report.worst_edges[0].chi2 > 1e3 && report.worst_edges[1].chi2 < 1e-2, "{report:?}");
}

#[test]
fn graphs_made_by_hand_are_checked() {
    let mut graph = read(GRAPH_2D).unwrap().0;
    let Graph::TwoD(inner) = &mut graph else { panic!("not in 2D") };
    inner.edges[2].to = 99;
    assert!(write_g2o(&graph, Vec::new()).is_err());
    let result = optimize_graph(&mut graph, &OptimizeOptions::default());
    assert!(matches!(result, Err(GraphError::UnknownVertex { edge: 2, vertex: 99, count: 4 })));
    let mut empty = Graph::ThreeD(PoseGraph::default());
    assert!(matches!(optimize_graph(&mut empty, &OptimizeOptions::default()), Err(GraphError::NoVertices)));
    let mut far = read(GRAPH_2D).unwrap().0;
    let Graph::TwoD(inner) = &mut far else { panic!("not in 2D") };
    inner.edges[0].measurement = Rigid2::new(1e300, 0.0, 1.57);
    match optimize_graph(&mut far, &OptimizeOptions::default()) {
        Ok(report) => assert_ne!(report.termination, Termination::GradientTolerance),
        Err(error) => assert!(matches!(error, GraphError::Problem(_)), "{error}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn no_damage_panics(
        is_3d in any::<bool>(), cut in 0usize..2000,
        flips in prop::collection::vec((0usize..2000, any::<u8>()), 0..6),
    ) {
        let mut bytes = if is_3d { GRAPH_3D } else { GRAPH_2D }.as_bytes().to_vec();
        for (at, value) in flips {
            let length = bytes.len();
            bytes[at % length] = value;
        }
        bytes.truncate(cut.max(20));
        if let Ok((mut graph, _)) = read_g2o(bytes.as_slice()) {
            let options = OptimizeOptions { estimate_condition: true, ..Default::default() };
            if let Ok(report) = optimize_graph(&mut graph, &options) {
                prop_assert!(!report.chi2_after.is_nan());
            }
        }
    }
}
