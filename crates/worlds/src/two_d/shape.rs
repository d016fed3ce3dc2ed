//! Surfaces in 2D: segments and circles, with their materials.

use portolan_geometry::Vector2;

/// Material of a surface: determines how much light is scattered back, and whether beams pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Material {
    /// Painted walls and pillars.
    Wall,
    /// Door leaves.
    Door,
    /// Wooden or plastic furniture.
    Furniture,
    /// Metal legs and frames.
    Metal,
    /// Panes, which most beams pass.
    Glass,
    /// Clothes of people.
    Person,
    /// Floors, stairs and ramps.
    Floor,
    /// Mirrors, which reflect beams.
    Mirror,
    /// Earth and grass.
    Ground,
    /// Leaves.
    Foliage,
    /// Trunks.
    Bark,
}

impl Material {
    /// Fraction of the light that is scattered back, in [0, 1].
    pub fn albedo(self) -> f64 {
        match self {
            Self::Wall => 0.75,
            Self::Door => 0.55,
            Self::Furniture => 0.45,
            Self::Metal => 0.3,
            Self::Glass => 0.15,
            Self::Person => 0.25,
            Self::Floor => 0.5,
            Self::Mirror => 0.05,
            Self::Ground => 0.35,
            Self::Foliage => 0.4,
            Self::Bark => 0.3,
        }
    }

    /// Name in lists of walls.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wall => "wall",
            Self::Door => "door",
            Self::Furniture => "furniture",
            Self::Metal => "metal",
            Self::Glass => "glass",
            Self::Person => "person",
            Self::Floor => "floor",
            Self::Mirror => "mirror",
            Self::Ground => "ground",
            Self::Foliage => "foliage",
            Self::Bark => "bark",
        }
    }
}

/// Geometry of a surface, metres in the map frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outline {
    /// A segment from `start` to `start + along`.
    Segment {
        /// One end.
        start: Vector2,
        /// Vector to the other end.
        along: Vector2,
    },
    /// A full circle.
    Circle {
        /// Its centre.
        centre: Vector2,
        /// Metres.
        radius: f64,
    },
}

/// A surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Its geometry.
    pub outline: Outline,
    /// Its material.
    pub material: Material,
}

/// A ray: a half line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Its start, metres in the map frame.
    pub origin: Vector2,
    /// Its direction, a unit vector.
    pub direction: Vector2,
}

/// Hit of a ray on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the start of the ray, metres.
    pub range: f64,
    /// Cosine of the angle between ray and normal, in [0, 1].
    pub cos_incidence: f64,
    /// Material of the surface.
    pub material: Material,
}

pub(crate) fn cross(a: &Vector2, b: &Vector2) -> f64 {
    a.x * b.y - a.y * b.x
}

impl Shape {
    /// A straight surface between two points.
    pub fn segment(start: Vector2, end: Vector2, material: Material) -> Self {
        Self { outline: Outline::Segment { start, along: end - start }, material }
    }

    /// A round surface.
    pub fn circle(centre: Vector2, radius: f64, material: Material) -> Self {
        Self { outline: Outline::Circle { centre, radius }, material }
    }

    /// The nearest hit of a ray on the surface; rays parallel to a segment do not hit it.
    pub fn intersect(&self, ray: &Ray) -> Option<Hit> {
        let (range, cos_incidence) = match self.outline {
            Outline::Segment { start, along } => intersect_segment(ray, &start, &along)?,
            Outline::Circle { centre, radius } => intersect_circle(ray, &centre, radius)?,
        };
        Some(Hit { range, cos_incidence, material: self.material })
    }

    /// Distance of a point to the surface, metres; negative inside a circle.
    pub fn distance(&self, point: &Vector2) -> f64 {
        match self.outline {
            Outline::Segment { start, along } => {
                let length_squared = along.norm_squared();
                let to_point = point - start;
                let share = if length_squared > 0.0 {
                    (to_point.dot(&along) / length_squared).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                (to_point - along * share).norm()
            }
            Outline::Circle { centre, radius } => (point - centre).norm() - radius,
        }
    }

    /// Lower left and upper right corner of the bounding box.
    pub fn bounds(&self) -> (Vector2, Vector2) {
        match self.outline {
            Outline::Segment { start, along } => {
                let end = start + along;
                (start.inf(&end), start.sup(&end))
            }
            Outline::Circle { centre, radius } => {
                let r = Vector2::new(radius, radius);
                (centre - r, centre + r)
            }
        }
    }
}

fn intersect_segment(ray: &Ray, start: &Vector2, along: &Vector2) -> Option<(f64, f64)> {
    let determinant = cross(&ray.direction, along);
    if determinant == 0.0 {
        return None;
    }
    let to_start = start - ray.origin;
    let share = cross(&to_start, &ray.direction) / determinant;
    let range = cross(&to_start, along) / determinant;
    let hit = range >= 0.0 && (0.0..=1.0).contains(&share);
    hit.then(|| (range, determinant.abs() / along.norm()))
}

fn intersect_circle(ray: &Ray, centre: &Vector2, radius: f64) -> Option<(f64, f64)> {
    let to_centre = centre - ray.origin;
    let offset = cross(&ray.direction, &to_centre);
    let half_chord_squared = radius * radius - offset * offset;
    if half_chord_squared < 0.0 {
        return None;
    }
    let half_chord = half_chord_squared.sqrt();
    let middle = to_centre.dot(&ray.direction);
    // From the inside the ray leaves at the far end of the chord.
    let range = if middle - half_chord >= 0.0 { middle - half_chord } else { middle + half_chord };
    (range >= 0.0).then(|| (range, half_chord / radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(x: f64, y: f64, dx: f64, dy: f64) -> Ray {
        Ray { origin: Vector2::new(x, y), direction: Vector2::new(dx, dy).normalize() }
    }

    #[test]
    fn rays_meet_segments_once() {
        let wall = Shape::segment(Vector2::new(2.0, -1.0), Vector2::new(2.0, 1.0), Material::Wall);
        let hit = wall.intersect(&ray(0.0, 0.0, 1.0, 0.0)).unwrap();
        assert!((hit.range - 2.0).abs() < 1e-15 && (hit.cos_incidence - 1.0).abs() < 1e-15);
        assert!(wall.intersect(&ray(0.0, 0.0, -1.0, 0.0)).is_none());
        assert!(wall.intersect(&ray(0.0, 0.0, 0.0, 1.0)).is_none());
        assert!(wall.intersect(&ray(0.0, 0.0, 1.0, 0.6)).is_none());
    }

    #[test]
    fn rays_meet_circles_from_outside_and_inside() {
        let pillar = Shape::circle(Vector2::new(3.0, 0.0), 0.5, Material::Wall);
        let outside = pillar.intersect(&ray(0.0, 0.0, 1.0, 0.0)).unwrap();
        assert!((outside.range - 2.5).abs() < 1e-15);
        let inside = pillar.intersect(&ray(3.2, 0.0, 1.0, 0.0)).unwrap();
        assert!((inside.range - 0.3).abs() < 1e-12);
        assert!(pillar.intersect(&ray(5.0, 0.0, 1.0, 0.0)).is_none());
        assert!((pillar.distance(&Vector2::new(3.0, 2.0)) - 1.5).abs() < 1e-15);
    }
}
