//! Finds faults of maps.

use std::path::Path;

use portolan_diagnose::Severity;
use portolan_input::Forward;
use portolan_pbstream::{FindingKind, PbstreamReader, ReadLimits, Severity as MapSeverity, validate};

use super::Finding;
use crate::error::CliError;

/// Reads a whole map; returns one finding per kind and severity, with its count.
pub fn check(path: &Path, input: Forward) -> Result<Vec<Finding>, CliError> {
    let length = input.length();
    let reader = PbstreamReader::from_source(input, length, ReadLimits::default());
    let mut reader = reader.map_err(|error| CliError::in_file(path, error))?;
    let finding = |found: portolan_pbstream::Finding| {
        let (effect, advice) = consequences(found.kind);
        let about = match (found.message, found.offset) {
            (Some(message), Some(offset)) => format!("message {message} at byte {offset}"),
            _ => String::new(),
        };
        let severity = match found.severity {
            MapSeverity::Warning => Severity::Warning,
            MapSeverity::Error => Severity::Error,
        };
        Finding {
            severity,
            about,
            text: found.text,
            count: 1,
            effect: effect.to_owned(),
            advice: advice.to_owned(),
            repair: found.kind.repair(),
        }
    };
    let mut by_kind: Vec<(FindingKind, Finding)> = Vec::new();
    for found in validate(&mut reader) {
        let (kind, more) = (found.kind, found.count);
        let next = finding(found);
        match by_kind.iter_mut().find(|(of, first)| *of == kind && first.severity == next.severity) {
            Some((_, first)) => first.count += more,
            None => by_kind.push((kind, next)),
        }
    }
    Ok(by_kind.into_iter().map(|(_, finding)| finding).collect())
}

/// Effect of a finding, and advice.
fn consequences(kind: FindingKind) -> (&'static str, &'static str) {
    const AGAIN: &str = "take an undamaged copy of the file if there is one, else `portolan repair`";
    match kind {
        FindingKind::Damage => ("data that cannot be read are lost; other programs stop here", AGAIN),
        FindingKind::Header => ("no program knows how to read the file", AGAIN),
        FindingKind::Order => ("Cartographer refuses the map or ignores the message", "`portolan repair`"),
        FindingKind::UnknownMessage => (
            "the message is left out when the map is read",
            "nothing, unless a newer program wrote something that you need",
        ),
        FindingKind::Options => (
            "options are missing or belong to no trajectory; Cartographer refuses the map",
            "`portolan repair`",
        ),
        FindingKind::DuplicateId => {
            ("only one of the parts with the same id can be used", "`portolan repair`")
        }
        FindingKind::MissingPart => {
            ("the part is missing in pictures, and cannot be matched against", "`portolan repair`")
        }
        FindingKind::Pose => ("what depends on the pose cannot be placed in the map", "`portolan repair`"),
        FindingKind::Constraint => (
            "optimisation leaves the constraint out, or pulls the map out of shape",
            "`portolan repair`, then `portolan optimize`",
        ),
        FindingKind::Grid => ("the submap has no picture and cannot be matched against", AGAIN),
        FindingKind::PointCloud => {
            ("the node cannot be matched again, and is missing in point clouds", AGAIN)
        }
        FindingKind::Histogram => (
            "loop closures with this node or submap are not found in 3D",
            "`portolan migrate` makes histograms",
        ),
        FindingKind::Imu => (
            "none in Portolan: the scans of such a trajectory constrain it",
            "`portolan repair`, if Cartographer is to optimise the trajectory",
        ),
        FindingKind::Unconstrained => (
            "optimisation separates the trajectory from the rest of the map, or leaves it where it is",
            "use the trajectory frozen, or map its recording again",
        ),
        FindingKind::FarAway => (
            "coordinates so large do not resolve millimetres; optimisation fails, or bends the rest of the map",
            "map the recording again, or remove the part with `portolan edit`",
        ),
        FindingKind::Time => (
            "interpolation between these times is wrong",
            "check the stamps of the recording with `portolan check`; map it again or `portolan repair`",
        ),
    }
}
