//! Results written to a disk that fails at any operation: an error that names a file, and whole files or those of before.
#![allow(clippy::unwrap_used)]

mod localized;
mod refined;
mod registered;
mod resumed;
mod tables;

use std::io::Write;
use std::path::Path;

use portolan::job::{CloudRequest, MANIFEST, MapRequest, map, unobserved};
use portolan_atomic_file::AtomicFile;
use portolan_atomic_file::faults::{Failure, Fault, Run, fail_at_every, fail_everywhere, whole_disk};
use portolan_export::{MapContent, PictureOptions, draw_map, write_picture, write_tum};
use portolan_geometry::{Rigid3, Time};
use portolan_mapfile::{ImageName, PaintOptions, PlacedTexture, SubmapTexture, paint, write_ros_map};
use portolan_pointcloud::{Attributes, PointCloud, WriteOptions};
use portolan_recording::Recording;
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_solver::g2o::{read_g2o, write_g2o};
use portolan_testing::is_fast;
use portolan_worlds::two_d::Scene;

/// All but short writes.
const FAULTS: [Fault; 3] = [Fault::Full, Fault::Broken, Fault::BrokenOnce];

/// What of a file is the same for every run: reports contain the time it took, and what a slow run leaves to
/// be resumed is judged by tests of its own. Both, and the list of files, are whole.
fn compared(name: &str, bytes: Vec<u8>) -> Option<Vec<u8>> {
    match name {
        portolan::job::JOURNAL => None,
        MANIFEST | "report.json" => {
            serde_json::from_slice::<serde_json::Value>(&bytes).unwrap();
            (name != MANIFEST).then(Vec::new)
        }
        _ => Some(bytes),
    }
}

/// What is written, made once.
struct Content {
    recording: Simulation,
    poses: Vec<(Time, Rigid3)>,
    textures: Vec<PlacedTexture>,
    cloud: PointCloud,
}

impl Content {
    fn new(run: Run, seconds: f64) -> Self {
        let seed = if run == Run::Earlier { 4 } else { 5 };
        let options =
            ScenarioOptions { duration: Some(seconds), ..ScenarioOptions::new(Scene::Corridors, seed) };
        let pose = |i: i64| (Time::from_ros(i, 0), Rigid3::translation(i as f64, seed as f64, 0.0));
        let texture = SubmapTexture {
            pixels: vec![[0, 255]; 4],
            width: 2,
            height: 2,
            resolution: 0.05,
            submap_from_slice: Rigid3::identity(),
        };
        let placed = |(index, x)| PlacedTexture {
            id: (0, index),
            map_from_submap: Rigid3::translation(x, x * seed as f64, 0.0),
            texture: texture.clone().into(),
        };
        let mut cloud = PointCloud::new(Attributes::default());
        (0..50).for_each(|i| cloud.push([f64::from(i), seed as f64, 2.0], 0.0, 0.0, [0; 3]));
        Self {
            recording: Simulation::new(options).unwrap(),
            poses: (1..10).map(pose).collect(),
            textures: [(0, 0.0), (1, 1.0)].into_iter().map(placed).collect(),
            cloud,
        }
    }

    fn trajectory_and_graph(&self, folder: &Path) -> Result<(), Failure> {
        write_tum(&folder.join("poses.tum"), &self.poses)?;
        let text = format!(
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 {} 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n",
            self.poses[0].1.translation.y
        );
        let (graph, _) = read_g2o(text.as_bytes())?;
        let mut file = AtomicFile::create(folder.join("graph.g2o"))?;
        if let Err(error) = write_g2o(&graph, &mut file).and_then(|()| file.flush()) {
            return Err(file.error(error).into());
        }
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

/// For each run a content, both made before the disk fails.
struct Contents([Content; 2]);

impl Contents {
    fn new(seconds: f64) -> Self {
        Self([Run::Earlier, Run::Later].map(|run| Content::new(run, seconds)))
    }

    fn of(&self, run: Run) -> &Content {
        let Self([earlier, later]) = self;
        if run == Run::Earlier { earlier } else { later }
    }
}

#[track_caller]
fn assert_at_least(least: u64, operations: u64) {
    assert!(operations >= least, "{operations} operations, expected at least {least}");
}

#[test]
fn a_failing_disk_leaves_new_or_previous_files_complete() {
    let _disk = whole_disk();
    let contents = Contents::new(0.5);
    let everywhere = |write: fn(&Content, &Path) -> Result<(), Failure>| {
        fail_everywhere(&FAULTS, compared, |folder, run| write(contents.of(run), folder))
    };
    assert_at_least(8, everywhere(Content::trajectory_and_graph));
    assert_at_least(12, everywhere(Content::pictures));
    assert_at_least(24, everywhere(Content::clouds));
    assert_at_least(8, everywhere(Content::recordings));
}

#[test]
fn a_disk_failing_during_mapping_leaves_new_or_previous_files_complete() {
    if is_fast() {
        return;
    }
    let _disk = whole_disk();
    let contents = Contents::new(0.5);
    let write = |folder: &Path, run: Run| contents.of(run).whole_map(folder);
    // What it writes has tests of its own above.
    assert_at_least(40, fail_at_every(7, &[Fault::BrokenOnce], compared, write));
}

#[test]
fn a_file_with_a_failed_write_is_not_committed_even_if_the_error_was_ignored() {
    let _disk = whole_disk();
    let write = |folder: &Path, run: Run| -> Result<(), Failure> {
        let mut file = AtomicFile::create(folder.join("cloud"))?;
        for part in 0..5_u8 {
            // Each is larger than what is buffered.
            let _ = file.write_all(&vec![part + 10 * run as u8; 300 << 10]);
        }
        Ok(file.commit()?)
    };
    assert_eq!(fail_everywhere(&FAULTS, compared, write), 8);
}
