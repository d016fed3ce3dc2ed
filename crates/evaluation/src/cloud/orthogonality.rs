//! Mutual orthogonality: mean plane variance over the surfaces of three directions at right angles (Kornilova and
//! Ferrer, "Be your own benchmark: no-reference trajectory metric on registered point clouds", 2021).
//!
//! A floor, and walls of two directions, constrain all six degrees of freedom. Other surfaces and points off
//! surfaces do not affect the metric.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

use portolan_geometry::Vector3;
use portolan_spatial::Neighbourhood;
use serde::Serialize;

/// Number of directions that are tried as the first axis, spread over the hemisphere (5° apart).
const DIRECTIONS: usize = 800;
/// Number of rotations about the first axis that are tried, over a quarter of a revolution.
const TURNS: usize = 18;
/// Maximum angle between an axis and the normals that belong to it, radians.
const CONE: f64 = 10.0 * PI / 180.0;
/// Number of times that the axes are refined with the normals that belong to them.
const ROUNDS: usize = 4;
/// Minimum number of surfaces of each axis.
const LEAST_MEMBERS: usize = 20;

/// Thinness of the surfaces along three directions at right angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MutualOrthogonality {
    /// Mean plane variance over the surfaces of the three axes, square metres: the metric. Lower is sharper.
    pub mean_plane_variance: f64,
    /// Standard error of it.
    pub standard_error: f64,
    /// The axes, unit vectors in the frame of the cloud.
    pub axes: [[f64; 3]; 3],
    /// Number of surfaces that belong to each axis.
    pub surfaces: [usize; 3],
    /// Fraction of all planar neighbourhoods that belong to one of the axes, 0 to 1.
    pub share: f64,
}

/// Finds the three orthogonal axes to which most surfaces belong; `None` if there are no such axes.
pub fn mutual_orthogonality(neighbourhoods: &[Neighbourhood]) -> Option<MutualOrthogonality> {
    let planar: Vec<&Neighbourhood> = neighbourhoods.iter().filter(|n| n.is_planar()).collect();
    let normals: Vec<Vector3> = planar.iter().map(|n| Vector3::from(n.normal)).collect();
    let mut axes = best_axes(&normals)?;
    for _ in 0..ROUNDS {
        axes = drawn_to(&normals, &axes)?;
    }
    let mut surfaces = [0; 3];
    let mut variances = Vec::new();
    for (neighbourhood, normal) in planar.iter().zip(&normals) {
        if let Some(axis) = axis_of(normal, &axes) {
            surfaces[axis] += 1;
            variances.push(neighbourhood.variances[0]);
        }
    }
    if surfaces.iter().any(|count| *count < LEAST_MEMBERS) {
        return None;
    }
    let count = variances.len() as f64;
    let mean = variances.iter().sum::<f64>() / count;
    let scatter = variances.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    Some(MutualOrthogonality {
        mean_plane_variance: mean,
        standard_error: (scatter / count).sqrt(),
        axes: axes.map(Into::into),
        surfaces,
        share: count / planar.len() as f64,
    })
}

/// The axis whose cone contains a normal.
fn axis_of(normal: &Vector3, axes: &[Vector3; 3]) -> Option<usize> {
    axes.iter().position(|axis| axis.dot(normal).abs() > CONE.cos())
}

/// Directions spread evenly over a hemisphere.
fn hemisphere() -> Vec<Vector3> {
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    (0..DIRECTIONS)
        .map(|i| {
            let z = (i as f64 + 0.5) / DIRECTIONS as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            Vector3::new(radius * cos, radius * sin, z)
        })
        .collect()
}

