use std::ops::ControlFlow;

use super::*;
use crate::job::Event;

const NAMES: [&str; 2] = ["map.pbstream", "map.png"];

/// Begins a run; returns it and the remarks.
fn begin(path: &Path, verb: &'static str, force: bool) -> (Result<OutputFolder, JobError>, Vec<String>) {
    let mut remarks = Vec::new();
    let begun = OutputFolder::begin(path, verb, &NAMES, force, &mut |event| collect(event, &mut remarks));
    (begun, remarks)
}

fn collect(event: &Event, remarks: &mut Vec<String>) -> ControlFlow<()> {
    remarks.extend(if let Event::Remark(remark) = event { Some(remark.to_string()) } else { None });
    ControlFlow::Continue(())
}

fn write(folder: &OutputFolder, name: &str) {
    write_file(&folder.file(name).unwrap(), name.as_bytes()).unwrap();
}

fn finish(folder: &OutputFolder, stale: Stale, inputs: &[PathBuf]) -> Vec<String> {
    let mut remarks = Vec::new();
    folder.finish(stale, inputs, &mut |event| collect(event, &mut remarks)).unwrap();
    remarks
}

/// A folder with these files of a run.
fn written(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let run = begin(folder.path(), "map", false).0.unwrap();
    names.iter().for_each(|name| write(&run, name));
    assert!(finish(&run, Stale::Remove, &[]).is_empty());
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn foreign_files_are_refused_and_named() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("map.png"), "holiday").unwrap();
    std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
    let error = begin(folder.path(), "map", false).0.unwrap_err().to_string();
    assert!(error.contains("map.png") && error.contains("--force") && !error.contains("notes"), "{error}");
    assert_eq!(names(folder.path()), ["map.png", "notes.txt"], "nothing was done");
    let run = begin(folder.path(), "map", true).0.unwrap();
    write(&run, "map.png");
    finish(&run, Stale::Remove, &[]);
    assert_eq!(std::fs::read_to_string(folder.path().join("map.png")).unwrap(), "map.png");
    assert!(folder.path().join("notes.txt").exists());
    begin(folder.path(), "map", false).0.unwrap();
}

#[test]
fn files_of_an_earlier_run_are_overwritten_unless_they_were_changed() {
    let folder = written(&NAMES);
    begin(folder.path(), "map", false).0.unwrap();
    std::fs::write(folder.path().join("map.png"), "MAP.PNG").unwrap();
    let error = begin(folder.path(), "map", false).0.unwrap_err().to_string();
    assert!(error.contains("map.png") && !error.contains("map.pbstream"), "{error}");
}

#[test]
fn results_of_another_verb_are_foreign() {
    let folder = written(&NAMES);
    let error = begin(folder.path(), "refine", false).0.unwrap_err().to_string();
    assert!(error.contains("portolan refine") && error.contains("map.pbstream"), "{error}");
}

#[test]
fn files_of_an_earlier_run_are_removed() {
    let folder = written(&["map.pbstream", "map.png", "cloud.ply", "changed.png", "input.tum"]);
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("changed.png"), "by hand").unwrap();
    let run = begin(folder.path(), "map", false).0.unwrap();
    write(&run, "map.pbstream");
    let remarks = finish(&run, Stale::Name, &[]);
    assert!(
        remarks.len() == 1 && remarks[0].contains("cloud.ply") && at("cloud.ply").exists(),
        "{remarks:?}"
    );
    let run = begin(folder.path(), "map", false).0.unwrap();
    write(&run, "map.pbstream");
    let remarks = finish(&run, Stale::Remove, &[folder.path().join(".").join("input.tum")]);
    assert!(remarks.len() == 2 && remarks[0].contains("cloud.ply, map.png"), "{remarks:?}");
    assert!(remarks[1].contains("changed.png, input.tum"), "{remarks:?}");
    assert_eq!(names(folder.path()), ["changed.png", "input.tum", "map.pbstream", MANIFEST]);
}

#[test]
fn a_killed_run_does_not_block_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let run = begin(folder.path(), "map", false).0.unwrap();
    write(&run, "map.pbstream");
    // Killed before or after the file got its name.
    run.file("map.png").unwrap();
    drop(run);
    begin(folder.path(), "map", false).0.unwrap();
    std::fs::write(folder.path().join("map.png"), "whole").unwrap();
    std::fs::write(folder.path().join(".portolan-half.tmp"), "half").unwrap();
    let (run, remarks) = begin(folder.path(), "map", false);
    assert!(run.is_ok() && remarks.len() == 1 && remarks[0].contains("1 temporary file"), "{remarks:?}");
    assert_eq!(names(folder.path()), ["map.pbstream", "map.png", MANIFEST]);
}

#[test]
fn damaged_manifests_never_remove_files_elsewhere() {
    let folder = written(&NAMES);
    let victim = tempfile::NamedTempFile::new().unwrap();
    let content = serde_json::to_string(&Content::of(victim.path()).unwrap()).unwrap();
    let name = serde_json::to_string(victim.path()).unwrap();
    let text = format!("{{\"about\":\"\",\"files\":{{{name}:{{\"by\":\"map\",\"content\":{content}}}}}}}");
    std::fs::write(folder.path().join(MANIFEST), text).unwrap();
    let run = begin(folder.path(), "map", true).0.unwrap();
    assert!(finish(&run, Stale::Remove, &[]).is_empty());
    assert!(victim.path().exists());
    std::fs::write(folder.path().join(MANIFEST), "{\"files\":").unwrap();
    let error = begin(folder.path(), "map", false).0.unwrap_err().to_string();
    assert!(error.contains(MANIFEST), "{error}");
    assert!(["a/b", "../a", "/a", "..", ""].iter().all(|name| !is_plain(name)) && is_plain("a b.c"));
}

#[test]
fn one_run_at_a_time_writes_to_a_folder() {
    let folder = written(&["map.png"]);
    let first = begin(folder.path(), "map", false).0.unwrap();
    let error = begin(folder.path(), "localize", true).0.unwrap_err().to_string();
    assert!(error.contains("another run"), "{error}");
    drop(first);
    drop(begin(folder.path(), "map", false).0.unwrap());
    // A folder that did not exist when both runs began.
    let new = folder.path().join("new");
    let [first, second] = [(), ()].map(|()| begin(&new, "map", false).0.unwrap());
    write(&first, "map.png");
    let error = second.file("map.pbstream").unwrap_err().to_string();
    assert!(error.contains("another run"), "{error}");
    assert_eq!(names(&new), ["map.png", MANIFEST]);
}
