//! What is written is read again, for every format and every set of values.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use std::path::Path;

use portolan_issue::Issue;
use portolan_pointcloud::{
    Attributes, BATCH_POINTS, CloudError, Encoding, PointCloud, Precision, WriteOptions, create, open,
};

fn all_attributes() -> impl Iterator<Item = Attributes> {
    (0..8).map(|i| Attributes { intensity: i & 1 > 0, time: i & 2 > 0, color: i & 4 > 0 })
}

fn cloud(count: usize, attributes: Attributes) -> PointCloud {
    let mut cloud = PointCloud::new(attributes);
    for i in 0..count {
        let t = i as f64;
        let position = [(t * 0.7).sin() * 30.0, t * 0.001 - 20.0, (t * 0.013).cos() * 3.0];
        cloud.push(position, (i % 256) as f32, 1_700_000_000.5 + t * 0.001, [i as u8, (i >> 3) as u8, 200]);
    }
    cloud
}

fn write(path: &Path, cloud: &PointCloud, options: &WriteOptions) -> u64 {
    let mut writer = create(path, cloud.attributes(), options).unwrap();
    // In unequal pieces.
    let mut piece = PointCloud::new(cloud.attributes());
    for i in 0..cloud.len() {
        piece.push(
            cloud.position(i),
            cloud.intensity(i).unwrap_or(0.0),
            cloud.time(i).unwrap_or(0.0),
            cloud.color(i).unwrap_or([0; 3]),
        );
        if piece.len() >= 9000 || i + 1 == cloud.len() {
            writer.write(&piece).unwrap();
            piece.reset(cloud.attributes());
        }
    }
    writer.finish().unwrap().points
}

fn read(path: &Path) -> Result<(PointCloud, Vec<Issue>), CloudError> {
    let mut reader = open(path)?;
    let mut all = PointCloud::new(reader.attributes());
    let mut batch = PointCloud::default();
    while reader.next_batch(&mut batch)? {
        assert!(!batch.is_empty() && batch.len() <= BATCH_POINTS);
        all.extend(&batch);
    }
    Ok((all, reader.issues()))
}

fn compare(read: &PointCloud, written: &PointCloud, tolerance: f64, name: &str) {
    assert_eq!(read.len(), written.len(), "{name}");
    let attributes = written.attributes();
    for i in (0..read.len()).step_by(7) {
        let (a, b) = (read.position(i), written.position(i));
        assert!((0..3).all(|k| (a[k] - b[k]).abs() <= tolerance), "{name}: {a:?} {b:?}");
        if attributes.intensity {
            assert_eq!(read.intensity(i), written.intensity(i), "{name}");
        }
        if attributes.time {
            assert!((read.time(i).unwrap() - written.time(i).unwrap()).abs() < 2e-6, "{name}");
        }
        if attributes.color {
            assert_eq!(read.color(i), written.color(i), "{name}");
        }
    }
}

fn choices() -> Vec<(&'static str, Encoding, Precision, f64)> {
    let mut choices = Vec::new();
    for (name, binary) in [("x.ply", 0.0), ("x.pcd", 4e-6)] {
        choices.push((name, Encoding::Binary, Precision::Usual, binary));
        choices.push((name, Encoding::Binary, Precision::Double, 0.0));
        choices.push((name, Encoding::Binary, Precision::Single, 4e-6));
        choices.push((name, Encoding::Ascii, Precision::Usual, 5.1e-5));
    }
    choices.push(("x.pcd", Encoding::Compressed, Precision::Usual, 4e-6));
    choices.push(("x.pcd", Encoding::Compressed, Precision::Double, 0.0));
    for (name, tolerance) in [("x.xyz", 5.1e-5), ("x.las", 5.1e-5), ("x.laz", 5.1e-5), ("x.e57", 0.0)] {
        choices.push((name, Encoding::Binary, Precision::Usual, tolerance));
    }
    choices
}