/// Tries all axes on normals that are counted by direction.
fn best_axes(normals: &[Vector3]) -> Option<[Vector3; 3]> {
    let directions = hemisphere();
    let mut counts = vec![0_u32; DIRECTIONS];
    for normal in normals {
        let closeness = |i: &usize| directions[*i].dot(normal).abs();
        let nearest = (0..DIRECTIONS).max_by(|a, b| closeness(a).total_cmp(&closeness(b)))?;
        counts[nearest] += 1;
    }
    let counted: Vec<(Vector3, u32)> =
        directions.iter().copied().zip(counts).filter(|(_, count)| *count > 0).collect();
    let mut best: Option<(u64, [Vector3; 3])> = None;
    for first in &directions {
        // Any perpendicular direction; the coordinate axis with the smallest component in the first axis is
        // numerically safe.
        let start = Vector3::ith(first.iamin(), 1.0).cross(first).normalize();
        for turn in 0..TURNS {
            let (sin, cos) = (FRAC_PI_2 * turn as f64 / TURNS as f64).sin_cos();
            let second = start * cos + first.cross(&start) * sin;
            let axes = [*first, second, first.cross(&second)];
            let mut members = [0_u64; 3];
            for (direction, count) in &counted {
                if let Some(axis) = axis_of(direction, &axes) {
                    members[axis] += u64::from(*count);
                }
            }
            let score = members.iter().sum();
            if members.iter().all(|m| *m > 0) && best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, axes));
            }
        }
    }
    best.map(|(_, axes)| axes)
}

/// The orthogonal axes that fit best to the normals that belong to them.
fn drawn_to(normals: &[Vector3], axes: &[Vector3; 3]) -> Option<[Vector3; 3]> {
    let mut sums = [Vector3::zeros(); 3];
    for normal in normals {
        if let Some(axis) = axis_of(normal, axes) {
            sums[axis] += normal * normal.dot(&axes[axis]).signum();
        }
    }
    // The nearest orthogonal matrix, each axis weighted by its normals.
    let svd = nalgebra::Matrix3::from_columns(&sums).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    Some(std::array::from_fn(|k| rotation.column(k).into_owned()))
}

impl fmt::Display for MutualOrthogonality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Mutual orthogonality {:.3} ± {:.3} cm² (thickness {:.2} cm) on {} + {} + {} surfaces at right angles, {:.0} % of the planar ones",
            1e4 * self.mean_plane_variance,
            1e4 * self.standard_error,
            100.0 * self.mean_plane_variance.sqrt(),
            self.surfaces[0],
            self.surfaces[1],
            self.surfaces[2],
            100.0 * self.share
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::quaternion_from_angle_axis;

    fn surface(normal: Vector3, variance: f64) -> Neighbourhood {
        Neighbourhood {
            index: 0,
            entropy: 0.0,
            variances: [variance, 0.004, 0.005],
            normal: normal.into(),
            count: 30.0,
        }
    }

    #[test]
    fn only_surfaces_at_right_angles_count() {
        let turn = quaternion_from_angle_axis(&Vector3::new(0.3, -0.7, 1.1));
        let mut found = Vec::new();
        for i in 0..100 {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            found.extend((0..3).map(|k| surface(turn * Vector3::ith(k, sign), 1e-4)));
            // Thick surfaces in an oblique direction do not count.
            found.push(surface(turn * Vector3::new(1.0, 1.0, 1.0).normalize(), 3e-4));
        }
        let metric = mutual_orthogonality(&found).unwrap();
        assert_eq!(metric.surfaces, [100; 3]);
        assert!((metric.mean_plane_variance - 1e-4).abs() < 1e-9 && (metric.share - 0.75).abs() < 1e-9);
        for axis in metric.axes {
            let best = (0..3).map(|k| (turn * Vector3::ith(k, 1.0)).dot(&Vector3::from(axis)).abs());
            assert!(best.fold(0.0, f64::max) > 0.999_999);
        }
    }

    #[test]
    fn a_corridor_without_ends_has_no_three_directions() {
        let walls: Vec<Neighbourhood> = (0..200).map(|i| surface(Vector3::ith(i % 2, 1.0), 1e-4)).collect();
        assert!(mutual_orthogonality(&walls).is_none() && mutual_orthogonality(&[]).is_none());
    }
}
