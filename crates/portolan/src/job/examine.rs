//! Finds the places of a map where localisation would fail or confuse one place with another.

use std::path::Path;

use portolan_config::Options;
use portolan_export::{ColouredLine, PictureOptions, Rgb, draw_path, rgb, write_picture};
use portolan_input::regular_file;
use portolan_localization::{Distinctness, ExaminedPlace, KnownMap2d, LocalizerError, PlaceExaminer};
use portolan_mapfile::{FrozenTrajectories, PlacedTexture, submap_textures_2d};
use portolan_mapping::{Map, Space2d};
use portolan_pbstream::MapReader;
use portolan_pbstream::proto::mapping::serialized_data::Data;

use super::error::JobError;
use super::event::{Event, Observer};
use super::known_map::KnownMaps;

/// Places of a map, and how well they can be distinguished.
pub struct ExaminedMap {
    /// Along the trajectories, in order.
    pub places: Vec<ExaminedPlace>,
    textures: Vec<PlacedTexture>,
}

/// Number of places of a kind, and the fraction of the path that they represent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlaceCount {
    /// Places.
    pub places: usize,
    /// Fraction of the path that they represent.
    pub fraction_of_path: f64,
}

impl ExaminedMap {
    /// Places of each kind, in the order of [`Distinctness::ALL`].
    pub fn counts(&self) -> [(Distinctness, PlaceCount); 4] {
        let whole = self.path_length();
        Distinctness::ALL.map(|kind| {
            let of_kind = || self.places.iter().filter(|place| place.distinctness == kind);
            let path_length = of_kind().fold(0.0, |sum, place| sum + place.path_length);
            let fraction_of_path = if whole > 0.0 { path_length / whole } else { 0.0 };
            (kind, PlaceCount { places: of_kind().count(), fraction_of_path })
        })
    }

    /// Length of the trajectories, metres.
    pub fn path_length(&self) -> f64 {
        self.places.iter().map(|place| place.path_length).sum()
    }

    /// Draws the map with the path in colours: green distinct, blue degenerate, orange ambiguous, red thin.
    ///
    /// # Errors
    /// If there is nothing to draw, or the picture cannot be written.
    pub fn draw(&self, path: &Path) -> Result<(), JobError> {
        let picture = draw_path(&self.textures, &lines(&self.places), &PictureOptions::default())?;
        Ok(write_picture(path, &picture)?)
    }
}

/// Examines the places of a map in 2D. `observe` receives the progress and may stop the work; the places
/// examined by then remain. In 3D the information along the weakest direction of a scan is so much less than
/// along the strongest that every place would count as degenerate.
///
/// # Errors
/// A map that cannot be read, in which nothing can be found, or that is in 3D.
pub fn examine_map(path: &Path, threads: usize, observe: &mut Observer) -> Result<ExaminedMap, JobError> {
    regular_file(path).map_err(|source| JobError::file(path, source))?;
    if is_3d(path)? {
        return Err(JobError::PlacesOf3dMap(path.to_owned()));
    }
    let options = Options::default();
    let known = KnownMaps { files: vec![path.to_owned()], frozen: FrozenTrajectories::All, start: None };
    // Repairs of the map are not reported here: that is the task of a check of the map.
    let mut loaded = known.load::<Space2d>(&options, &mut super::unobserved)?;
    let unusable = |reason| JobError::UnusableMap { path: path.to_owned(), reason };
    let map = KnownMap2d::new(loaded.graph.state()).map_err(unusable)?;
    let examiner = PlaceExaminer::new(map, loaded.graph.state(), threads).map_err(LocalizerError::from)?;
    let mut places = examiner.examine(&mut |done, total| observe(&Event::Examining { done, total }));
    drop(examiner);
    for place in &mut places {
        place.map_from_tracking = loaded.frame.in_map(&place.map_from_tracking);
        if let Some(other) = &mut place.other {
            other.map_from_tracking = loaded.frame.in_map(&other.map_from_tracking);
        }
    }
    loaded.graph.move_by(&loaded.frame.origin());
    let textures = submap_textures_2d(&Map::new(options, loaded.graph, loaded.trajectories));
    Ok(ExaminedMap { places, textures })
}

/// Whether the map is in 3D, by the first submap of the file.
fn is_3d(path: &Path) -> Result<bool, JobError> {
    let failed = |error: portolan_pbstream::PbstreamError| JobError::KnownMap {
        path: path.to_owned(),
        reason: error.into(),
    };
    let mut reader = MapReader::open(path).map_err(failed)?;
    while let Some(message) = reader.next_message().map_err(failed)? {
        if let Data::Submap(submap) = message.data {
            return Ok(submap.submap_3d.is_some() && submap.submap_2d.is_none());
        }
    }
    Ok(false)
}

/// The colour of a place in pictures.
fn colour(distinctness: Distinctness) -> Rgb {
    match distinctness {
        Distinctness::Distinct => rgb(0x2ca02c),
        Distinctness::Degenerate => rgb(0x1f78b4),
        Distinctness::Ambiguous => rgb(0xe08214),
        Distinctness::Thin => rgb(0xd62728),
    }
}

/// The path in segments of one kind, the worst on top: each place from the middle of the segment before it to
/// the middle of the segment after it.
fn lines(places: &[ExaminedPlace]) -> Vec<ColouredLine> {
    let at = |place: &ExaminedPlace| {
        let at = place.map_from_tracking.translation;
        [at.x, at.y]
    };
    let middle = |a: &ExaminedPlace, b: &ExaminedPlace| {
        let (a, b) = (at(a), at(b));
        [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]
    };
    let is_joined =
        |a: &&ExaminedPlace, b: &ExaminedPlace| a.node_id.trajectory_id == b.node_id.trajectory_id;
    let piece = |(i, place): (usize, &ExaminedPlace)| {
        let before = i.checked_sub(1).and_then(|i| places.get(i)).filter(|other| is_joined(other, place));
        let after = places.get(i + 1).filter(|other| is_joined(other, place));
        let points =
            [before.map(|other| middle(other, place)), Some(at(place)), after.map(|o| middle(place, o))];
        let line = ColouredLine {
            colour: colour(place.distinctness),
            points: points.into_iter().flatten().collect(),
        };
        (place.distinctness, line)
    };
    let mut pieces: Vec<(Distinctness, ColouredLine)> = places.iter().enumerate().map(piece).collect();
    pieces.sort_by_key(|(distinctness, _)| *distinctness);
    pieces.into_iter().map(|(_, line)| line).collect()
}
