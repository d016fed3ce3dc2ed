//! Documents say what is so: links resolve, commands are understood, generated pages are those of this program.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::{Path, PathBuf};
use std::process::Command;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// All Markdown files below a folder, but those that programs write.
fn markdown_files(folder: &Path, found: &mut Vec<PathBuf>) {
    files_called(".md", folder, found);
}

fn files_called(ending: &str, folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() && !name.starts_with('.') && !["target", "book"].contains(&name.as_str()) {
            files_called(ending, &path, found);
        } else if name.ends_with(ending) {
            found.push(path);
        }
    }
}

fn documents() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let root = repository();
    ["docs", "crates", "fuzz"].iter().for_each(|folder| markdown_files(&root.join(folder), &mut found));
    let top = std::fs::read_dir(&root).unwrap().map(|e| e.unwrap().path());
    found.extend(top.filter(|path| path.extension().is_some_and(|e| e == "md")));
    found
}

/// Runs the program and gives what it prints, without spaces at the ends of lines; none if it fails.
fn output_of(arguments: &[&str]) -> Option<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_portolan")).args(arguments).output().unwrap();
    output.status.success().then(|| trimmed(&String::from_utf8(output.stdout).unwrap()))
}

fn trimmed(text: &str) -> String {
    let lines: Vec<&str> = text.lines().map(str::trim_end).collect();
    lines.join("\n").trim_end().to_owned()
}

/// Text outside of fenced code and of code within lines.
fn prose(text: &str) -> String {
    let (mut prose, mut in_fence) = (String::new(), false);
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            in_fence = !in_fence;
        } else if !in_fence {
            prose.extend(line.split('`').step_by(2));
            prose.push('\n');
        }
    }
    prose
}

#[test]
fn relative_links_resolve() {
    let mut broken = Vec::new();
    let documents = documents();
    for document in &documents {
        let text = prose(&std::fs::read_to_string(document).unwrap());
        for link in text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(link, _)| link) {
            let path = link.split('#').next().unwrap_or_default();
            let is_elsewhere = path.is_empty() || path.contains("://") || path.starts_with("mailto:");
            if !is_elsewhere && !document.parent().unwrap().join(path).exists() {
                broken.push(format!("{}: {link}", document.display()));
            }
        }
    }
    assert!(documents.len() > 20, "{}", documents.len());
    assert!(broken.is_empty(), "links that lead nowhere:\n{}", broken.join("\n"));
}

/// Commands that begin with `portolan` in the text: lines of shell blocks, and code within lines.
fn commands(text: &str) -> Vec<String> {
    let (mut found, mut in_fence) = (Vec::new(), None);
    for line in text.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            in_fence = if in_fence.is_none() { Some(language == "sh") } else { None };
        } else if in_fence == Some(true) {
            found.push(line.to_owned());
        } else if in_fence.is_none() {
            found.extend(line.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    let without_rest = |line: String| {
        let line = line.split(" #").next().unwrap_or_default();
        line.split(" |").next().unwrap_or_default().trim().to_owned()
    };
    found.into_iter().filter(|line| line.starts_with("portolan ")).map(without_rest).collect()
}

#[test]
fn commands_are_understood() {
    let guides = repository().join("docs/src");
    let mut pages = Vec::new();
    markdown_files(&guides, &mut pages);
    pages.retain(|page| !page.starts_with(guides.join("reference")));
    pages.push(repository().join("README.md"));
    let (mut count, mut wrong) = (0, Vec::new());
    for page in &pages {
        for command in commands(&std::fs::read_to_string(page).unwrap()) {
            // With --help everything before it is read and checked, and nothing is done.
            let mut arguments: Vec<&str> = command.split_whitespace().skip(1).collect();
            arguments.push("--help");
            count += 1;
            if output_of(&arguments).is_none() {
                wrong.push(format!("{}: {command}", page.display()));
            }
        }
    }
    assert!(count > 50, "{count}");
    assert!(wrong.is_empty(), "commands that the program does not understand:\n{}", wrong.join("\n"));
}

/// Words of a text that are options.
fn options_in(text: &str) -> impl Iterator<Item = String> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-' || c == '_'));
    let options = words.filter_map(|word| word.strip_prefix("--")).map(|name| name.trim_end_matches('-'));
    options.filter(|name| name.starts_with(|c: char| c.is_ascii_lowercase())).map(str::to_owned)
}

