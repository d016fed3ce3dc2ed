//! Draws the map from above: a picture for users and one for ROS.

use std::path::PathBuf;

use portolan_export::{MapContent, PictureError, PictureOptions, draw_map, write_picture};
use portolan_mapfile::{
    EvidenceMap, ImageName, PaintError, PaintOptions, PlacedTexture, sum_evidence, write_ros_map,
};

use super::error::JobError;
use super::event::{Event, Observer, Remark, remark};
use super::output_folder::OutputFolder;

/// Cell size of the ROS map, metres, unless that makes it too large.
const ROS_MAP_RESOLUTION: f64 = 0.05;

/// Writes `map.png`, and `map.pgm` with `map.yaml`; returns those that were written, as there may be nothing
/// to show.
pub(super) fn write_pictures(
    content: &MapContent,
    folder: &OutputFolder,
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let mut files = Vec::new();
    match draw_map(content, &PictureOptions::default()) {
        Ok(picture) => {
            write_picture(&folder.add("map.png", &mut files)?, &picture)?;
        }
        Err(error @ PictureError::Empty) => remark(observe, Remark::NoPicture(error)),
        Err(error) => return Err(error.into()),
    }
    if observe(&Event::Drawing).is_break() {
        remark(observe, Remark::StoppedBeforePictures);
        return Ok(files);
    }
    let options = PaintOptions { resolution: ROS_MAP_RESOLUTION, ..PaintOptions::default() };
    if let Some(map) = draw_as_fits(content.textures, options, observe)? {
        let names = ["map.pgm", "map.yaml"];
        folder.files(&names)?;
        write_ros_map(&folder.path().join("map"), &map.painted(), ImageName::Beside)?;
        files.extend(names.map(|name| folder.path().join(name)));
    }
    Ok(files)
}

/// Draws with the requested cell size, doubled until the picture is not too large; none where there is
/// nothing to draw. Remarks report both.
fn draw_as_fits(
    textures: &[PlacedTexture],
    mut options: PaintOptions,
    observe: &mut Observer,
) -> Result<Option<EvidenceMap>, JobError> {
    let usual_metres = options.resolution;
    loop {
        match sum_evidence(textures, &options) {
            Ok(map) => {
                let resolution_metres = map.resolution;
                if resolution_metres > usual_metres {
                    remark(observe, Remark::CoarseRosMap { resolution_metres, usual_metres });
                }
                return Ok(Some(map));
            }
            // Doubling ends: a picture of a few pixels always fits.
            Err(PaintError::TooLarge { .. }) if options.resolution < 1e6 => options.resolution *= 2.0,
            Err(error @ PaintError::Empty) => {
                remark(observe, Remark::NoRosMap(error));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use portolan_geometry::Rigid3;
    use portolan_mapfile::SubmapTexture;

    /// Textures far apart, so that a picture of all is large.
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
        let resolution = |metres| {
            draw_as_fits(&textures(metres), options, &mut |_| ControlFlow::Continue(()))
                .unwrap()
                .unwrap()
                .resolution
        };
        assert_eq!([1.0, 10.0, 30.0].map(resolution), [0.05, 0.2, 0.4]);
    }

    #[test]
    fn missing_pictures_are_not_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let content = MapContent { textures: &[], trajectories: &[], constraints: &[] };
        let mut remarks = Vec::new();
        let output =
            OutputFolder::begin(folder.path(), "map", &["map.png"], false, &mut crate::job::unobserved)
                .unwrap();
        let files = write_pictures(&content, &output, &mut |event| {
            remarks.extend(if let Event::Remark(remark) = event { Some(remark.to_string()) } else { None });
            ControlFlow::Continue(())
        });
        assert_eq!(files.unwrap(), Vec::<PathBuf>::new());
        assert!(remarks.len() == 2 && remarks[0].starts_with("no map.png: "), "{remarks:?}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
