//! Options for maps that a recording is added to, and the message whether the recording was localised in them.

use std::path::PathBuf;

use portolan::job::{KnownMaps, Localisation, Place};
use portolan_geometry::Rigid3;
use portolan_mapfile::FrozenTrajectories;
use portolan_mapping::Consistency;

use crate::commands::argument::{frozen_trajectories, start_pose};
use portolan_numeric::counted;

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
    /// Without it, or if scans do not fit there, it is searched.
    #[arg(long, value_name = "X,Y,YAW", requires = "from", value_parser = start_pose,
        allow_hyphen_values = true)]
    pub start: Option<Rigid3>,
    /// Write the map although the recording was not found in the known one, or refutes --start: two buildings laid over
    /// each other; and write over files in the folder that no earlier `map` wrote.
    #[arg(long)]
    pub force: bool,
}

impl KnownMapArgs {
    /// The options as the job takes them.
    pub fn maps(&self) -> KnownMaps {
        KnownMaps {
            files: self.from.clone(),
            frozen: self.frozen.clone().unwrap_or_default(),
            start: self.start,
        }
    }
}

/// Message for the user whether the recording was localised in the known map.
///
/// If it was not localised, the result must not be used.
pub fn sentence(found: &Localisation) -> String {
    let seconds = found.placed_after_seconds.or(found.first_found_after_seconds).unwrap_or(0.0);
    let Consistency { places, confirmed, .. } = found.agreement;
    let closures = counted(found.loop_closures as u64, "loop closure", "loop closures");
    let fits = format!("scans fit it at {confirmed} of {places} places that it knows");
    match found.place() {
        Place::Found => match found.error_of_given_start {
            Some((metres, radians)) => format!(
                "found in the known map {metres:.1} m and {:.0} deg from where --start says, which scans do not fit: {closures} with it, \
                 {fits}",
                radians.to_degrees()
            ),
            None => format!("found in the known map after {seconds:.0} s: {closures} with it, {fits}"),
        },
        Place::Doubtful if !found.agreement.is_known() => format!(
            "perhaps NOT where it belongs in the known map: {closures} with it, and no more than {places} places that it knows; look at \
             map.png"
        ),
        Place::Doubtful => format!(
            "perhaps NOT where it belongs in the known map: {fits}. Either much has changed there, or the place is another one that \
             looks alike; look at map.png"
        ),
        Place::GivenAsStart => "nothing confirms where --start says that the recording lies: it went where the known map does not reach, by \
                        its own odometry"
            .to_owned(),
        Place::Refuted if found.start_was_given => format!(
            "NOT found in the known map: where --start says, {fits}, and nowhere else do they fit better. If you know the \
             place, say it better [write the map all the same: --force]"
        ),
        Place::Refuted => format!(
            "NOT found in the known map: where loop closures put it, {fits}. If you know the place, say \
             --start X,Y,YAW [write the map all the same: --force]"
        ),
        Place::NotFound => "NOT found in the known map: its place there is unknown. If you know the place, say --start X,Y,YAW; else \
                            lower --set constraint_builder.global_localization_min_score [write the map all the same: --force]"
            .to_owned(),
    }
}
