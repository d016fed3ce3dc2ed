//! Pictures of submaps that are in memory.

use portolan_geometry::Rigid3;
use portolan_mapping::{Map, Planar, Spatial, Submap3d, SubmapId};
use portolan_matching::Texture;
use rayon::prelude::*;

use super::hybrid_grid::hybrid_grid_to_proto;
use super::values::id_for_errors;
use crate::paint::PlacedTexture;
use crate::texture::SubmapTexture;
use crate::texture_3d::xray_texture;

/// The textures of all submaps that have a grid, ascending by id: what [`crate::paint`] takes, without
/// the way through a file.
pub fn submap_textures_2d(map: &Map<Planar>) -> Vec<PlacedTexture> {
    let state = map.graph.state();
    let submaps: Vec<_> = state
        .submaps
        .iter()
        .filter_map(|(id, entry)| Some((*id, entry.submap.as_ref()?, state.map_from_submap(*id)?)))
        .collect();
    let place = |(id, submap, map_from_submap): &(_, &std::sync::Arc<portolan_mapping::Submap2d>, _)| {
        let id: portolan_mapping::SubmapId = *id;
        PlacedTexture {
            id: id_for_errors(id.trajectory_id, id.index),
            map_from_submap: *map_from_submap,
            texture: texture_in_memory(&Texture::of_grid(&submap.grid, &submap.local_from_submap)).into(),
        }
    };
    submaps.par_iter().map(place).collect()
}

/// The same in space: X-rays of the fine grids, as [`load_textures`](crate::load_textures) makes them of the file that
/// is written of the map. Submaps that cannot be shown are left out.
pub fn submap_textures_3d(map: &Map<Spatial>) -> Vec<PlacedTexture> {
    let state = map.graph.state();
    let submaps: Vec<_> = state
        .submaps
        .iter()
        .filter_map(|(id, entry)| Some((*id, entry.submap.as_ref()?, state.map_from_submap(*id)?)))
        .collect();
    let place = |(id, submap, map_from_submap): &(SubmapId, &std::sync::Arc<Submap3d>, Rigid3)| {
        let grid = hybrid_grid_to_proto(&submap.high_resolution_grid);
        let texture = xray_texture(&grid, map_from_submap).ok()?;
        Some(PlacedTexture {
            id: id_for_errors(id.trajectory_id, id.index),
            map_from_submap: *map_from_submap,
            texture: texture.into(),
        })
    };
    submaps.par_iter().filter_map(place).collect()
}

fn texture_in_memory(texture: &Texture) -> SubmapTexture {
    let (pixels, _) = texture.value_alpha.as_chunks::<2>();
    SubmapTexture {
        pixels: pixels.to_vec(),
        width: texture.width as usize,
        height: texture.height as usize,
        resolution: texture.resolution,
        submap_from_slice: texture.submap_from_slice,
    }
}
