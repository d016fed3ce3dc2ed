//! Options for maps that a recording is added to, and the message whether the recording was localised in them.

use std::path::PathBuf;

use portolan::job::{KnownMaps, Localisation, Place};
use portolan_geometry::Rigid3;
use portolan_mapfile::FrozenTrajectories;
use portolan_mapping::Consistency;

use crate::commands::argument::{frozen_trajectories, start_pose};
use portolan_numeric::counted;

/// Known maps that a recording is added to.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Known maps")]
pub struct KnownMapArgs {
    /// Add the recording to this map; may be given several times. The recording becomes a trajectory of its
    /// own, after those of the map, and is searched in the whole map until it is localised.
    #[arg(long, value_name = "MAP.pbstream")]
    pub from: Vec<PathBuf>,
    /// Keep the known maps unchanged: the recording is only localised in them and extends them.
    /// `--frozen=0,2` freezes only these trajectories of a single map.
    #[arg(long, value_name = "TRAJECTORIES", requires = "from", value_parser = frozen_trajectories,
        num_args = 0..=1, require_equals = true, default_missing_value = "all")]
    pub frozen: Option<FrozenTrajectories>,
    /// Pose in the known map at which the recording starts: metres and degrees; also X,Y,Z,YAW or
    /// X,Y,Z,ROLL,PITCH,YAW. Without it, or if scans do not fit there, the pose is searched.
    #[arg(long, value_name = "X,Y,YAW", requires = "from", value_parser = start_pose,
        allow_hyphen_values = true)]
    pub start: Option<Rigid3>,
    /// Write the map even if the recording was not localised in the known one or contradicts --start, so that
    /// two buildings may overlap in it; also overwrite files in the folder that were not written by an
    /// earlier `map`.
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
    let fits = format!("scans fit it at {confirmed} of {places} places that it contains");
    match found.place() {
        Place::Found => match found.error_of_given_start {
            Some((metres, radians)) => format!(
                "found in the known map {metres:.1} m and {:.0} deg from --start, where scans do not fit: {closures} with it, \
                 {fits}",
                radians.to_degrees()
            ),
            None => format!("found in the known map after {seconds:.0} s: {closures} with it, {fits}"),
        },
        Place::Uncertain if !found.agreement.is_known() => format!(
            "perhaps NOT where it belongs in the known map: {closures} with it, and only {places} places that it contains; look at \
             map.png"
        ),
        Place::Uncertain => format!(
            "perhaps NOT where it belongs in the known map: {fits}. Either much has changed there, or it is another place that looks \
             alike; look at map.png"
        ),
        Place::GivenAsStart => "nothing confirms the pose of --start: the recording is outside of the known map, and is placed by --start and \
                        its own odometry"
            .to_owned(),
        Place::Refuted if found.start_was_given => format!(
            "NOT found in the known map: at --start, {fits}, and nowhere else do they fit better. If you know the \
             place, give --start more accurately [write the map all the same: --force]"
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
