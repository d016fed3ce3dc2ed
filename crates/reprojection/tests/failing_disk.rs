//! Scans kept on a disk that fails at any operation: all of them are placed, or it is said that they are not.
#![allow(clippy::unwrap_used)]

use std::io;
use std::path::Path;

use portolan_atomic_file::faults::{Fault, fail_at, mend};
use portolan_geometry::{Duration, Point3f, Rigid3, Time};
use portolan_lidar_odometry::SweepPoint;
use portolan_reprojection::{KeptScans, SmoothMotion};

const SCANS: i64 = 200;

fn at(scan: i64) -> Time {
    Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(0.1 * scan as f64)
}

fn kept(folder: &Path) -> KeptScans {
    let mut kept = KeptScans::in_folder(folder);
    let point = |i: i64| SweepPoint { time: 0.0, position: Point3f::new(i as f32, 1.0, 2.0), intensity: 0.0 };
    for scan in 0..SCANS {
        let points: Vec<SweepPoint> = (0..200).map(|i| point(i + scan)).collect();
        kept.keep(at(scan), &Rigid3::translation(scan as f64, 0.0, 0.0), &points);
    }
    kept.finish();
    kept
}

/// Coordinates of all points, added up.
fn placed(kept: &KeptScans) -> io::Result<(u64, f64)> {
    let motion = SmoothMotion::new((0..SCANS).map(|scan| (at(scan), Rigid3::identity())).collect());
    let mut sum = 0.0;
    let reprojected = kept.reproject(&motion, 1, &mut |points| {
        sum += points.iter().map(|point| point.position.iter().sum::<f64>()).sum::<f64>();
        true
    })?;
    Ok((reprojected.points, sum))
}

// One test, because the disk is that of the whole process.
#[test]
fn no_scan_is_missing_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    fail_at(u64::MAX, Fault::Full);
    let good = placed(&kept(folder.path())).unwrap();
    let operations = mend();
    assert!(good.0 == 200 * SCANS as u64 && operations >= 7, "{good:?}, {operations} operations");
    for (fault, at) in [Fault::Full, Fault::Broken, Fault::BrokenOnce]
        .into_iter()
        .flat_map(|fault| (0..operations).map(move |at| (fault, at)))
    {
        fail_at(at, fault);
        let kept = kept(folder.path());
        let placed = placed(&kept);
        mend();
        assert_eq!(kept.is_complete(), kept.failure().is_none());
        match placed {
            Ok(placed) => assert!(placed == good && kept.is_complete(), "{fault:?} at {at}: {placed:?}"),
            Err(error) if kept.is_complete() => assert!(error.to_string().contains("os error"), "{error}"),
            Err(_) => assert!(kept.failure().unwrap().to_string().contains("os error")),
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
    fail_at(0, Fault::InterruptedAndShort);
    assert_eq!(placed(&kept(folder.path())).unwrap(), good);
    mend();
}
