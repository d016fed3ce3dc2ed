//! Loads the textures of all submaps of a map file.

use std::collections::BTreeSet;

use portolan_geometry::Rigid3;
use rayon::prelude::*;

use crate::paint::PlacedTexture;
use crate::texture::{TextureError, texture_2d};
use crate::texture_3d::texture_3d;
use portolan_pbstream::MapReader;
use portolan_pbstream::PbstreamError;
use portolan_pbstream::proto::mapping::Submap;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{IdInFile, submap_id, submap_poses};

/// Maximum number of submaps, and of bytes of their messages, whose textures are rendered together. It bounds
/// the decoded grids in memory.
const BATCH: usize = 16;
const BATCH_BYTES: usize = 32 << 20;

/// The textures of a map.
#[derive(Debug, Default)]
pub struct MapTextures {
    /// Ascending by id: the order for painting.
    pub textures: Vec<PlacedTexture>,
    /// Submaps without a texture, with the reason.
    pub skipped: Vec<(IdInFile, TextureError)>,
}

/// Reads the rest of a map and renders the texture of every submap. Submaps that cannot be rendered are
/// listed in the result and the others follow (other programs stop painting there).
///
/// # Errors
/// If the map cannot be read.
pub fn load_textures(reader: &mut MapReader) -> Result<MapTextures, PbstreamError> {
    let poses = submap_poses(reader.pose_graph());
    let mut loaded = load_placed_textures(reader, &|id| Some((id, poses.get(&id).copied())))?;
    let (textures, skipped) =
        (loaded.textures.iter().map(|t| t.id), loaded.skipped.iter().map(|(id, _)| *id));
    let there: BTreeSet<IdInFile> = textures.chain(skipped).collect();
    let missing = poses.keys().filter(|id| !there.contains(id));
    loaded.skipped.extend(missing.map(|id| (*id, TextureError::Missing)));
    Ok(loaded)
}

/// Like [`load_textures`], with ids and poses from `placement`; submaps without an id are left out.
pub(crate) fn load_placed_textures(
    reader: &mut MapReader,
    placement: &(dyn Fn(IdInFile) -> Option<(IdInFile, Option<Rigid3>)> + Sync),
) -> Result<MapTextures, PbstreamError> {
    let mut result = MapTextures::default();
    let (mut batch, mut bytes) = (Vec::new(), 0);
    loop {
        let message = reader.next_message()?;
        let ended = message.is_none();
        let size = message.as_ref().map_or(0, |m| m.size);
        if let Some(Data::Submap(submap)) = message.map(|m| m.data) {
            batch.push(submap);
            bytes += size;
        }
        if batch.len() >= BATCH || bytes >= BATCH_BYTES || ended {
            let place = |submap: &Submap| {
                let (id, pose) = placement(submap_id(submap.submap_id.as_ref()))?;
                let Some(map_from_submap) = pose else {
                    return Some(Err((id, TextureError::Pose("global"))));
                };
                let texture = submap_texture(submap, &map_from_submap);
                Some(texture.map_err(|e| (id, e)).map(|texture| PlacedTexture {
                    id,
                    map_from_submap,
                    texture: texture.into(),
                }))
            };
            for placed in batch.par_iter().filter_map(place).collect::<Vec<_>>() {
                match placed {
                    Ok(texture) => result.textures.push(texture),
                    Err(skipped) => result.skipped.push(skipped),
                }
            }
            batch.clear();
            bytes = 0;
        }
        if ended {
            break;
        }
    }
    result.textures.sort_by_key(|t| t.id);
    Ok(result)
}

/// The texture of a 2D or 3D submap; in 3D that of the fine grid, seen from above in the global map.
///
/// # Errors
/// As for [`texture_2d`] and [`texture_3d`], or if the message has no submap.
pub fn submap_texture(
    submap: &Submap,
    map_from_submap: &Rigid3,
) -> Result<crate::texture::SubmapTexture, TextureError> {
    match (&submap.submap_2d, &submap.submap_3d) {
        (Some(submap), _) => texture_2d(submap),
        (None, Some(submap)) => texture_3d(submap, map_from_submap),
        (None, None) => Err(TextureError::NoGrid),
    }
}