#[test]
fn every_format_keeps_what_it_is_given() {
    let folder = tempfile::tempdir().unwrap();
    for (name, encoding, precision, tolerance) in choices() {
        let path = folder.path().join(name);
        let options = WriteOptions { encoding, precision, ..WriteOptions::default() };
        for attributes in all_attributes() {
            let cloud = cloud(500, attributes);
            assert_eq!(write(&path, &cloud, &options), 500);
            let (back, issues) = read(&path).unwrap();
            let label = format!("{name} {encoding:?} {precision:?} {attributes:?}");
            assert!(issues.is_empty(), "{label}: {issues:?}");
            compare(&back, &cloud, tolerance, &label);
            let first = std::fs::read(&path).unwrap();
            write(&path, &cloud, &options);
            assert!(first == std::fs::read(&path).unwrap(), "{label}: other bytes");
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 6);
}

#[test]
fn clouds_longer_than_a_batch_are_read_in_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(BATCH_POINTS + 5000, Attributes { intensity: true, time: true, color: true });
    for (name, encoding, precision, tolerance) in choices() {
        let path = folder.path().join(name);
        let options = WriteOptions { encoding, precision, ..WriteOptions::default() };
        write(&path, &cloud, &options);
        compare(&read(&path).unwrap().0, &cloud, tolerance, name);
        let empty = PointCloud::new(cloud.attributes());
        assert_eq!(write(&path, &empty, &options), 0);
        assert_eq!(read(&path).unwrap().0.len(), 0, "{name}");
    }
}

#[test]
fn far_points_are_kept_and_points_that_are_not_finite_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut cloud = PointCloud::single([4_000_000.0, 500_000.0, 300.0], Attributes::default());
    cloud.push([4_000_012.125, 500_001.5, 301.25], 0.0, 0.0, [0; 3]);
    cloud.push([f64::NAN, 0.0, 0.0], 0.0, 0.0, [0; 3]);
    for name in ["a.ply", "a.pcd", "a.las", "a.laz", "a.e57", "a.xyz"] {
        let path = folder.path().join(name);
        let mut writer = create(&path, Attributes::default(), &WriteOptions::default()).unwrap();
        writer.write(&cloud).unwrap();
        let written = writer.finish().unwrap();
        assert_eq!((written.points, written.not_finite), (1, 1), "{name}");
        let (back, _) = read(&path).unwrap();
        assert!((back.position(0)[0] - 4_000_012.125).abs() < 1e-4, "{name}");
    }
    // Nothing appears before it is complete, and nothing stays behind.
    let path = folder.path().join("never.ply");
    drop(create(&path, Attributes::default(), &WriteOptions::default()).unwrap());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 6);
    assert!(create(folder.path().join("map.stl"), Attributes::default(), &WriteOptions::default()).is_err());
    let coarse = WriteOptions { resolution: 0.0, ..WriteOptions::default() };
    assert!(create(folder.path().join("map.las"), Attributes::default(), &coarse).is_err());
}

/// A full disk is an error that says so, and leaves nothing behind; nor does a cloud that is given up then.
#[cfg(target_os = "linux")]
#[test]
fn full_disks_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(20_000, Attributes { intensity: true, time: true, color: true });
    for name in ["x.ply", "x.pcd", "x.xyz", "x.las", "x.laz", "x.e57"] {
        let path = folder.path().join(name);
        for (batches, is_finished) in [(0, true), (1, true), (40, true), (40, false)] {
            // A device that is always full, under the name that is written to.
            std::os::unix::fs::symlink("/dev/full", &path).unwrap();
            let mut writer = create(&path, cloud.attributes(), &WriteOptions::default()).unwrap();
            let written = (0..batches).try_for_each(|_| writer.write(&cloud));
            if !is_finished {
                drop(writer);
            } else if let Err(error) = written.and_then(|()| writer.finish().map(drop)) {
                let text = error.to_string();
                assert!(text.contains("space") && !text.contains("resolution"), "{name}: {text}");
            } else {
                unreachable!("{name} of {batches} batches was written to a full disk");
            }
            std::fs::remove_file(&path).unwrap();
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{name}");
        }
    }
}
