//! How much is done.

use std::path::PathBuf;

/// Cases of a short run.
const SHORT: u64 = 300;
const FEW_KILLS: u64 = 8;
const FEW_RESUMES: u64 = 6;

/// What `PORTOLAN_TORTURE` says: `cases=100000,from=5000,kills=200,resumes=200,seed=7,keep=FOLDER,only=NUMBER,program=FILE`.
#[derive(Clone, Debug)]
pub struct Settings {
    /// How many.
    pub cases: u64,
    /// The first, so that what was cut off goes on.
    pub from: u64,
    /// How many runs are killed.
    pub kills: u64,
    /// How many are killed and resumed.
    pub resumes: u64,
    /// What they follow from.
    pub seed: u64,
    /// The program; that of the tests unless another is named.
    pub program: PathBuf,
    /// Folder for the files of cases that went wrong.
    pub keep: Option<PathBuf>,
}

impl Settings {
    /// Of the environment.
    ///
    /// # Panics
    /// On what is not understood.
    pub fn from_environment() -> Self {
        let mut settings = Self {
            cases: SHORT,
            from: 0,
            kills: FEW_KILLS,
            resumes: FEW_RESUMES,
            seed: 1,
            program: env!("CARGO_BIN_EXE_portolan").into(),
            keep: None,
        };
        let text = std::env::var("PORTOLAN_TORTURE").unwrap_or_default();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=').unwrap();
            match key {
                "cases" => settings.cases = value.parse().unwrap(),
                "kills" => settings.kills = value.parse().unwrap(),
                "resumes" => settings.resumes = value.parse().unwrap(),
                "seed" => settings.seed = value.parse().unwrap(),
                "from" => settings.from = value.parse().unwrap(),
                "only" => (settings.from, settings.cases) = (value.parse().unwrap(), 1),
                "program" => settings.program = value.into(),
                "keep" => settings.keep = Some(value.into()),
                _ => {
                    panic!(
                        "PORTOLAN_TORTURE knows cases, from, kills, resumes, seed, only, keep and program, not {key}"
                    )
                }
            }
        }
        settings
    }
}
