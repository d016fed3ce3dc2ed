//! Converts the planes of 3D submaps. They have a field of their own, which Cartographer skips. Points have a
//! resolution of a thousandth of a voxel, normals of a fraction of a milliradian. Planes that were read are
//! written with the same numbers.

use nalgebra::Vector3;
use portolan_lidar_odometry::{PlaneMap, PlaneRecord, Unreliable};
use portolan_pbstream::proto::mapping as m;

const POINTS_PER_EDGE: f64 = 1024.0;
const NORMAL_STEPS: f64 = 4095.0;
/// Resolution of standard deviations: metres for points, radians for normals.
const SIGMA: f64 = 1e-4;
const ONE_SIDED: u32 = 1;
const GRAZING_INCIDENCE: u32 = 2;
const DOWNWARD_NORMAL: u32 = 4;

/// Planes as a message.
pub(super) fn planes_to_proto(planes: &PlaneMap) -> m::PlanarVoxelMap {
    let edge = planes.edge();
    let mut message = m::PlanarVoxelMap { edge, ..Default::default() };
    let mut before = [0; 3];
    for plane in planes.records() {
        let voxel = plane.voxel.map(u32::cast_signed);
        message.levels.push(plane.level);
        message.voxels.extend(voxel.iter().zip(before).map(|(index, before)| index - before));
        before = voxel;
        let from_corner = plane.point.cast::<f64>() - plane.corner(edge);
        let steps = from_corner * (POINTS_PER_EDGE / f64::from(edge));
        message.points.extend(steps.iter().map(|v| v.round() as i32));
        message.normals.extend(on_octahedron(&plane.normal.cast()));
        message.sigmas.push(sigma_steps(plane.variance));
        message.normal_sigmas.push(sigma_steps(plane.normal_variance));
        message.hits.push(plane.hits.into());
        message.flags.push(flags(&plane));
    }
    message
}

fn sigma_steps(variance: f32) -> u32 {
    ((f64::from(variance).sqrt() / SIGMA).round() as u32).max(1)
}

fn variance_of(steps: u32) -> f32 {
    (f64::from(steps) * SIGMA).powi(2) as f32
}

fn flags(plane: &PlaneRecord) -> u32 {
    let unreliable = match plane.unreliable {
        Some(Unreliable::GrazingIncidence) => GRAZING_INCIDENCE,
        Some(Unreliable::DownwardNormal) => DOWNWARD_NORMAL,
        None => 0,
    };
    unreliable | if plane.is_one_sided { ONE_SIDED } else { 0 }
}

/// Octahedral encoding of a direction: its intersection with |x| + |y| + |z| = 1, of which the lower half is
/// unfolded around the upper one (Meyer et al. 2010, section 3).
fn on_octahedron(normal: &Vector3<f64>) -> [i32; 2] {
    let n = normal / normal.lp_norm(1);
    let (u, v) = if n.z < 0.0 { unfolded(n.x, n.y) } else { (n.x, n.y) };
    [u, v].map(|v| (NORMAL_STEPS * v).round() as i32)
}

fn unfolded(u: f64, v: f64) -> (f64, f64) {
    ((1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v))
}

/// The direction of a point on the octahedron; none outside of it.
fn normal_of(steps: &[i32]) -> Option<Vector3<f32>> {
    let &[u, v] = steps else { return None };
    let (u, v) = (f64::from(u) / NORMAL_STEPS, f64::from(v) / NORMAL_STEPS);
    let z = 1.0 - u.abs() - v.abs();
    let (x, y) = if z < 0.0 { unfolded(u, v) } else { (u, v) };
    (u.abs() <= 1.0 && v.abs() <= 1.0).then(|| Vector3::new(x, y, z).normalize().cast())
}

/// Planes from their message; none if they are damaged.
pub(super) fn planes_from_proto(message: &m::PlanarVoxelMap) -> Option<PlaneMap> {
    let mut planes = Vec::with_capacity(message.levels.len());
    let mut voxel = [0_i32; 3];
    for i in 0..message.levels.len() {
        for (index, step) in voxel.iter_mut().zip(message.voxels.get(3 * i..3 * i + 3)?) {
            *index = index.checked_add(*step)?;
        }
        planes.push(plane(message, i, voxel)?);
    }
    PlaneMap::from_records(message.edge, planes.into_iter())
}

