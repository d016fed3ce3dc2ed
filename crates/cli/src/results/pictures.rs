//! The map from above: a picture for people and one for ROS.

use std::path::{Path, PathBuf};

use portolan_export::{MapContent, PictureError, PictureOptions, draw_map, write_picture};
use portolan_mapfile::{
    ImageName, PaintError, PaintOptions, PaintedMap, PlacedTexture, paint, write_ros_map,
};

use crate::error::CliError;
use crate::progress::say;

/// Cell size of the ROS map, metres, unless that makes it too large.
const ROS_MAP_RESOLUTION: f64 = 0.05;

/// Writes `map.png`, and `map.pgm` with `map.yaml`; which of them, because there may be nothing to show.
pub fn write_pictures(content: &MapContent, folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let failed = |e: &dyn std::error::Error| CliError::Failed(e.to_string());
    let mut files = Vec::new();
    match draw_map(content, &PictureOptions::default()) {
        Ok(picture) => {
            files.push(folder.join("map.png"));
            write_picture(&folder.join("map.png"), &picture).map_err(|e| failed(&e))?;
        }
        Err(error @ PictureError::Nothing) => say(&format!("no map.png: {error}")),
        Err(error) => return Err(failed(&error)),
    }
    let options = PaintOptions { resolution: ROS_MAP_RESOLUTION, ..PaintOptions::default() };
    if let Some(painted) = paint_as_fits(content.textures, options)? {
        write_ros_map(&folder.join("map"), &painted, ImageName::Beside).map_err(|e| failed(&e))?;
        files.extend(["map.pgm", "map.yaml"].map(|name| folder.join(name)));
    }
    Ok(files)
}

/// Paints with the resolution asked for, or that doubled until the picture is not too large; none where there is
/// nothing to paint. Remarks say so.
fn paint_as_fits(
    textures: &[PlacedTexture],
    mut options: PaintOptions,
) -> Result<Option<PaintedMap>, CliError> {
    let asked = options.resolution;
    loop {
        match paint(textures, &options) {
            Ok(painted) => {
                if painted.resolution > asked {
                    say(&format!(
                        "map.pgm has cells of {} m: with {asked} m it would be too large",
                        painted.resolution
                    ));
                }
                return Ok(Some(painted));
            }
            // Doubling ends: a picture of a few pixels always fits.
            Err(PaintError::TooLarge { .. }) if options.resolution < 1e6 => options.resolution *= 2.0,
            Err(error @ PaintError::Nothing) => {
                say(&format!("no map.pgm: {error}"));
                return Ok(None);
            }
            Err(error) => return Err(CliError::Failed(error.to_string())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Rigid3;
    use portolan_mapfile::SubmapTexture;

    /// Far apart, so that a picture of all is large.
    fn textures(metres: f64) -> Vec<PlacedTexture> {
        let texture = SubmapTexture {
            pixels: vec![[0, 255]; 4],
            width: 2,
            height: 2,
            resolution: 0.05,
            submap_from_slice: Rigid3::identity(),
        };
        let placed = |(index, x)| PlacedTexture {
            id: (0, index),
            map_from_submap: Rigid3::translation(x, x, 0.0),
            texture: texture.clone().into(),
        };
        [(0, 0.0), (1, metres)].into_iter().map(placed).collect()
    }

    #[test]
    fn pictures_that_would_be_too_large_become_coarser() {
        let options = PaintOptions { resolution: 0.05, max_pixels: 10_000, ..PaintOptions::default() };
        let resolution = |metres| paint_as_fits(&textures(metres), options).unwrap().unwrap().resolution;
        assert_eq!([1.0, 10.0, 30.0].map(resolution), [0.05, 0.2, 0.4]);
    }

    #[test]
    fn nothing_to_show_is_no_failure() {
        let folder = tempfile::tempdir().unwrap();
        let content = MapContent { textures: &[], trajectories: &[], constraints: &[] };
        assert_eq!(write_pictures(&content, folder.path()).unwrap(), Vec::<PathBuf>::new());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
