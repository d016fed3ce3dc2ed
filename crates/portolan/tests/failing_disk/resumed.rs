//! Mapping that the disk stops, and that goes on.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use portolan::job::{Event, JOURNAL, MapRequest, map, unobserved};
use portolan_atomic_file::faults::{Fault, Run, fail_at, mend, whole_disk};
use portolan_testing::is_fast;

use crate::Content;

/// So long after it was found the journal has everything.
const WRITTEN: Duration = Duration::from_millis(2200);

#[test]
fn a_run_without_disk_space_for_its_results_is_resumed() {
    if is_fast() {
        return;
    }
    let _disk = whole_disk();
    let recording = Content::new(Run::Later, 3.0).recording;
    let [good, output] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    map(&recording, MapRequest::new(good.path()), &mut unobserved).unwrap();
    let (mut remarks, mut is_full) = (Vec::new(), false);
    let failed = map(&recording, MapRequest::new(output.path()), &mut |event| {
        match event {
            Event::Drawing if !is_full => {
                is_full = true;
                std::thread::sleep(WRITTEN);
                fail_at(0, Fault::Full);
            }
            Event::Remark(remark) => remarks.push(remark.to_string()),
            _ => {}
        }
        ControlFlow::Continue(())
    });
    mend();
    let error = failed.unwrap_err().to_string();
    assert!(error.contains("os error 28"), "{error}");
    assert!(remarks.iter().any(|line| line.ends_with("--resume maps the rest")), "{remarks:?}");
    assert!(output.path().join(JOURNAL).is_file());
    let mut remarks = Vec::new();
    let request = MapRequest { resume: true, ..MapRequest::new(output.path()) };
    map(&recording, request, &mut |event| {
        if let Event::Remark(remark) = event {
            remarks.push(remark.to_string());
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(remarks.iter().any(|line| line.contains("of an earlier run are used again")), "{remarks:?}");
    let read = |folder: &Path, name: &str| std::fs::read(folder.join(name)).unwrap();
    for name in ["map.pbstream", "trajectory.tum", "map.png"] {
        assert!(read(good.path(), name) == read(output.path(), name), "{name}");
    }
    assert!(!output.path().join(JOURNAL).exists());
}