/// What messages advise can be done. The page of verbs, which lists all options, is current by another test.
#[test]
fn options_that_messages_name_are_there() {
    let verbs = std::fs::read_to_string(repository().join("docs/src/reference/verbs.md")).unwrap();
    let known: std::collections::BTreeSet<String> = options_in(&verbs).collect();
    let mut sources = Vec::new();
    files_called(".rs", &repository().join("crates"), &mut sources);
    // Those of Cartographer's programs are other ones.
    sources.retain(|path| {
        !path
            .components()
            .any(|part| ["tests", "examples", "compat"].contains(&part.as_os_str().to_str().unwrap()))
    });
    let (mut count, mut wrong) = (0, Vec::new());
    for path in &sources {
        let source = std::fs::read_to_string(path).unwrap();
        for line in source.lines().filter(|line| !line.trim_start().starts_with("//")) {
            count += options_in(line).count();
            let unknown = options_in(line).filter(|option| !known.contains(option));
            wrong.extend(unknown.map(|option| format!("{}: --{option}", path.display())));
        }
    }
    assert!(count > 200, "{count}");
    assert!(wrong.is_empty(), "options that no verb has:\n{}", wrong.join("\n"));
}

const ADVICE: &str = "is not current: run scripts/reference.sh";

#[test]
fn the_page_of_options_is_current() {
    let page = std::fs::read_to_string(repository().join("docs/src/reference/options.md")).unwrap();
    let (_, written) = page.split_once("\n\n").unwrap();
    assert!(trimmed(written) == output_of(&["config", "reference"]).unwrap(), "options.md {ADVICE}");
}

#[test]
fn the_page_of_verbs_is_current() {
    let page = std::fs::read_to_string(repository().join("docs/src/reference/verbs.md")).unwrap();
    let mut sections = 0;
    for section in page.split("\n## ").map(|section| section.trim_start_matches("# Verbs")) {
        let (heading, rest) = section.split_once("\n\n").unwrap();
        let (_, block) = rest.split_once("```text\n").unwrap();
        let (written, _) = block.split_once("\n```").unwrap();
        let mut arguments: Vec<&str> = heading.split_whitespace().skip(1).collect();
        arguments.push("--help");
        assert!(Some(written.to_owned()) == output_of(&arguments), "{heading} in verbs.md {ADVICE}");
        sections += 1;
    }
    assert!(sections > 20, "{sections}");
}

/// Examples are tests of documentation: of their own crate, or all together of `portolan`.
#[test]
fn examples_in_the_readmes_of_crates_are_compiled() {
    let crates = repository().join("crates");
    let together = std::fs::read_to_string(crates.join("portolan/src/readmes.rs")).unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(&crates).unwrap() {
        let folder = entry.unwrap().path();
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap_or_default();
        let name = folder.file_name().unwrap().to_string_lossy();
        if read("README.md").contains("\n```rust\n") && read("Cargo.toml").contains("doctest = false") {
            assert!(together.contains(&format!("\"../../{name}/README.md\"")), "{name} is not in readmes.rs");
            count += 1;
        }
    }
    assert!(count > 30, "{count}");
}

/// Rows of all tables, without their heads.
fn table_rows(text: &str) -> Vec<&str> {
    let lines: Vec<&str> = text.lines().collect();
    let is_rule = |line: &str| line.starts_with('|') && line.chars().all(|c| "|-: ".contains(c));
    let is_head = |i: usize| lines.get(i + 1).is_some_and(|next| is_rule(next));
    let rows =
        lines.iter().enumerate().filter(|(i, line)| line.starts_with('|') && !is_head(*i) && !is_rule(line));
    rows.map(|(_, line)| *line).collect()
}

#[test]
fn the_page_of_benchmarks_is_short_and_marks_real_data() {
    let text = std::fs::read_to_string(repository().join("BENCHMARKS.md")).unwrap();
    let rows = table_rows(&text);
    assert!((1..=40).contains(&rows.len()), "{} rows", rows.len());
    for row in rows {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let data = cells.first().copied().unwrap_or_default();
        assert!(data.contains("real") || data.contains("simulated"), "real or simulated? {row}");
        assert!(cells.iter().all(|cell| cell.chars().count() <= 400), "too long: {row}");
        assert!(
            cells.last().is_some_and(|commit| commit.chars().any(|c| c.is_ascii_digit())),
            "of which commit? {row}"
        );
    }
}

#[test]
fn rows_of_tables_can_be_read() {
    for path in documents() {
        let text = std::fs::read_to_string(&path).unwrap();
        let long = text.lines().find(|line| line.trim_start().starts_with('|') && line.chars().count() > 700);
        assert!(long.is_none(), "{}: {}", path.display(), long.unwrap_or_default());
    }
}

/// Lines of the README that are not run: they build the program.
const BUILDING: [&str; 2] = ["cargo test --workspace", "cargo install --path crates/cli"];
/// Of lines that take minutes the beginning does.
const SHORTER: [(&str, &[&str]); 2] =
    [("demo", &["--seconds", "6"]), ("simulate office -o office.bag", &["--seconds", "5", "--beams", "90"])];
