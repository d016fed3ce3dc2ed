//! Where in a map localisation would fail or take one place for another.

use std::ops::ControlFlow;
use std::path::Path;

use portolan::job::{Event, ExaminedMap, JobError, examine_map};
use portolan_diagnose::Severity;
use portolan_geometry::{Rigid3, yaw};
use portolan_localization::{Distinctness, ExaminedPlace};
use serde::Serialize;

use super::Finding;
use crate::GlobalArgs;
use crate::error::CliError;
use crate::output::counted;
use crate::progress::Progress;

/// How well the places of a map can be told apart.
#[derive(Serialize)]
pub struct Places {
    /// Length of the trajectories.
    trajectory_metres: f64,
    /// Places of each kind.
    kinds: Vec<Kind>,
    /// All of them along the trajectories.
    places: Vec<Place>,
}

#[derive(Serialize)]
struct Kind {
    kind: &'static str,
    places: usize,
    fraction_of_trajectory: f64,
}

/// A place: metres and radians in the map.
#[derive(Serialize)]
struct Place {
    kind: &'static str,
    trajectory: u32,
    node: u32,
    pose: Pose,
    /// Fraction of the beams of the node's scan that the map explains.
    explained: f64,
    /// Mean fraction that it explains less the fraction that it contradicts, of the scans before it.
    fit: f64,
    /// The best place elsewhere.
    other: Option<Pose>,
    /// How well what was seen fits there.
    other_fit: Option<f64>,
    /// Direction in which the scan may be shifted, radians in the map; none if it may not, or only turned.
    open_direction: Option<f64>,
}

#[derive(Serialize)]
struct Pose {
    x: f64,
    y: f64,
    z: f64,
    yaw: f64,
}

/// Examines the places of a map, adds what was found to the findings, and draws it if that is wanted.
///
/// # Errors
/// If a picture is wanted and cannot be made. A map that cannot be searched is a finding.
pub fn check(
    path: &Path,
    picture: Option<&Path>,
    global: &GlobalArgs,
    findings: &mut Vec<Finding>,
) -> Result<Option<Places>, CliError> {
    let examined = match examine(path, global) {
        Ok(examined) => examined,
        Err(error) if picture.is_some() => return Err(error.into()),
        Err(error) => {
            findings.push(not_examined(&error));
            return Ok(None);
        }
    };
    findings.extend(difficulties(&examined));
    if let Some(picture) = picture {
        examined.draw(picture)?;
    }
    Ok(Some(Places::of(&examined)))
}

/// Examines, with a line of progress.
fn examine(path: &Path, global: &GlobalArgs) -> Result<ExaminedMap, JobError> {
    let mut progress = Progress::start("searching places", 1, global.quiet);
    let examined = examine_map(path, global.threads, &mut |event| {
        if let Event::Examining { done, total } = event
            && progress.is_due()
        {
            progress.update(*done as u64, *total as u64, format!("{done} of {total}"));
        }
        ControlFlow::Continue(())
    });
    progress.finish();
    examined
}

fn not_examined(error: &JobError) -> Finding {
    Finding {
        severity: Severity::Error,
        about: "places".to_owned(),
        what: format!("not examined: {error}"),
        count: 1,
        effect: "nothing is known of where `portolan localize` would have difficulties".to_owned(),
        advice: "check it without --places; `portolan localize` shows where it finds a recording".to_owned(),
        repair: None,
    }
}

/// One finding for each kind of place where localisation has difficulties.
fn difficulties(examined: &ExaminedMap) -> Vec<Finding> {
    let all = examined.places.len() as u64;
    let found = examined
        .counts()
        .into_iter()
        .filter(|(kind, count)| *kind != Distinctness::Distinct && count.places > 0);
    found
        .map(|(kind, count)| {
            let (what, effect, advice) = words(kind);
            let percent = 100.0 * count.fraction_of_way;
            let places = counted(all, "place", "places");
            Finding {
                severity: Severity::Info,
                about: format!("{} places", kind.name()),
                what: format!("{} of {places} ({percent:.0} % of the trajectory): {what}", count.places),
                count: 1,
                effect: effect.to_owned(),
                advice: advice.to_owned(),
                repair: None,
            }
        })
        .collect()
}

/// What places of a kind are, what follows, and what to do.
fn words(kind: Distinctness) -> (&'static str, &'static str, &'static str) {
    match kind {
        Distinctness::Distinct => ("", "", ""),
        Distinctness::Degenerate => (
            "the scan leaves a direction open, as in a corridor",
            "`portolan localize` knows such a place less well along that direction, by odometry alone",
            "nothing, as long as odometry is good there; a lidar that reaches farther sees the ends",
        ),
        Distinctness::Ambiguous => (
            "what was seen on the last metres fits nearly as well, or better, elsewhere in the map",
            "`portolan localize` stays `tentative` there longer, and may take one place for the other",
            "begin elsewhere, or say --start; --picture shows where",
        ),
        Distinctness::Thin => (
            "the map does not explain what was seen there when it was made",
            "`portolan localize` becomes `uncertain` there, or does not find itself",
            "look there for walls drawn twice (`portolan render`), people and glass; map it again",
        ),
    }
}

impl Places {
    /// What was examined and how much of it is distinct, for people.
    pub fn text(&self) -> String {
        let distinct = self.kinds.iter().find(|kind| kind.kind == Distinctness::Distinct.name());
        format!(
            "  places: {} along {:.0} m were examined, {:.0} % of the trajectory is distinct\n",
            self.places.len(),
            self.trajectory_metres,
            100.0 * distinct.map_or(0.0, |kind| kind.fraction_of_trajectory),
        )
    }

    pub fn of(examined: &ExaminedMap) -> Self {
        let kind = |(kind, count): (Distinctness, portolan::job::PlaceCount)| Kind {
            kind: kind.name(),
            places: count.places,
            fraction_of_trajectory: count.fraction_of_way,
        };
        Self {
            trajectory_metres: examined.way(),
            kinds: examined.counts().into_iter().map(kind).collect(),
            places: examined.places.iter().map(Place::of).collect(),
        }
    }
}

impl Place {
    fn of(place: &ExaminedPlace) -> Self {
        let open = place.open_direction.filter(|direction| direction.norm() > 0.5);
        Self {
            kind: place.distinctness.name(),
            trajectory: place.node_id.trajectory_id.0,
            node: place.node_id.index,
            pose: Pose::of(&place.map_from_tracking),
            explained: place.explained,
            fit: place.fit,
            other: place.other.map(|other| Pose::of(&other.map_from_tracking)),
            other_fit: place.other.map(|other| other.fit),
            open_direction: open.map(|direction| direction.y.atan2(direction.x)),
        }
    }
}

impl Pose {
    fn of(map_from_tracking: &Rigid3) -> Self {
        let at = map_from_tracking.translation;
        Self { x: at.x, y: at.y, z: at.z, yaw: yaw(&map_from_tracking.rotation) }
    }
}
