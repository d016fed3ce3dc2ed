//! Formats of files, recognised by ending or content.

use std::path::Path;

use portolan_input::Forward;

use crate::error::CliError;
use crate::input::{GRAPH_TAGS, is_map, peek};

/// Formats of trajectories and pose graphs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// `time x y z qx qy qz qw`.
    Tum,
    /// Twelve numbers per line; times in a separate file.
    Kitti,
    /// A table with a header line.
    Csv,
    /// Lines with times.
    Geojson,
    /// Vertices and edges.
    G2o,
    /// .pbstream.
    #[value(name = "pbstream")]
    Map,
}

impl Format {
    /// Format by the file ending.
    pub fn of_name(path: &Path) -> Result<Self, CliError> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match ending.as_deref() {
            Some("tum") => Ok(Self::Tum),
            Some("kitti" | "txt") => Ok(Self::Kitti),
            Some("csv") => Ok(Self::Csv),
            Some("geojson" | "json") => Ok(Self::Geojson),
            Some("g2o") => Ok(Self::G2o),
            Some("pbstream") => Ok(Self::Map),
            _ => Err(CliError::Usage(format!(
                "{}: the name does not determine the format; give --to tum, kitti, csv, geojson, g2o or pbstream",
                path.display()
            ))),
        }
    }

    /// Format by the first bytes. Text formats of one trajectory are all returned as [`Self::Tum`]; they are
    /// distinguished when they are read.
    pub fn of_content(input: &mut Forward, path: &Path) -> Result<Self, CliError> {
        if is_map(input, path)? {
            return Ok(Self::Map);
        }
        let text = String::from_utf8_lossy(peek(input, path, 4096)?);
        let mut lines = text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
        let first = lines.next().unwrap_or_default();
        if first.starts_with('{') {
            return Ok(Self::Geojson);
        }
        let is_tag = GRAPH_TAGS.iter().any(|tag| first.starts_with(tag));
        Ok(if is_tag { Self::G2o } else { Self::Tum })
    }

    /// Whether a file of this format can hold more than one trajectory.
    pub fn holds_several(self) -> bool {
        matches!(self, Self::Csv | Self::Geojson)
    }
}
