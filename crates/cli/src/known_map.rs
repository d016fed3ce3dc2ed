//! Maps that a recording is added to: loading them, and saying whether the recording was found in them.

use std::path::{Path, PathBuf};

use portolan::pipeline::{KnownMap, MappedRecording};
use portolan_config::Options;
use portolan_geometry::Rigid3;
use portolan_mapfile::{FrozenTrajectories, LoadedTrajectories, MapReader, MapSpace, load_map};
use portolan_mapping::{Space, TrajectoryId};

use crate::commands::argument::{frozen_trajectories, start_pose};
use crate::error::CliError;
use crate::progress::say;

/// Going on with maps that were made before.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Known maps")]
pub struct KnownMapArgs {
    /// Add the recording to this map; may be given several times. The recording becomes a trajectory of
    /// its own, after those of the map, and is searched in the whole map until it is found.
    #[arg(long, value_name = "MAP.pbstream")]
    pub from: Vec<PathBuf>,
    /// Leave the known maps as they are: the recording is only localised in them and extends them.
    /// `--frozen=0,2` leaves only these trajectories of one map as they are.
    #[arg(long, value_name = "TRAJECTORIES", requires = "from", value_parser = frozen_trajectories,
        num_args = 0..=1, require_equals = true, default_missing_value = "all")]
    pub frozen: Option<FrozenTrajectories>,
    /// Where in the known map the recording starts: metres and degrees; also X,Y,Z,YAW or X,Y,Z,ROLL,PITCH,YAW.
    /// Without it, it is searched.
    #[arg(long, value_name = "X,Y,YAW", requires = "from", value_parser = start_pose,
        allow_hyphen_values = true)]
    pub start: Option<Rigid3>,
}

impl KnownMapArgs {
    /// Submaps of all known maps together.
    ///
    /// # Errors
    /// A map that cannot be read.
    pub fn count_submaps(&self) -> Result<usize, CliError> {
        let mut submaps = 0;
        for path in &self.from {
            let reader = MapReader::open(path).map_err(|e| CliError::in_file(path, e))?;
            submaps += reader.pose_graph().trajectory.iter().map(|t| t.submap.len()).sum::<usize>();
        }
        Ok(submaps)
    }

    /// Loads what the command line names; says what it holds and what had to be repaired.
    ///
    /// # Errors
    /// A map that is damaged or of the other dimension; single trajectories to be frozen of several maps.
    pub fn load<S: MapSpace>(&self, options: &Options, quiet: bool) -> Result<KnownMap<S>, CliError> {
        let frozen = self.frozen.clone().unwrap_or_default();
        if matches!(frozen, FrozenTrajectories::Only(_)) && self.from.len() > 1 {
            let text = "--frozen=TRAJECTORIES does not tell which of the maps it means; freeze all, or go on with one";
            return Err(CliError::Usage(text.to_owned()));
        }
        let mut known = KnownMap { start: self.start, ..KnownMap::empty(options) };
        for path in &self.from {
            let failed = |e| CliError::in_file(path, e);
            let mut reader = MapReader::open(path).map_err(|e| CliError::in_file(path, e))?;
            let loaded = load_map(&mut reader, &mut known.graph, &frozen).map_err(failed)?;
            tell(path, &loaded, quiet);
            known.trajectories.extend(loaded.trajectories);
        }
        Ok(known)
    }
}

/// What a map held, and the numbers that its trajectories have now.
fn tell(path: &Path, loaded: &LoadedTrajectories, quiet: bool) {
    for (what, count) in &loaded.repairs {
        tracing::warn!("{}: repaired: {what} ({count}x)", path.display());
    }
    if quiet {
        return;
    }
    let number = |(old, new): (&i32, &TrajectoryId)| {
        if *old == new.0 as i32 { new.to_string() } else { format!("{old} as {new}") }
    };
    let numbers: Vec<String> = loaded.trajectory_ids.iter().map(number).collect();
    say(&format!("{}: trajectory {}", path.display(), numbers.join(", ")));
}

/// How well the recording was found in the maps that were known before.
pub struct Localisation {
    /// Loop closures between the recording and the known maps.
    pub loop_closures: usize,
    /// Seconds from the recording's first node to the first one that was found in a known map.
    pub first_found_after_seconds: Option<f64>,
    /// Seconds of the recording, from its first node, that it took until its place was known.
    pub placed_after_seconds: Option<f64>,
    /// Whether somebody said where it starts.
    pub start_was_told: bool,
}

impl Localisation {
    /// Nothing if no map was known before.
    pub fn of<S: Space>(mapped: &MappedRecording<S>) -> Option<Self> {
        let (state, new) = (mapped.map.graph.state(), mapped.trajectory_id);
        let pieces = mapped.pieces();
        if state.trajectories.keys().all(|id| pieces.contains(id)) {
            return None;
        }
        let time = |node_id| state.nodes.get(&node_id).map(|node| node.data.time);
        let found = |c: &&portolan_mapping::Constraint| {
            (c.submap_id.trajectory_id == new) != (c.node_id.trajectory_id == new)
        };
        let between: Vec<_> = state.constraints.iter().filter(found).collect();
        let start = mapped.map.node_poses(new).first().map(|(time, _)| *time);
        // A known scan found in a new submap counts from when that submap had its first scan.
        let first = between.iter().filter_map(|c| {
            if c.node_id.trajectory_id == new {
                return time(c.node_id);
            }
            state.submaps.get(&c.submap_id)?.node_ids.iter().find_map(|id| time(*id))
        });
        let trimmed = state.trimmed_ties.get(&new);
        let first = first.chain(trimmed.map(|ties| ties.first)).min();
        let first_found_after_seconds = first.zip(start).map(|(found, start)| found.seconds_since(start));
        let placed = mapped.map.graph.placed_at();
        let placed_after_seconds = placed.zip(start).map(|(placed, start)| placed.seconds_since(start));
        let loop_closures = between.len() + trimmed.map_or(0, |ties| ties.count);
        let start_was_told = state.trajectories.get(&new).is_some_and(|t| t.initial_pose.is_some());
        Some(Self { loop_closures, first_found_after_seconds, placed_after_seconds, start_was_told })
    }

    /// For people.
    pub fn sentence(&self) -> String {
        match self.placed_after_seconds.or(self.first_found_after_seconds) {
            Some(seconds) => format!(
                "found in the known map after {seconds:.0} s, {} loop closures with it",
                self.loop_closures
            ),
            None if self.start_was_told => "no loop closure with the known map: the recording lies in it where --start \
                 says, and goes on as it saw itself"
                .to_owned(),
            None => "NOT found in the known map: the recording lies in the map as if it had started at its origin. \
                 If you know the place, say --start X,Y,YAW; else lower \
                 --set constraint_builder.global_localization_min_score"
                .to_owned(),
        }
    }
}
