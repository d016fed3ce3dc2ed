//! Solids and surfaces of worlds in 3D, and their intersections with rays.

use portolan_geometry::Vector3;

use crate::two_d::Material;

/// Minimum range of a hit, metres.
const NEAREST: f64 = 1e-6;

/// A ray: a half line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray3 {
    /// Its start, metres in the map frame.
    pub origin: Vector3,
    /// Its direction, a unit vector.
    pub direction: Vector3,
}

impl Ray3 {
    /// The point at a range, metres.
    pub fn at(&self, range: f64) -> Vector3 {
        self.origin + self.direction * range
    }
}

/// Hit of a ray on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit3 {
    /// Distance from the start of the ray, metres.
    pub range: f64,
    /// Unit normal of the surface, against the ray.
    pub normal: Vector3,
    /// Material of the surface.
    pub material: Material,
}

/// Geometry of a solid or a surface, metres in the map frame. Solids are hit from outside only: a ray that
/// starts inside one leaves it without a hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body {
    /// A box, rotated about the vertical.
    Box {
        /// Its centre.
        centre: Vector3,
        /// Half of its edges, along its own axes.
        half: Vector3,
        /// Cosine and sine of its yaw.
        turn: [f64; 2],
    },
    /// A triangle, hit from both sides.
    Triangle {
        /// One corner.
        corner: Vector3,
        /// Vectors from it to the other two corners.
        edges: [Vector3; 2],
    },
    /// An upright cylinder with flat ends.
    Cylinder {
        /// Centre of its lower end.
        base: Vector3,
        /// Metres.
        radius: f64,
        /// Metres.
        height: f64,
    },
    /// A ball.
    Ball {
        /// Its centre.
        centre: Vector3,
        /// Metres.
        radius: f64,
    },
}

/// A body and its material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    /// Its geometry.
    pub body: Body,
    /// Its material.
    pub material: Material,
}

/// An axis-aligned bounding box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: Vector3,
    /// Largest coordinates.
    pub max: Vector3,
}

impl Bounds {
    /// The box that contains nothing.
    pub const fn empty() -> Self {
        let inf = f64::INFINITY;
        Self { min: Vector3::new(inf, inf, inf), max: Vector3::new(-inf, -inf, -inf) }
    }

    /// The smallest box that contains both.
    pub fn union(&self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }

    /// Half of the surface, square metres; 0 if empty.
    pub fn half_area(&self) -> f64 {
        let d = (self.max - self.min).map(|v| v.max(0.0));
        d.x * d.y + d.y * d.z + d.z * d.x
    }

    /// The middle.
    pub fn centre(&self) -> Vector3 {
        (self.min + self.max) * 0.5
    }
}

impl Body {
    /// Its axis-aligned bounding box.
    pub fn bounds(&self) -> Bounds {
        let around = |centre: Vector3, half: Vector3| Bounds { min: centre - half, max: centre + half };
        match *self {
            Self::Box { centre, half, turn: [c, s] } => {
                let (c, s) = (c.abs(), s.abs());
                around(centre, Vector3::new(c * half.x + s * half.y, s * half.x + c * half.y, half.z))
            }
            Self::Triangle { corner, edges: [first, second] } => {
                let (b, c) = (corner + first, corner + second);
                Bounds { min: corner.inf(&b).inf(&c), max: corner.sup(&b).sup(&c) }
            }
            Self::Cylinder { base, radius, height } => {
                let half = Vector3::new(radius, radius, 0.5 * height);
                around(base + Vector3::new(0.0, 0.0, 0.5 * height), half)
            }
            Self::Ball { centre, radius } => around(centre, Vector3::new(radius, radius, radius)),
        }
    }

    /// Range at which a ray hits it, and the normal there; none if the range is not below `limit`, metres.
    pub fn meet(&self, ray: &Ray3, limit: f64) -> Option<(f64, Vector3)> {
        let (range, normal) = match self {
            Self::Box { centre, half, turn } => meet_box(ray, centre, half, *turn)?,
            Self::Triangle { corner, edges } => meet_triangle(ray, corner, edges)?,
            Self::Cylinder { base, radius, height } => meet_cylinder(ray, base, *radius, *height)?,
            Self::Ball { centre, radius } => meet_ball(ray, centre, *radius)?,
        };
        (range > NEAREST && range < limit).then_some((range, normal))
    }
}

/// The slab test in the frame of the box; the normal is that of the face entered last.
fn meet_box(ray: &Ray3, centre: &Vector3, half: &Vector3, [c, s]: [f64; 2]) -> Option<(f64, Vector3)> {
    let to_box = |v: Vector3| Vector3::new(c * v.x + s * v.y, c * v.y - s * v.x, v.z);
    let (origin, direction) = (to_box(ray.origin - centre), to_box(ray.direction));
    let (mut enter, mut leave, mut face) = (f64::NEG_INFINITY, f64::INFINITY, 0);
    for axis in 0..3 {
        if direction[axis] == 0.0 {
            if origin[axis].abs() > half[axis] {
                return None;
            }
            continue;
        }
        let inverse = 1.0 / direction[axis];
        let middle = -origin[axis] * inverse;
        let reach = half[axis] * inverse.abs();
        if middle - reach > enter {
            (enter, face) = (middle - reach, axis);
        }
        leave = leave.min(middle + reach);
    }
    if enter > leave || enter <= 0.0 {
        return None;
    }
    let mut normal = Vector3::zeros();
    normal[face] = -direction[face].signum();
    Some((enter, Vector3::new(c * normal.x - s * normal.y, s * normal.x + c * normal.y, normal.z)))
}

