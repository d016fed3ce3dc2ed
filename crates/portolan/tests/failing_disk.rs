//! Results written to a disk that fails at any write: an error, and no file that looks done.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use portolan::job::{CloudRequest, MapRequest, map, unobserved};
use portolan_atomic_file::AtomicFile;
use portolan_atomic_file::faults::{Fault, fail_at, mend};
use portolan_export::{MapContent, PictureOptions, draw_map, write_picture, write_tum};
use portolan_geometry::{Rigid3, Time};
use portolan_mapfile::{ImageName, PaintOptions, PlacedTexture, SubmapTexture, paint, write_ros_map};
use portolan_pointcloud::{Attributes, PointCloud, WriteOptions};
use portolan_recording::Recording;
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_solver::g2o::{read_g2o, write_g2o};
use portolan_testing::is_fast;
use portolan_worlds::two_d::Scene;

type Failure = Box<dyn std::error::Error>;

/// What is written, made once.
struct Content {
    recording: Simulation,
    poses: Vec<(Time, Rigid3)>,
    textures: Vec<PlacedTexture>,
    cloud: PointCloud,
}

impl Content {
    fn new(seconds: f64) -> Self {
        let options =
            ScenarioOptions { duration: Some(seconds), ..ScenarioOptions::new(Scene::Corridors, 5) };
        let pose = |i: i64| (Time::from_ros(i, 0), Rigid3::translation(i as f64, 0.0, 0.0));
        let texture = SubmapTexture {
            pixels: vec![[0, 255]; 4],
            width: 2,
            height: 2,
            resolution: 0.05,
            submap_from_slice: Rigid3::identity(),
        };
        let placed = |(index, x)| PlacedTexture {
            id: (0, index),
            map_from_submap: Rigid3::translation(x, x, 0.0),
            texture: texture.clone().into(),
        };
        let mut cloud = PointCloud::new(Attributes::default());
        (0..50).for_each(|i| cloud.push([f64::from(i), 1.0, 2.0], 0.0, 0.0, [0; 3]));
        Self {
            recording: Simulation::new(options).unwrap(),
            poses: (1..10).map(pose).collect(),
            textures: [(0, 0.0), (1, 1.0)].into_iter().map(placed).collect(),
            cloud,
        }
    }

    fn trajectory_and_graph(&self, folder: &Path) -> Result<(), Failure> {
        write_tum(&folder.join("poses.tum"), &self.poses)?;
        let text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";
        let (graph, _) = read_g2o(text.as_bytes())?;
        let mut file = AtomicFile::create(folder.join("graph.g2o"))?;
        write_g2o(&graph, &mut file)?;
        file.flush()?;
        Ok(file.commit()?)
    }

    fn pictures(&self, folder: &Path) -> Result<(), Failure> {
        let content = MapContent { textures: &self.textures, trajectories: &[], constraints: &[] };
        write_picture(&folder.join("map.png"), &draw_map(&content, &PictureOptions::default())?)?;
        let painted = paint(&self.textures, &PaintOptions::default())?;
        write_ros_map(&folder.join("map"), &painted, ImageName::Beside)?;
        Ok(())
    }

    fn clouds(&self, folder: &Path) -> Result<(), Failure> {
        for name in ["a.ply", "a.pcd", "a.xyz", "a.las", "a.laz", "a.e57"] {
            let options = WriteOptions::default();
            let mut writer = portolan_pointcloud::create(folder.join(name), Attributes::default(), &options)?;
            writer.write(&self.cloud)?;
            writer.finish()?;
        }
        Ok(())
    }

    fn recordings(&self, folder: &Path) -> Result<(), Failure> {
        for name in ["walk.bag", "walk.mcap"] {
            let mut writer = portolan_recording::create(folder.join(name), None)?;
            let mut reader = self.recording.read(&|_| true)?;
            while let Some(message) = reader.next_message()? {
                writer.write(&message)?;
            }
            writer.finish()?;
        }
        Ok(())
    }

    fn whole_map(&self, folder: &Path) -> Result<(), Failure> {
        let cloud = CloudRequest { file: Some("cloud.ply".into()), ..CloudRequest::default() };
        map(&self.recording, MapRequest { cloud, ..MapRequest::new(folder) }, &mut unobserved)?;
        Ok(())
    }
}

/// Files by their names; reports tell how long it took, and what a slow run leaves to be resumed is judged by tests of its own.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(Result::unwrap);
    let named = entries.map(|entry| (entry.file_name().into_string().unwrap(), entry.path()));
    let others = ["report.json", portolan::job::MANIFEST, portolan::job::JOURNAL];
    let told = named.filter(|(name, _)| !others.contains(&name.as_str()));
    told.map(|(name, path)| (name, std::fs::read(path).unwrap())).collect()
}

/// Lets the disk fail at each operation; how many there are.
fn fail_everywhere(write: impl Fn(&Path) -> Result<(), Failure>, faults: &[Fault]) -> u64 {
    let good = tempfile::tempdir().unwrap();
    fail_at(u64::MAX, Fault::Full);
    write(good.path()).unwrap();
    let operations = mend();
    let good = contents(good.path());
    for fault in faults {
        for at in 0..operations {
            let output = tempfile::tempdir().unwrap();
            fail_at(at, *fault);
            let written = write(output.path());
            mend();
            let failed = written.unwrap_err().to_string();
            assert!(failed.contains("os error") || failed.contains("space"), "{fault:?} at {at}: {failed}");
            for (name, bytes) in contents(output.path()) {
                assert!(good.get(&name) == Some(&bytes), "{fault:?} at {at}: {name}");
            }
        }
    }
    let output = tempfile::tempdir().unwrap();
    fail_at(0, Fault::InterruptedAndShort);
    write(output.path()).unwrap();
    mend();
    assert!(contents(output.path()) == good, "short writes");
    operations
}

#[track_caller]
fn assert_at_least(least: u64, operations: u64) {
    assert!(operations >= least, "{operations} operations, expected at least {least}");
}

// One test, because the disk is that of the whole process.
#[test]
fn a_failing_disk_leaves_whole_files_or_none() {
    let content = Content::new(0.5);
    let faults = [Fault::Full, Fault::Broken, Fault::BrokenOnce];
    assert_at_least(6, fail_everywhere(|folder| content.trajectory_and_graph(folder), &faults));
    assert_at_least(9, fail_everywhere(|folder| content.pictures(folder), &faults));
    assert_at_least(17, fail_everywhere(|folder| content.clouds(folder), &faults));
    assert_at_least(6, fail_everywhere(|folder| content.recordings(folder), &faults));
    if is_fast() {
        return;
    }
    let content = Content::new(1.5);
    assert!(fail_everywhere(|folder| content.whole_map(folder), &[Fault::Full, Fault::BrokenOnce]) >= 20);
}
