//! Groups surfels of all windows that are in one piece of surface into planes.

use portolan_geometry::Vector3;

use super::pairs::PlacedSurfel;
use super::surfels::SurfelMap;

/// Edge of the squares along a surface within which surfels belong to one plane, metres.
const SQUARE: f64 = 1.0;
/// Minimum cosine between the normal of a surfel and that of its plane.
const LEAST_COSINE: f64 = 0.94;

/// Surfels of one piece of surface.
#[derive(Clone, Debug, Default)]
pub(crate) struct PlaneGroups {
    /// Surfels, plane by plane.
    pub surfels: Vec<u32>,
    /// Ranges in `surfels`.
    pub planes: Vec<std::ops::Range<usize>>,
}

/// Groups surfels by the direction of their normal, their square along the surface, and their position along
/// the normal: a distance of `gap` metres separates planes.
pub(crate) fn group(map: &SurfelMap, placed: &[PlacedSurfel], gap: f64) -> PlaneGroups {
    #[derive(Clone, Copy)]
    struct Member {
        /// Direction (0 to 5) and square.
        key: (u8, i32, i32),
        height: f64,
        surfel: u32,
    }
    let mut members: Vec<Member> = placed
        .iter()
        .enumerate()
        .map(|(i, surfel)| {
            let axis = surfel.normal.iamax();
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let square = [u, v].map(|k| (surfel.mean[k] / SQUARE).floor());
            // Height at which the plane crosses the line through the middle of the square.
            let centre = square.map(|s| (s + 0.5) * SQUARE);
            let n = &surfel.normal;
            let height = surfel.mean[axis]
                - (n[u] * (centre[0] - surfel.mean[u]) + n[v] * (centre[1] - surfel.mean[v])) / n[axis];
            let side = u8::from(n[axis] > 0.0);
            Member {
                key: (2 * axis as u8 + side, square[0] as i32, square[1] as i32),
                height,
                surfel: i as u32,
            }
        })
        .collect();
    members
        .sort_by(|a, b| a.key.cmp(&b.key).then(a.height.total_cmp(&b.height)).then(a.surfel.cmp(&b.surfel)));
    let mut groups = PlaneGroups::default();
    for run in members.chunk_by(|a, b| a.key == b.key && b.height - a.height < gap) {
        let weighted: Vector3 =
            run.iter().map(|m| placed[m.surfel as usize].normal * map.surfels[m.surfel as usize].count).sum();
        let Some(normal) = weighted.try_normalize(1e-9) else { continue };
        let start = groups.surfels.len();
        groups.surfels.extend(
            run.iter().map(|m| m.surfel).filter(|s| placed[*s as usize].normal.dot(&normal) > LEAST_COSINE),
        );
        if groups.surfels.len() > start {
            groups.planes.push(start..groups.surfels.len());
        }
    }
    groups
}
