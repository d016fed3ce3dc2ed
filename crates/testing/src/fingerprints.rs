//! Regression test of results byte for byte: detects unintended changes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Compares checksums and sizes of results with those of a table in the repository.
///
/// If `PORTOLAN_BLESS` is set (`PORTOLAN_BLESS=1`), the table is updated instead; rows of cases that were not run stay
/// unchanged.
#[derive(Debug)]
pub struct Fingerprints {
    table: PathBuf,
    found: BTreeMap<(String, String), String>,
}

impl Fingerprints {
    /// Compares with the table in this file.
    pub fn of_table(table: &str) -> Self {
        Self { table: table.into(), found: BTreeMap::new() }
    }

    /// Adds files of a folder as the results of a case.
    ///
    /// # Panics
    ///
    /// If one cannot be read.
    #[track_caller]
    pub fn add(&mut self, case: &str, folder: &Path, files: &[&str]) {
        for file in files {
            let bytes =
                std::fs::read(folder.join(file)).unwrap_or_else(|error| panic!("{case} {file}: {error}"));
            let print = format!("{:08x} {}", crc32fast::hash(&bytes), bytes.len());
            self.found.insert((case.to_owned(), (*file).to_owned()), print);
        }
    }

    fn written(&self) -> BTreeMap<(String, String), String> {
        let file = std::fs::read_to_string(&self.table).unwrap_or_default();
        let row = |line: &str| {
            let (case, rest) = line.split_once(' ')?;
            let (file, print) = rest.split_once(' ')?;
            Some(((case.to_owned(), file.to_owned()), print.to_owned()))
        };
        file.lines().filter(|line| !line.starts_with('#')).filter_map(row).collect()
    }

    /// Compares the results with the table, or updates the table.
    ///
    /// # Panics
    ///
    /// If a result differs from the table.
    pub fn check(self) {
        let mut expected = self.written();
        if std::env::var_os("PORTOLAN_BLESS").is_some() {
            expected.extend(self.found);
            let rows = expected.iter().map(|((case, file), print)| format!("{case} {file} {print}\n"));
            let head = "# case, file, CRC-32, bytes; written by fingerprints.rs\n".to_owned();
            std::fs::write(&self.table, std::iter::once(head).chain(rows).collect::<String>()).unwrap();
            return;
        }
        let changed: Vec<String> = self
            .found
            .iter()
            .filter(|(key, print)| expected.get(*key) != Some(*print))
            .map(|((case, file), print)| format!("{case} {file}: {print}"))
            .collect();
        assert!(changed.is_empty(), "results changed; if that is wanted see TESTING.md:\n{changed:#?}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_byte_shows() {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("table.txt");
        std::fs::write(&table, "# head\ncase a.txt 352441c2 3\n").unwrap();
        std::fs::write(folder.path().join("a.txt"), "abc").unwrap();
        let check = || {
            let mut prints = Fingerprints::of_table(table.to_str().unwrap());
            prints.add("case", folder.path(), &["a.txt"]);
            prints.check();
        };
        check();
        std::fs::write(folder.path().join("a.txt"), "abd").unwrap();
        assert!(std::panic::catch_unwind(check).is_err());
    }
}
