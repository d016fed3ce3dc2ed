//! Maps that a recording is added to: naming them, and saying whether the recording was found in them.

use std::path::PathBuf;

use portolan::job::{KnownMaps, Localisation, Place};
use portolan_geometry::Rigid3;
use portolan_mapfile::FrozenTrajectories;

use crate::commands::argument::{frozen_trajectories, start_pose};

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
    /// Write the map although the recording was not found in the known one, or refutes --start: two buildings laid over
    /// each other; and write over files in the folder that no earlier `map` wrote.
    #[arg(long)]
    pub force: bool,
}

impl KnownMapArgs {
    /// As the job wants them.
    pub fn maps(&self) -> KnownMaps {
        KnownMaps {
            files: self.from.clone(),
            frozen: self.frozen.clone().unwrap_or_default(),
            start: self.start,
        }
    }
}

/// Whether the recording was found, for people.
///
/// What was not found is not to be used.
pub fn sentence(found: &Localisation) -> String {
    let seconds = found.placed_after_seconds.or(found.first_found_after_seconds).unwrap_or(0.0);
    match found.place() {
        Place::Found => format!(
            "found in the known map after {seconds:.0} s, {} loop closures with it",
            found.loop_closures
        ),
        Place::Told => {
            "no loop closure with the known map: the recording lies in it where --start says, and goes \
                        where the known map does not reach, by its own odometry"
                .to_owned()
        }
        Place::Refuted => {
            "NOT found in the known map: scans do not fit it where --start says. If you know the place, say \
                           it better; without --start it is searched in the whole map [--force]"
                .to_owned()
        }
        Place::NotFound => "NOT found in the known map: its place there is unknown. If you know \
                            the place, say --start X,Y,YAW; else lower \
                            --set constraint_builder.global_localization_min_score [--force]"
            .to_owned(),
    }
}
