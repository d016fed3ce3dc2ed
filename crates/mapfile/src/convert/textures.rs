//! Renders the textures of submaps in memory.

use std::sync::Arc;

use portolan_geometry::Rigid3;
use portolan_grids::Texture;
use portolan_mapping::{Map, Space, Space2d, Space3d, SubmapId};
use rayon::prelude::*;

use super::hybrid_grid::hybrid_grid_to_proto;
use super::values::id_for_errors;
use crate::paint::PlacedTexture;
use crate::texture::SubmapTexture;
use crate::texture_3d::xray_texture;

/// The textures of all submaps that have a grid, ascending by id: input of [`crate::paint`] without writing a
/// file.
pub fn submap_textures_2d(map: &Map<Space2d>) -> Vec<PlacedTexture> {
    placed_textures(map, |submap, _| {
        Some(texture_in_memory(&Texture::of_grid(&submap.grid, &submap.local_from_submap)))
    })
}

/// The same in 3D: X-rays of the fine grids, as [`load_textures`](crate::load_textures) would make them from
/// a file of the map. Submaps that cannot be rendered are left out.
pub fn submap_textures_3d(map: &Map<Space3d>) -> Vec<PlacedTexture> {
    placed_textures(map, |submap, map_from_submap| {
        xray_texture(&hybrid_grid_to_proto(&submap.high_resolution_grid), map_from_submap).ok()
    })
}

/// Renders every submap in memory; `draw` gets the submap and its pose in the map.
fn placed_textures<S: Space>(
    map: &Map<S>,
    draw: impl Fn(&S::Submap, &Rigid3) -> Option<SubmapTexture> + Sync,
) -> Vec<PlacedTexture> {
    let state = map.graph.state();
    let submaps: Vec<_> = state
        .submaps
        .iter()
        .filter_map(|(id, entry)| Some((*id, entry.submap.as_ref()?, state.map_from_submap(*id)?)))
        .collect();
    let place = |(id, submap, map_from_submap): &(SubmapId, &Arc<S::Submap>, Rigid3)| {
        Some(PlacedTexture {
            id: id_for_errors(id.trajectory_id, id.index),
            map_from_submap: *map_from_submap,
            texture: draw(submap, map_from_submap)?.into(),
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
