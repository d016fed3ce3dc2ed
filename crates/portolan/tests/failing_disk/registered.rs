//! What `register` leaves.

use std::path::Path;

use portolan::geometry::Rigid3;
use portolan::job::register::{
    History, PointLimits, Registration, ScanSource, Scans, describe, registered_files, write_registration,
};
use portolan::job::{OutputFolder, unobserved};
use portolan::registration::{IcpOptions, ScanCloud, SequenceReport};
use portolan_atomic_file::faults::{Failure, Run, fail_everywhere, whole_disk};

use crate::{FAULTS, assert_at_least, compared};

/// Two scans of which the second is elsewhere after each run.
struct Work {
    scans: Scans,
    registration: [Registration; 2],
}

impl Work {
    fn new(folder: &Path) -> Self {
        let points = |scan: u16| (0..50_u16).map(move |i| [f32::from(i) * 0.02, f32::from(scan) * 0.1, 0.3]);
        let path = |scan: u16| folder.join(format!("{scan}.xyz"));
        for scan in 0..2 {
            let text: String = points(scan).map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
            std::fs::write(path(scan), text).unwrap();
        }
        let scans = Scans {
            names: vec!["first".to_owned(), "second".to_owned()],
            sources: (0..2).map(|scan| ScanSource::File(path(scan))).collect(),
            limits: PointLimits { scale: 1.0, min_range: 0.0, max_range: f64::INFINITY },
            clouds: (0..2).map(|scan| ScanCloud::new(points(scan).collect())).collect(),
            guesses: vec![Rigid3::identity(); 2],
            lost_data: false,
            from_origin: Rigid3::identity(),
            from_first: Rigid3::identity(),
        };
        let registration = [0.1, 0.2].map(|shift| {
            let poses = vec![Rigid3::identity(), Rigid3::translation(shift, 0.0, 0.0)];
            let mut history = History::starting(&scans.guesses);
            history.add(&poses, History::ICP);
            let sequence = SequenceReport { matched: vec![None, None], loops: Vec::new() };
            Registration { poses, sequence, global: None, history }
        });
        Self { scans, registration }
    }

    fn write(&self, folder: &Path, run: Run) -> Result<(), Failure> {
        let work = &self.registration[run as usize];
        let names = registered_files(2, "ply");
        let folder = OutputFolder::begin(folder, "register", &names, false, &mut unobserved)?;
        let registered = describe(&self.scans, work, &IcpOptions::default());
        write_registration(&folder, "ply", &self.scans, work, &registered, &mut unobserved)?;
        Ok(())
    }
}

#[test]
fn a_failing_disk_leaves_complete_files_of_registrations() {
    let _disk = whole_disk();
    let folder = tempfile::tempdir().unwrap();
    let work = Work::new(folder.path());
    assert_at_least(60, fail_everywhere(&FAULTS, compared, |folder, run| work.write(folder, run)));
}