/// Intersection by Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
fn meet_triangle(ray: &Ray3, corner: &Vector3, [first, second]: &[Vector3; 2]) -> Option<(f64, Vector3)> {
    let p = ray.direction.cross(second);
    let determinant = first.dot(&p);
    if determinant.abs() < 1e-12 {
        return None;
    }
    let inverse = 1.0 / determinant;
    let from_corner = ray.origin - corner;
    let u = from_corner.dot(&p) * inverse;
    if !(0.0..=1.0).contains(&u) {
        return None;
    }
    let q = from_corner.cross(first);
    let v = ray.direction.dot(&q) * inverse;
    if v < 0.0 || u + v > 1.0 {
        return None;
    }
    let normal = first.cross(second).normalize();
    let against = if normal.dot(&ray.direction) > 0.0 { -normal } else { normal };
    Some((second.dot(&q) * inverse, against))
}

fn meet_cylinder(ray: &Ray3, base: &Vector3, radius: f64, height: f64) -> Option<(f64, Vector3)> {
    let (o, d) = (ray.origin - base, ray.direction);
    let a = d.x * d.x + d.y * d.y;
    let b = o.x * d.x + o.y * d.y;
    let c = o.x * o.x + o.y * o.y - radius * radius;
    if a > 1e-18 {
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            return None;
        }
        let range = (-b - discriminant.sqrt()) / a;
        let z = o.z + d.z * range;
        if range > 0.0 && (0.0..=height).contains(&z) {
            return Some((
                range,
                Vector3::new((o.x + d.x * range) / radius, (o.y + d.y * range) / radius, 0.0),
            ));
        }
    }
    // A flat end, hit from above or from below.
    let end = if d.z < 0.0 { height } else { 0.0 };
    if d.z == 0.0 {
        return None;
    }
    let range = (end - o.z) / d.z;
    let (x, y) = (o.x + d.x * range, o.y + d.y * range);
    (range > 0.0 && x * x + y * y <= radius * radius)
        .then_some((range, Vector3::new(0.0, 0.0, -d.z.signum())))
}

fn meet_ball(ray: &Ray3, centre: &Vector3, radius: f64) -> Option<(f64, Vector3)> {
    let o = ray.origin - centre;
    let b = o.dot(&ray.direction);
    let c = o.norm_squared() - radius * radius;
    let discriminant = b * b - c;
    if discriminant < 0.0 || c < 0.0 {
        return None;
    }
    let range = -b - discriminant.sqrt();
    (range > 0.0).then(|| (range, (o + ray.direction * range) / radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: [f64; 3], towards: [f64; 3]) -> Ray3 {
        let origin = Vector3::from(origin);
        Ray3 { origin, direction: (Vector3::from(towards) - origin).normalize() }
    }

    #[test]
    fn ranges_and_normals_are_exact() {
        let (s, c) = libm::sincos(0.7);
        let cases: [(Body, Ray3, f64, [f64; 3]); 5] = [
            (
                Body::Box {
                    centre: Vector3::new(5.0, 0.0, 1.0),
                    half: Vector3::new(1.0, 2.0, 1.0),
                    turn: [1.0, 0.0],
                },
                ray([0.0, 0.5, 1.0], [9.0, 0.5, 1.0]),
                4.0,
                [-1.0, 0.0, 0.0],
            ),
            (
                Body::Box { centre: Vector3::zeros(), half: Vector3::new(1.0, 2.0, 1.0), turn: [c, s] },
                ray([10.0 * c, 10.0 * s, 0.0], [0.0, 0.0, 0.0]),
                9.0,
                [c, s, 0.0],
            ),
            (
                Body::Cylinder { base: Vector3::zeros(), radius: 0.5, height: 2.0 },
                ray([3.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
                2.5,
                [1.0, 0.0, 0.0],
            ),
            (
                Body::Cylinder { base: Vector3::zeros(), radius: 0.5, height: 2.0 },
                ray([0.1, 0.0, 5.0], [0.1, 0.0, 0.0]),
                3.0,
                [0.0, 0.0, 1.0],
            ),
            (
                Body::Ball { centre: Vector3::new(0.0, 4.0, 0.0), radius: 1.0 },
                ray([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
                3.0,
                [0.0, -1.0, 0.0],
            ),
        ];
        for (body, ray, range, normal) in cases {
            let (met, n) = body.meet(&ray, 100.0).unwrap();
            assert!((met - range).abs() < 1e-12 && (n - Vector3::from(normal)).norm() < 1e-12, "{body:?}");
            assert!(body.meet(&ray, range - 1e-9).is_none());
            let point = ray.at(met);
            let bounds = body.bounds();
            assert!((0..3).all(|i| point[i] >= bounds.min[i] - 1e-12 && point[i] <= bounds.max[i] + 1e-12));
            let inside = Ray3 { origin: bounds.centre(), ..ray };
            assert!(body.meet(&inside, 100.0).is_none());
        }
    }

    #[test]
    fn triangles_are_met_from_both_sides() {
        let body = Body::Triangle {
            corner: Vector3::zeros(),
            edges: [Vector3::new(2.0, 0.0, 0.0), Vector3::new(0.0, 2.0, 0.0)],
        };
        for (z, normal) in [(3.0, 1.0), (-3.0, -1.0)] {
            let (range, n) = body.meet(&ray([0.5, 0.5, z], [0.5, 0.5, 0.0]), 10.0).unwrap();
            assert!((range - 3.0).abs() < 1e-12 && n.z == normal);
        }
        assert!(body.meet(&ray([1.5, 1.5, 3.0], [1.5, 1.5, 0.0]), 10.0).is_none());
    }
}
