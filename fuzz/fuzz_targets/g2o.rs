//! Pose graphs: read, optimised with every start, written and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_solver::g2o::{Initialization, OptimizeOptions, optimize_graph, read_g2o, write_g2o};

fuzz_target!(|bytes: &[u8]| {
    let Ok((graph, _)) = read_g2o(bytes) else { return };
    let mut text = Vec::new();
    write_g2o(&graph, &mut text).expect("memory takes everything");
    let (again, repairs) = read_g2o(text.as_slice()).expect("what is written can be read");
    assert!(repairs.is_empty(), "{repairs:?}");
    assert_eq!((again.vertex_count(), again.edge_count()), (graph.vertex_count(), graph.edge_count()));
    if graph.vertex_count() > 200 || graph.edge_count() > 400 {
        return;
    }
    for initialization in
        [Initialization::Automatic, Initialization::FromFile, Initialization::SpanningTree, Initialization::RotationsFirst]
    {
        let mut options = OptimizeOptions { initialization, estimate_condition: true, ..Default::default() };
        options.solver.max_num_iterations = 5;
        let _ = optimize_graph(&mut graph.clone(), &options);
    }
});
