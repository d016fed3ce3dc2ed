//! Manages the folder of results: which files were written by an earlier run, and which were not and must not
//! be overwritten.
//!
//! A small file there ([`MANIFEST`]) lists what was written, by which verb, with size and checksum. A file
//! that it does not list, or that was changed since, is not overwritten unless the user asks for it.

mod claim;
mod manifest;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use portolan_atomic_file::{Leftovers, remove_leftovers};

use super::error::{JobError, write_file};
use super::event::{Observer, Remark, remark};
use super::saved_map::is_same_file;
use claim::Claim;
pub use manifest::MANIFEST;
use manifest::{Content, Manifest, Record, is_no_file, is_plain};

/// Treatment of files that an earlier run of the same verb left and this one does not write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stale {
    /// They are removed, unless they were changed since.
    Remove,
    /// They are reported: this run has no result that replaces them.
    Name,
}

/// A folder for results.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    verb: &'static str,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    manifest: Manifest,
    /// Files of this run.
    written: BTreeSet<String>,
    /// Files that are being written: their checksums are not known yet.
    open: BTreeSet<String>,
    /// Keeps other runs out.
    claim: Claim,
}

impl OutputFolder {
    /// Checks a folder before a verb (`map`) begins its work. Nothing is created or changed there, but
    /// temporary files that a killed run left are removed. `names` are the files that will be written; with
    /// `force` existing files of these names are overwritten.
    ///
    /// # Errors
    /// A file of such a name was not written by an earlier run of this verb, was changed since, or cannot be read; another
    /// run is writing there.
    pub fn begin<N: AsRef<str>>(
        path: impl Into<PathBuf>,
        verb: &'static str,
        names: &[N],
        force: bool,
        observe: &mut Observer,
    ) -> Result<Self, JobError> {
        let path = path.into();
        if path.exists() && !path.is_dir() {
            let reason = std::io::Error::other("this is not a folder; results are written to a folder");
            return Err(JobError::file(&path, reason));
        }
        let mut claim = Claim::default();
        if !names.is_empty() {
            claim.make(&path)?;
        }
        let Leftovers { removed, left } = remove_leftovers(&path);
        if !removed.is_empty() {
            remark(observe, Remark::LeftoversRemoved { folder: path.clone(), count: removed.len() });
        }
        left.into_iter().for_each(|file| remark(observe, Remark::LeftoverKept(file)));
        let manifest =
            Manifest::read(&path).map_err(|source| JobError::file(&path.join(MANIFEST), source))?;
        if !force {
            let files = foreign_files(manifest.as_ref(), &path, verb, names)?;
            if !files.is_empty() {
                return Err(JobError::ForeignFiles { folder: path, verb, files });
            }
        }
        let state = Mutex::new(State { manifest: manifest.unwrap_or_default(), claim, ..State::default() });
        Ok(Self { path, verb, state })
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The path of a file that is written next; files returned before are complete by then.
    ///
    /// # Errors
    /// The folder cannot be made or written to, or another run is writing there.
    pub fn file(&self, name: &str) -> Result<PathBuf, JobError> {
        self.files(&[name])?;
        Ok(self.path.join(name))
    }

    /// As [`OutputFolder::file`], and adds the path to a list.
    ///
    /// # Errors
    /// As [`OutputFolder::file`].
    pub fn add(&self, name: &str, files: &mut Vec<PathBuf>) -> Result<PathBuf, JobError> {
        let path = self.file(name)?;
        files.push(path.clone());
        Ok(path)
    }

    /// Announces several files that are written next. A name that leads out of the folder is the user's own
    /// choice and not recorded.
    ///
    /// # Errors
    /// As [`OutputFolder::file`].
    pub fn files<N: AsRef<str>>(&self, names: &[N]) -> Result<(), JobError> {
        std::fs::create_dir_all(&self.path).map_err(|source| JobError::file(&self.path, source))?;
        let mut state = self.lock();
        state.claim.make(&self.path)?;
        self.close_files(&mut state);
        for name in names.iter().map(AsRef::as_ref).filter(|name| is_plain(name)) {
            let record = Record { by: self.verb.to_owned(), content: None };
            state.manifest.files.insert(name.to_owned(), record);
            state.open.insert(name.to_owned());
            state.written.insert(name.to_owned());
        }
        self.save(&state)
    }

    /// Ends the writing. Files that an earlier run left and this one did not write are removed or reported.
    /// `inputs` of this run stay.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn finish(&self, stale: Stale, inputs: &[PathBuf], observe: &mut Observer) -> Result<(), JobError> {
        let mut state = self.lock();
        self.close_files(&mut state);
        let is_stale = |(name, record): &(&String, &Record)| {
            record.by == self.verb && !state.written.contains(*name) && is_plain(name)
        };
        let old: Vec<(String, Record)> =
            state.manifest.files.iter().filter(is_stale).map(|(n, r)| (n.clone(), r.clone())).collect();
        let (mut removed, mut left) = (Vec::new(), Vec::new());
        for (name, record) in old {
            let path = self.path.join(&name);
            if !path.exists() {
                state.manifest.files.remove(&name);
                continue;
            }
            let is_input = inputs.iter().any(|input| is_same_file(input, &path));
            let is_removable = stale == Stale::Remove && !is_input && record.is_of(&path).unwrap_or(false);
            if is_removable && std::fs::remove_file(&path).is_ok() {
                state.manifest.files.remove(&name);
                removed.push(name);
            } else {
                left.push(name);
            }
        }
        if !removed.is_empty() {
            remark(observe, Remark::EarlierRemoved { folder: self.path.clone(), files: removed });
        }
        if !left.is_empty() {
            remark(observe, Remark::EarlierLeft { folder: self.path.clone(), files: left });
        }
        self.save(&state)?;
        state.claim = Claim::default();
        Ok(())
    }

    /// Records size and checksum of complete files. A file that does not exist was not written after all; the
    /// checksum of a file that cannot be read stays unknown.
    fn close_files(&self, state: &mut State) {
        for name in std::mem::take(&mut state.open) {
            match Content::of(&self.path.join(&name)) {
                Ok(content) => {
                    let record = Record { by: self.verb.to_owned(), content: Some(content) };
                    state.manifest.files.insert(name, record);
                }
                Err(error) if is_no_file(&error) => drop(state.manifest.files.remove(&name)),
                Err(_) => {}
            }
        }
    }

    fn save(&self, state: &State) -> Result<(), JobError> {
        write_file(&self.path.join(MANIFEST), &serde_json::to_vec_pretty(&state.manifest)?)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Files of these names that the verb did not write, or that were changed since. Without a manifest, a file
/// in its place is one of them.
fn foreign_files<N: AsRef<str>>(
    manifest: Option<&Manifest>,
    folder: &Path,
    verb: &str,
    names: &[N],
) -> Result<Vec<String>, JobError> {
    let empty = Manifest::default();
    let known = manifest.unwrap_or(&empty);
    let mut files = Vec::new();
    for name in names.iter().map(AsRef::as_ref).filter(|name| is_plain(name)) {
        let is_foreign = known.is_foreign(folder, name, verb);
        if is_foreign.map_err(|source| JobError::file(&folder.join(name), source))? {
            files.push(name.to_owned());
        }
    }
    files.extend(manifest.is_none().then(|| MANIFEST.to_owned()));
    Ok(files)
}

#[cfg(test)]
mod tests;
