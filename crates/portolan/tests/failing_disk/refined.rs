//! What `refine` leaves.

use std::path::{Path, PathBuf};

use portolan::geometry::{Rigid3, Time};
use portolan::ingest::IngestOptions;
use portolan::job::refine::{REFINED_FILES, ReadPoints, RefineResults, read_points, write_refinement};
use portolan::job::{MapRequest, OutputFolder, map, unobserved};
use portolan::refinement::continuous::{ContinuousOptions, Refined, refine_continuous};
use portolan::simulator::{Scenario3dOptions, Simulation3d};
use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan::worlds::three_d::Scene3d;
use portolan_atomic_file::faults::{Failure, Fault, Run, fail_at_every, fail_everywhere, whole_disk};
use portolan_testing::is_fast;

use crate::{assert_at_least, compared};

/// A walk that was mapped and refined.
struct Work {
    folder: tempfile::TempDir,
    read: ReadPoints,
    input: Vec<(Time, Rigid3)>,
    refined: Refined,
}

impl Work {
    fn new() -> Self {
        let mut options = Scenario3dOptions::new(Scene3d::Museum, 1, 1);
        options.duration = Some(3.0);
        options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = 90);
        let walk = Simulation3d::new(options).unwrap();
        let folder = tempfile::tempdir().unwrap();
        map(&walk, MapRequest::new(folder.path()), &mut unobserved).unwrap();
        let path = folder.path().join("map.pbstream");
        let nodes = nodes(&path, &read_pose_graph(&path).unwrap(), 0).unwrap();
        let input: Vec<_> = nodes.iter().map(|node| (node.time, node.map_from_tracking)).collect();
        let read = read_points(&walk, &IngestOptions::default(), 0.3, &[], &mut |_| {}).unwrap();
        let refined =
            refine_continuous(&read.store, &input, &ContinuousOptions::default(), &mut |_| true).unwrap();
        Self { folder, read, input, refined }
    }

    /// Trajectory, cloud and report; with everything, the map and the page, too.
    fn write(&self, folder: &Path, run: Run, with_everything: bool) -> Result<(), Failure> {
        let map = self.folder.path().join("map.pbstream");
        let clouds = ["refined.ply".to_owned()];
        // The map wants all poses.
        let count =
            if run == Run::Earlier && !with_everything { self.input.len() - 1 } else { self.input.len() };
        let command = if run == Run::Earlier { "earlier" } else { "later" };
        let results = RefineResults {
            input: &self.input[..count],
            refined: &self.refined,
            read: &self.read,
            seconds: 1.0,
            clouds: &clouds,
            files: &[] as &[PathBuf],
            command: with_everything.then_some(command),
            without_results: false,
            map: with_everything.then_some((&*map, 0)),
        };
        let folder = OutputFolder::begin(folder, "refine", &REFINED_FILES, false, &mut unobserved)?;
        write_refinement(&results, &folder, &mut unobserved)?;
        Ok(())
    }
}

#[test]
fn a_failing_disk_leaves_complete_files_of_refinements() {
    let _disk = whole_disk();
    let work = Work::new();
    let write = |folder: &Path, run: Run| work.write(folder, run, false);
    assert_at_least(24, fail_everywhere(&[Fault::BrokenOnce], compared, write));
    if is_fast() {
        return;
    }
    let write = |folder: &Path, run: Run| work.write(folder, run, true);
    assert_at_least(40, fail_at_every(7, &[Fault::BrokenOnce], compared, write));
}