fn plane(message: &m::PlanarVoxelMap, i: usize, voxel: [i32; 3]) -> Option<PlaneRecord> {
    let flags = *message.flags.get(i)?;
    let [x, y, z] = voxel.map(|index| u32::try_from(index).ok());
    let plane = PlaneRecord {
        voxel: [x?, y?, z?],
        level: *message.levels.get(i)?,
        point: Vector3::zeros(),
        normal: normal_of(message.normals.get(2 * i..2 * i + 2)?)?,
        variance: variance_of(*message.sigmas.get(i)?),
        normal_variance: variance_of(*message.normal_sigmas.get(i)?),
        hits: u16::try_from(*message.hits.get(i)?).ok()?,
        is_one_sided: flags & ONE_SIDED != 0,
        unreliable: match flags & !ONE_SIDED {
            0 => None,
            GRAZING_INCIDENCE => Some(Unreliable::GrazingIncidence),
            DOWNWARD_NORMAL => Some(Unreliable::DownwardNormal),
            _ => return None,
        },
    };
    let steps = Vector3::from_column_slice(message.points.get(3 * i..3 * i + 3)?).map(f64::from);
    let point = plane.corner(message.edge) + steps * (f64::from(message.edge) / POINTS_PER_EDGE);
    Some(PlaneRecord { point: point.cast(), ..plane })
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Point3f;

    use super::*;

    /// A floor and two walls.
    fn planes() -> PlaneMap {
        let mut planes = PlaneMap::new(1.0);
        for i in 0..4000 {
            let (u, v) = (0.05 * (i % 80) as f32 - 2.0, 0.05 * (i / 80) as f32);
            let (noise, seen_from) = (0.01 * (i % 5) as f32, Point3f::new(0.5, 0.4, 1.0));
            for point in [Point3f::new(u, 3.0 + noise, v), Point3f::new(u, v, -1.0 - noise)] {
                planes.insert_seen_from(&point, &seen_from);
            }
            planes.insert(&Point3f::new(-300.0 + 0.3 * v + noise, 20.0 + u, v));
        }
        planes.compacted()
    }

    #[test]
    fn planes_come_back_from_their_message() {
        let planes = planes();
        let message = planes_to_proto(&planes);
        assert!(message.levels.len() >= 24, "{}", message.levels.len());
        let back = planes_from_proto(&message).unwrap();
        assert_eq!(planes_to_proto(&back), message);
        for (plane, back) in planes.records().zip(back.records()) {
            assert!((plane.point - back.point).norm() < 1e-3, "{plane:?} {back:?}");
            assert!(plane.normal.angle(&back.normal) < 1e-3, "{plane:?} {back:?}");
            assert!((plane.variance.sqrt() - back.variance.sqrt()).abs() < 1.1e-4);
            let rest = PlaneRecord { voxel: plane.voxel, level: plane.level, hits: plane.hits, ..back };
            assert_eq!(rest, back);
        }
    }

    #[test]
    fn normals_all_around_come_back() {
        for i in 0..500 {
            let (z, turn) = (1.0 - f64::from(i) / 249.5, 2.4 * f64::from(i));
            let across = (1.0 - z * z).max(0.0).sqrt();
            let normal = Vector3::new(across * turn.cos(), across * turn.sin(), z);
            let steps = on_octahedron(&normal);
            let back = normal_of(&steps).unwrap();
            assert!(normal.angle(&back.cast()) < 6e-4, "{normal}");
            assert_eq!(on_octahedron(&back.cast()), steps);
        }
        assert_eq!(normal_of(&[5000, 0]), None);
    }

    #[test]
    fn damaged_planes_are_none() {
        let message = planes_to_proto(&planes());
        let is_damaged = |change: fn(&mut m::PlanarVoxelMap)| {
            let mut message = message.clone();
            change(&mut message);
            planes_from_proto(&message).is_none()
        };
        assert!(!is_damaged(|_| ()));
        assert!(is_damaged(|m| m.points.truncate(4)) && is_damaged(|m| m.flags[1] = 6));
        assert!(is_damaged(|m| m.hits[0] = 1 << 16) && is_damaged(|m| m.edge = -1.0));
        assert!(is_damaged(|m| m.voxels[7] = i32::MAX) && is_damaged(|m| m.voxels[0] = -9));
    }
}
