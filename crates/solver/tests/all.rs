//! The tests of this crate in one program, which is compiled and linked once.

mod factors;
mod g2o_files;
mod pose_graph_2d_vector;
mod pose_graph_3d_vector;
mod posegraph_optima;
mod sparse_problems;

#[test]
fn every_file_is_run() {
    portolan_testing::assert_files_are_modules(env!("CARGO_MANIFEST_DIR"), include_str!("all.rs"), &[]);
}
