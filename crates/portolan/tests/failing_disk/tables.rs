//! Trajectories and their errors in files of text, as `convert` and `evaluate` write them.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use portolan::evaluation::{
    Relation, TimedPose, Trajectory, relation_errors, write_binary_relations, write_csv, write_csv_all,
    write_geojson, write_kitti, write_tum,
};
use portolan::geometry::{Rigid3, Time};
use portolan_atomic_file::AtomicFile;
use portolan_atomic_file::faults::{Failure, Run, fail_everywhere, whole_disk};

use crate::{FAULTS, assert_at_least, compared};

fn trajectory(run: Run) -> Trajectory {
    let pose = |i: i64| TimedPose {
        time: Time::from_ros(i, 0),
        map_from_tracking: Rigid3::translation(i as f64, run as u8 as f64, 0.0),
    };
    Trajectory::new((1..20).map(pose)).0
}

/// As the program does.
fn write_file(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), Failure> {
    let mut file = AtomicFile::create(path)?;
    match write(&mut file) {
        Ok(()) => Ok(file.commit()?),
        Err(source) => Err(file.error(source).into()),
    }
}

fn write(folder: &Path, run: Run) -> Result<(), Failure> {
    let at = |name: &str| folder.join(name);
    let one = trajectory(run);
    let all = [(0, one.clone()), (1, one.clone())];
    write_file(&at("one.csv"), |out| write_csv(&one, out))?;
    write_file(&at("all.csv"), |out| write_csv_all(&all, out))?;
    write_file(&at("all.geojson"), |out| write_geojson(&all, None, out))?;
    write_file(&at("one.kitti"), |out| write_kitti(&one, out))?;
    // With a buffer of their own, as `convert` has it.
    write_file(&at("one.tum"), |out| {
        let mut out = BufWriter::new(out);
        write_tum(&one, &mut out)?;
        out.flush()
    })?;
    let relation = |i: i64| Relation {
        time1: Time::from_ros(i, 0),
        time2: Time::from_ros(i + 1, 0),
        expected_1_from_2: Rigid3::translation(1.0 + 0.1 * run as u8 as f64, 0.0, 0.0),
        covered_distance: 1.0,
    };
    let relations: Vec<Relation> = (2..10).map(relation).collect();
    let errors = relation_errors(&one, &relations)?;
    write_file(&at("errors.csv"), |out| errors.write_csv(out))?;
    write_file(&at("errors_with_times.csv"), |out| errors.write_csv_with_times(out))?;
    write_file(&at("relations"), |out| write_binary_relations(&relations, out))
}

#[test]
fn a_failing_disk_leaves_complete_tables() {
    let _disk = whole_disk();
    assert_at_least(32, fail_everywhere(&FAULTS, compared, write));
}
