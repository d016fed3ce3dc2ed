use std::fs;
use std::time::Duration;

use super::*;

fn identity(options: &str) -> Identity {
    Identity::from_parts(&[("the recording", "walk.bag"), ("the options", options)])
}

/// A folder with the journal of a short run that gave these answers.
fn left(answers: &[f64]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::begin(folder.path(), &identity("usual"), 0);
    let memory = journal.memory();
    for (question, answer) in answers.iter().enumerate() {
        memory.keep(Some(question as u64), answer);
    }
    std::thread::sleep(Duration::from_millis(1200));
    memory.keep(Some(u64::MAX), &0.0);
    assert_eq!(closed(&journal).unwrap(), Some(folder.path().join(JOURNAL)));
    folder
}

/// The file of a closed journal, or the error because of which it is incomplete.
fn closed(journal: &Journal) -> std::io::Result<Option<std::path::PathBuf>> {
    let (file, written) = journal.close();
    written.map(|()| file)
}

fn answers(journal: &Journal) -> Vec<f64> {
    (0..10).filter_map(|question| journal.memory().recall(Some(question))).collect()
}

#[test]
fn recorded_answers_are_read_and_more_are_added() {
    let folder = left(&[1.5, -0.0]);
    let (journal, resumed) = Journal::resume(folder.path(), &identity("usual"), 0).unwrap();
    assert_eq!(resumed, Resumed { answers: 3, cut_off: 0 });
    assert_eq!(answers(&journal), [1.5, -0.0]);
    journal.memory().keep(Some(0), &7.0);
    journal.memory().keep(Some(2), &2.5);
    drop(journal);
    let (journal, resumed) = Journal::resume(folder.path(), &identity("usual"), 0).unwrap();
    assert_eq!((answers(&journal), resumed.answers), (vec![1.5, -0.0, 2.5], 4));
}

#[test]
fn damaged_or_missing_records_at_the_end_are_cut_off() {
    let folder = left(&[1.5, 2.5, 3.5]);
    let path = folder.path().join(JOURNAL);
    let whole = fs::read(&path).unwrap();
    for end in 0..whole.len() {
        fs::write(&path, &whole[..end]).unwrap();
        match Journal::resume(folder.path(), &identity("usual"), 0) {
            Ok((journal, resumed)) => {
                let wanted = [1.5, 2.5, 3.5];
                assert_eq!(answers(&journal), wanted[..resumed.answers.min(3)]);
                assert!(resumed.cut_off < 24, "{end}");
            }
            Err(error) => assert!(matches!(error, JobError::NoJournal(_)), "{error}"),
        }
    }
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x10;
        fs::write(&path, &damaged).unwrap();
        if let Ok((journal, _)) = Journal::resume(folder.path(), &identity("usual"), 0) {
            assert!([1.5, 2.5, 3.5].starts_with(&answers(&journal)), "{at}");
        }
    }
}

#[test]
fn journals_of_other_jobs_are_refused_with_the_difference() {
    let folder = left(&[1.5]);
    let resume = |identity: &Identity| Journal::resume(folder.path(), identity, 0).map(|_| ());
    let error = resume(&identity("others")).unwrap_err().to_string();
    assert!(error.contains("of another job: the options differ"), "{error}");
    resume(&identity("usual")).unwrap();
    let empty = tempfile::tempdir().unwrap();
    let error = Journal::resume(empty.path(), &identity("usual"), 0).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("there is no run to resume"), "{error}");
}

#[test]
fn a_refused_journal_is_not_changed() {
    let folder = left(&[1.5]);
    let path = folder.path().join(JOURNAL);
    let mut damaged = fs::read(&path).unwrap();
    *damaged.last_mut().unwrap() ^= 1;
    fs::write(&path, &damaged).unwrap();
    Journal::resume(folder.path(), &identity("others"), 0).map(|_| ()).unwrap_err();
    assert!(fs::read(&path).unwrap() == damaged);
    let (_, resumed) = Journal::resume(folder.path(), &identity("usual"), 0).unwrap();
    assert!(resumed.cut_off > 0 && fs::read(&path).unwrap().len() < damaged.len());
}