/// Files of the user, made of others: what is run before the lines of the README.
const STAND_INS: [&str; 15] = [
    "simulate garage --seconds 20 --beams 200 --seed 5 -o walk.bag",
    "simulate garage --seconds 20 --beams 200 --seed 6 --building-seed 5 -o day2.bag",
    "map walk.bag -o made --cloud a.ply --cloud-voxel 0.05",
    "simulate corridors --seconds 240 --beams 90 --seed 5 -o long.bag",
    "map long.bag -o long",
    "edit long/map.pbstream -o map.pbstream --rotate 0",
    "edit long/map.pbstream -o old.pbstream --rotate 5",
    "edit long/map.pbstream -o version1.pbstream --rotate 5",
    "edit long/map.pbstream -o broken.pbstream --rotate 5",
    "convert long/map.pbstream -o refined.tum",
    "convert long/map.pbstream -o graph.g2o",
    "simulate office --seconds 25 --beams 180 --people 0 -o office_east.bag",
    "map office_east.bag -o east",
    "edit east/map.pbstream -o east.pbstream --rotate 0",
    "edit east/map.pbstream -o west.pbstream --rotate 30 --move=5,-3",
];

/// Times of two poses, and the second pose in the frame of the first.
const RELATIONS: &str = "1700000002 1700000004 0.1 0 0 0 0 0\n1700000005 1700000012 1 0 0 0 0 0.1\n1700000003 1700000018 2 0 0 0 0 0\n";
/// A configuration as Cartographer's users have them.
const MY_ROBOT: &str = r#"include "backpack_3d.lua"
options.num_point_clouds = 1
TRAJECTORY_BUILDER_3D.num_accumulated_range_data = 1
return options
"#;

/// Runs a line in a folder; its exit code, and what it said.
fn run_line(line: &str, folder: &Path) -> (Option<i32>, String) {
    let home = folder.to_string_lossy();
    let words: Vec<String> = line.split_whitespace().map(|word| word.replace('~', &home)).collect();
    let more = SHORTER.iter().filter(|(whole, _)| line == *whole).flat_map(|(_, more)| *more);
    let mut command = Command::new(env!("CARGO_BIN_EXE_portolan"));
    command.args(&words).args(more).current_dir(folder).stdin(std::process::Stdio::null());
    let output = command.output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// What a user would have in the folder before.
fn make_stand_ins(folder: &Path) {
    for line in STAND_INS {
        let (code, stderr) = run_line(line, folder);
        assert_eq!(code, Some(0), "{line}: {stderr}");
    }
    let copy = |from: &str, to: &str| {
        std::fs::copy(folder.join(from), folder.join(to)).unwrap();
    };
    copy("made/a.ply", "before.ply");
    ["a.ply", "b.ply", "c.ply", "after.ply"].iter().for_each(|name| copy("before.ply", name));
    copy("walk.truth.tum", "truth.tum");
    copy("made/trajectory.tum", "walk.tum");
    std::fs::write(folder.join("my_robot.lua"), MY_ROBOT).unwrap();
    std::fs::write(folder.join("walk.relations"), RELATIONS).unwrap();
    let whole = std::fs::read(folder.join("broken.pbstream")).unwrap();
    std::fs::write(folder.join("broken.pbstream"), &whole[..whole.len() * 4 / 5]).unwrap();
    std::fs::create_dir(folder.join("bin")).unwrap();
}

/// Lines of shell blocks, without what is said of them.
fn shell_lines(text: &str) -> Vec<String> {
    let mut in_shell = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if let Some(language) = line.trim_start().strip_prefix("```") {
            in_shell = !in_shell && language == "sh";
        } else if in_shell && !line.trim().is_empty() {
            lines.push(line.split(" #").next().unwrap_or_default().trim().to_owned());
        }
    }
    lines
}

#[test]
fn lines_of_the_readme_run() {
    if portolan_testing::is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    make_stand_ins(folder.path());
    let lines = shell_lines(&std::fs::read_to_string(repository().join("README.md")).unwrap());
    let (mut count, mut wrong) = (0, Vec::new());
    for line in lines.iter().filter(|line| !BUILDING.contains(&line.as_str())) {
        let words = line.strip_prefix("portolan ").or(line.strip_prefix("cargo run --release -- "));
        let Some(words) = words else {
            wrong.push(format!("{line}: is not run by this test"));
            continue;
        };
        count += 1;
        let (code, stderr) = run_line(words, folder.path());
        // Of a damaged map something is missing.
        let expected = if words.contains("broken") { Some(3) } else { Some(0) };
        if code != expected {
            wrong.push(format!("{line}: exit code {code:?}: {stderr}"));
        }
    }
    assert!(count > 25, "{count}");
    assert!(wrong.is_empty(), "lines that do not run:\n{}", wrong.join("\n"));
}
