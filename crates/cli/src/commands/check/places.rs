//! Finds places of a map where localisation would fail or confuse one place with another.

use std::ops::ControlFlow;
use std::path::Path;

use portolan::job::{Event, ExaminedMap, JobError, Places, examine_map};
use portolan_diagnose::Severity;
use portolan_localization::Distinctness;

use super::Finding;
use crate::GlobalArgs;
use crate::error::CliError;
use crate::output::counted;
use crate::progress::Progress;

/// Examines the places of a map, adds difficult ones to the findings, and draws a picture if `picture` is given.
///
/// # Errors
/// If a picture is requested and the map cannot be examined or the picture cannot be written. Without a picture, a map
/// that cannot be examined is a finding.
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

/// Examines the map and shows progress.
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
        text: format!("not examined: {error}"),
        count: 1,
        effect: "it is not known where `portolan localize` would have difficulties".to_owned(),
        advice: "check it without --places; `portolan localize` shows where it finds a recording".to_owned(),
        repair: None,
    }
}

/// One finding for each kind of difficult place.
fn difficulties(examined: &ExaminedMap) -> Vec<Finding> {
    let all = examined.places.len() as u64;
    let found = examined
        .counts()
        .into_iter()
        .filter(|(kind, count)| *kind != Distinctness::Distinct && count.places > 0);
    found
        .map(|(kind, count)| {
            let (text, effect, advice) = words(kind);
            let percent = 100.0 * count.fraction_of_path;
            let places = counted(all, "place", "places");
            Finding {
                severity: Severity::Info,
                about: format!("{} places", kind.name()),
                text: format!("{} of {places} ({percent:.0} % of the trajectory): {text}", count.places),
                count: 1,
                effect: effect.to_owned(),
                advice: advice.to_owned(),
                repair: None,
            }
        })
        .collect()
}

/// Description of a kind of place, its effect on localisation, and advice.
fn words(kind: Distinctness) -> (&'static str, &'static str, &'static str) {
    match kind {
        Distinctness::Distinct => ("", "", ""),
        Distinctness::Degenerate => (
            "the scan leaves one direction of motion unconstrained, as in a corridor",
            "along that direction `portolan localize` is less accurate, because it relies on odometry alone",
            "nothing, if odometry is good there; a lidar with a longer range sees the ends",
        ),
        Distinctness::Ambiguous => (
            "the scans of the last metres fit nearly as well, or better, elsewhere in the map",
            "`portolan localize` stays `tentative` there longer, and may localise at the wrong one of the two places",
            "start elsewhere, or give --start; --picture shows these places",
        ),
        Distinctness::Thin => (
            "the map does not explain even the scans that it was made from there",
            "`portolan localize` becomes `uncertain` there, or does not localise",
            "look there for walls drawn twice (`portolan render`), people and glass; map it again",
        ),
    }
}