#[test]
fn one_process_writes_at_a_time_and_foreign_files_are_kept() {
    let folder = left(&[1.5]);
    let (_journal, _) = Journal::resume(folder.path(), &identity("usual"), 0).unwrap();
    let error = Journal::resume(folder.path(), &identity("usual"), 0).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("another process is writing it"), "{error}");
    let foreign = tempfile::tempdir().unwrap();
    fs::write(foreign.path().join(JOURNAL), "my own notes").unwrap();
    let journal = Journal::begin(foreign.path(), &identity("usual"), 0);
    std::thread::sleep(Duration::from_millis(1100));
    journal.memory().keep(Some(1), &1.0);
    assert!(closed(&journal).unwrap_err().to_string().contains("no journal"));
    assert_eq!(fs::read_to_string(foreign.path().join(JOURNAL)).unwrap(), "my own notes");
}

#[test]
fn a_short_run_leaves_no_journal() {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::begin(folder.path(), &identity("usual"), 0);
    journal.memory().keep(Some(1), &1.0);
    assert_eq!(closed(&journal).unwrap(), None);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn damaged_journals_are_truncated_or_refused() {
    use portolan_testing::damage::{Layout, Random, damaged};
    let known = [1.5, -0.0, 7.25];
    let folder = left(&known);
    let path = folder.path().join(JOURNAL);
    let whole = fs::read(&path).unwrap();
    let cases = if std::env::var("PORTOLAN_TESTS").is_ok_and(|tests| tests == "fast") { 200 } else { 5000 };
    for number in 0..cases {
        let mut random = Random::new(1, number);
        let layout = if random.once_in(2) { Layout::Pages(24) } else { Layout::HeaderThenRows };
        fs::write(&path, damaged(&whole, layout, &mut random)).unwrap();
        let Ok((journal, resumed)) = Journal::resume(folder.path(), &identity("usual"), 0) else { continue };
        // A record is complete or missing; it may occur twice.
        let found = answers(&journal);
        assert!(found.iter().all(|answer| known.contains(answer)), "case {number}: {found:?}");
        assert!(resumed.answers <= known.len() + 1, "case {number}: {resumed:?}");
    }
}

#[test]
fn disk_space_for_the_results_is_reserved() {
    let folder = tempfile::tempdir().unwrap();
    let journal = Journal::begin(folder.path(), &identity("usual"), u64::MAX / 2);
    journal.memory().keep(Some(1), &2.5);
    std::thread::sleep(Duration::from_millis(1200));
    journal.memory().keep(Some(2), &2.5);
    let error = closed(&journal).unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::StorageFull);
    assert!(error.to_string().contains("are free"), "{error}");
}

/// Environment variable of the fault: `begin` or `resume`, the kind of fault, the number of the operation, a folder.
const FAULT: &str = "PORTOLAN_JOURNAL_FAULT";

/// Runs in a process of its own, because the faults are those of the whole process. Prints the number of operations
/// and the message.
#[test]
fn a_process_whose_disk_fails() {
    use portolan_atomic_file::faults::{Fault, fail_at, mend};
    let Ok(wanted) = std::env::var(FAULT) else { return };
    let [how, fault, at, folder] = wanted.splitn(4, ' ').collect::<Vec<_>>()[..] else { panic!("{wanted}") };
    let fault = [Fault::Full, Fault::Broken, Fault::BrokenOnce, Fault::InterruptedAndShort]
        .into_iter()
        .find(|known| format!("{known:?}") == fault)
        .unwrap();
    let folder = std::path::Path::new(folder);
    fail_at(at.parse().unwrap(), fault);
    let journal = match how {
        "begin" => Ok(Journal::begin(folder, &identity("usual"), 0)),
        _ => Journal::resume(folder, &identity("usual"), 0).map(|(journal, _)| journal),
    };
    let answer = match journal {
        Err(error) => format!("refused: {error}"),
        Ok(journal) => {
            (10..13).for_each(|question| journal.memory().keep(Some(question), &(question as f64)));
            if how == "begin" {
                // The file appears after one second; the next writing would be one later.
                std::thread::sleep(Duration::from_millis(1600));
            }
            (13..15).for_each(|question| journal.memory().keep(Some(question), &(question as f64)));
            match journal.close() {
                (file, Ok(())) => format!("written: {}", file.is_some()),
                (file, Err(error)) => format!("lost: {}: {error}", file.is_some()),
            }
        }
    };
    let line = format!("{FAULT} {} {answer}\n", mend());
    std::io::Write::write_all(&mut std::io::stdout(), line.as_bytes()).unwrap();
}

