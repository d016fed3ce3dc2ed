//! Whether what a run left as its results can be used: whole, finite, and where it says that nothing was lost, without an error that
//! `portolan check` finds.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What is wrong with the first bad file of the results in a folder. Maps are only looked into if the run is said to be done without
/// loss.
pub fn fault(program: &Path, folder: &Path, is_done: bool) -> Option<String> {
    files(folder).iter().find_map(|file| {
        let name = file.strip_prefix(folder).unwrap_or(file).display();
        fault_of(program, file, is_done).map(|fault| format!("result {name}: {fault}"))
    })
}

/// Files whose names begin with `out`, or which are in a folder of such a name.
fn files(folder: &Path) -> Vec<PathBuf> {
    let is_result =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("out"));
    let (folders, files): (Vec<_>, Vec<_>) =
        entries(folder).filter(is_result).partition(|path| path.is_dir());
    files
        .into_iter()
        .chain(folders.iter().flat_map(|folder| entries(folder)).filter(|path| path.is_file()))
        .collect()
}

fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths.into_iter()
}

fn fault_of(program: &Path, file: &Path, is_done: bool) -> Option<String> {
    match file.extension()?.to_str()? {
        "pbstream" if is_done => findings(program, file),
        "json" | "geojson" => {
            let parsed = serde_json::from_slice::<serde_json::Value>(&std::fs::read(file).unwrap());
            parsed.err().map(|error| error.to_string())
        }
        "tum" => std::fs::read_to_string(file).unwrap().lines().find_map(bad_pose),
        "png" => (!std::fs::read(file).unwrap().ends_with(b"IEND\xae\x42\x60\x82")).then(|| "cut".to_owned()),
        _ => None,
    }
}

/// What `check` finds in a map.
fn findings(program: &Path, file: &Path) -> Option<String> {
    let run = Command::new(program).arg("check").arg(file).stdin(Stdio::null()).output().unwrap();
    let output = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
    (run.status.code() != Some(0)).then(|| format!("check says {:?}: {output}", run.status.code()))
}

fn bad_pose(line: &str) -> Option<String> {
    let numbers: Vec<f64> = line.split(' ').map_while(|word| word.parse().ok()).collect();
    let is_right =
        line.starts_with('#') || numbers.len() == 8 && numbers.iter().all(|number| number.is_finite());
    (!is_right).then(|| line.to_owned())
}