/// Starts a process that begins or resumes a journal in a folder on a disk that fails.
fn with_failing_disk(how: &str, fault: &str, at: u64, folder: &std::path::Path) -> std::process::Child {
    std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "job::journal::tests::a_process_whose_disk_fails"])
        .env("RUST_TEST_NOCAPTURE", "1")
        .env(FAULT, format!("{how} {fault} {at} {}", folder.display()))
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap()
}

/// The number of operations, and the message.
fn answer(process: std::process::Child) -> (u64, String) {
    let output = String::from_utf8(process.wait_with_output().unwrap().stdout).unwrap();
    let line = output.lines().find_map(|line| line.split_once(&format!("{FAULT} "))).unwrap_or_default().1;
    let (operations, answer) = line.split_once(' ').unwrap_or_else(|| panic!("{output}"));
    (operations.parse().unwrap(), answer.to_owned())
}

/// Answers of [`a_process_whose_disk_fails`] in a journal.
fn later_answers(journal: &Journal) -> Vec<f64> {
    (10..15).filter_map(|question| journal.memory().recall(Some(question))).collect()
}

const LATER: [f64; 5] = [10.0, 11.0, 12.0, 13.0, 14.0];

#[test]
fn journals_on_a_failing_disk_are_resumed_up_to_the_last_complete_record() {
    for how in ["begin", "resume"] {
        let before = left(&[1.5, 2.5]);
        let whole = fs::read(before.path().join(JOURNAL)).unwrap();
        // An older journal is replaced, or resumed.
        let prepared = || {
            let folder = tempfile::tempdir().unwrap();
            fs::write(folder.path().join(JOURNAL), &whole).unwrap();
            folder
        };
        let folder = prepared();
        let (operations, good) = answer(with_failing_disk(how, "Full", u64::MAX, folder.path()));
        assert!(operations >= 4 && good == "written: true", "{how}: {operations}, {good}");
        let cases = ["Full", "Broken", "BrokenOnce"].into_iter();
        let cases = cases.flat_map(|fault| (0..operations).map(move |at| (fault, at)));
        let cases = cases.chain([("InterruptedAndShort", 0)]).map(|(fault, at)| {
            let folder = prepared();
            (fault, at, with_failing_disk(how, fault, at, folder.path()), folder)
        });
        // All in parallel, as each waits for its journal to be written.
        for (fault, at, process, folder) in cases.collect::<Vec<_>>() {
            let (case, (_, answer)) = (format!("{how}, {fault} at {at}"), answer(process));
            let path = folder.path().join(JOURNAL);
            assert_eq!(answer.starts_with("written"), fault == "InterruptedAndShort", "{case}: {answer}");
            let is_named = answer.contains(JOURNAL) || answer.starts_with("lost");
            assert!(
                answer.starts_with("written") || is_named && answer.contains("os error"),
                "{case}: {answer}"
            );
            if answer.starts_with("refused") {
                // Its content is unknown, so it stays.
                assert!(fs::read(&path).unwrap() == whole, "{case}: {answer}");
            }
            match Journal::resume(folder.path(), &identity("usual"), 0) {
                Ok((journal, _)) => {
                    let (old, new) = (answers(&journal), later_answers(&journal));
                    assert!(old == [1.5, 2.5] || how == "begin" && old.is_empty(), "{case}: {old:?}");
                    assert!(LATER.starts_with(&new), "{case}: {new:?}");
                    assert!(!answer.starts_with("lost: false") || old.len() == 2, "{case}: {answer}");
                }
                Err(error) => {
                    assert!(
                        matches!(error, JobError::NoJournal(_)) && answer.starts_with("lost: false"),
                        "{case}: {error}, {answer}"
                    );
                    assert!(!path.exists(), "{case}: {answer}");
                }
            }
        }
    }
}
