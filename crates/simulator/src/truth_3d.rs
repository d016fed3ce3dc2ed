//! Ground truth in 3D as files: fixed surfaces. The trajectory is written as in 2D.

use std::io::{self, Write};

use portolan_geometry::Vector3;

use crate::Simulation3d;
use portolan_worlds::three_d::{Body, Solid};
use portolan_worlds::two_d::Material;

/// Number of sides of the prisms, and of corners of the rings, as which cylinders and balls are written.
const SIDES: usize = 24;

impl Simulation3d {
    /// Writes all fixed surfaces exactly, as JSON: a list of objects with `kind` (`box`, `triangle`,
    /// `cylinder`, `ball`), `material` and their measures in metres (`yaw` in radians).
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_surfaces_json(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "[")?;
        let solids = self.world().fixed().solids();
        for (i, solid) in solids.iter().enumerate() {
            let end = if i + 1 < solids.len() { "," } else { "" };
            writeln!(out, "{}{end}", json(solid))?;
        }
        writeln!(out, "]")
    }

    /// Writes all fixed surfaces as a mesh of triangles (PLY, binary, a colour per corner by material).
    /// Cylinders become prisms with 24 sides, balls bands between rings of 24 corners.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_surfaces_ply(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut triangles: Vec<([Vector3; 3], Material)> = Vec::new();
        for solid in self.world().fixed().solids() {
            mesh(&solid.body, &mut |corners| triangles.push((corners, solid.material)));
        }
        write!(out, "ply\nformat binary_little_endian 1.0\ncomment fixed surfaces, metres\n")?;
        writeln!(out, "element vertex {}", 3 * triangles.len())?;
        write!(out, "property float x\nproperty float y\nproperty float z\n")?;
        write!(out, "property uchar red\nproperty uchar green\nproperty uchar blue\n")?;
        write!(
            out,
            "element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
            triangles.len()
        )?;
        for (corners, material) in &triangles {
            for corner in corners {
                for value in [corner.x as f32, corner.y as f32, corner.z as f32] {
                    out.write_all(&value.to_le_bytes())?;
                }
                out.write_all(&colour(*material))?;
            }
        }
        for face in 0..triangles.len() as u32 {
            out.write_all(&[3])?;
            for corner in 0..3 {
                out.write_all(&(3 * face + corner).to_le_bytes())?;
            }
        }
        Ok(())
    }
}

fn json(solid: &Solid) -> String {
    let list = |v: &Vector3| format!("[{:.6},{:.6},{:.6}]", v.x, v.y, v.z);
    let material = solid.material.name();
    match &solid.body {
        Body::Box { centre, half, turn } => format!(
            "{{\"kind\":\"box\",\"material\":\"{material}\",\"centre\":{},\"half\":{},\"yaw\":{:.9}}}",
            list(centre),
            list(half),
            libm::atan2(turn[1], turn[0])
        ),
        Body::Triangle { corner, edges: [first, second] } => format!(
            "{{\"kind\":\"triangle\",\"material\":\"{material}\",\"corners\":[{},{},{}]}}",
            list(corner),
            list(&(corner + first)),
            list(&(corner + second))
        ),
        Body::Cylinder { base, radius, height } => format!(
            "{{\"kind\":\"cylinder\",\"material\":\"{material}\",\"base\":{},\"radius\":{radius:.6},\"height\":{height:.6}}}",
            list(base)
        ),
        Body::Ball { centre, radius } => format!(
            "{{\"kind\":\"ball\",\"material\":\"{material}\",\"centre\":{},\"radius\":{radius:.6}}}",
            list(centre)
        ),
    }
}

fn mesh(body: &Body, add: &mut dyn FnMut([Vector3; 3])) {
    match *body {
        Body::Triangle { corner, edges: [first, second] } => add([corner, corner + first, corner + second]),
        Body::Box { centre, half, turn: [c, s] } => {
            let outline = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[a, b]| {
                let (x, y) = (a * half.x, b * half.y);
                Vector3::new(centre.x + c * x - s * y, centre.y + s * x + c * y, centre.z - half.z)
            });
            prism(&outline, 2.0 * half.z, add);
        }
        Body::Cylinder { base, radius, height } => prism(&circle(base, radius), height, add),
        Body::Ball { centre, radius } => {
            let ring = |k: usize| {
                let (sine, cosine) = libm::sincos(std::f64::consts::PI * (k as f64 / 6.0 - 0.5));
                circle(centre + Vector3::new(0.0, 0.0, radius * sine), radius * cosine)
            };
            for k in 0..6 {
                band(&ring(k), &ring(k + 1), add);
            }
        }
    }
}

fn circle(centre: Vector3, radius: f64) -> Vec<Vector3> {
    let corner = |i: usize| {
        let (sine, cosine) = libm::sincos(std::f64::consts::TAU * i as f64 / SIDES as f64);
        centre + Vector3::new(radius * cosine, radius * sine, 0.0)
    };
    (0..SIDES).map(corner).collect()
}

fn prism(outline: &[Vector3], height: f64, add: &mut dyn FnMut([Vector3; 3])) {
    let top: Vec<Vector3> = outline.iter().map(|p| p + Vector3::new(0.0, 0.0, height)).collect();
    band(outline, &top, add);
    for i in 2..outline.len() {
        add([outline[0], outline[i], outline[i - 1]]);
        add([top[0], top[i - 1], top[i]]);
    }
}

fn band(low: &[Vector3], high: &[Vector3], add: &mut dyn FnMut([Vector3; 3])) {
    for i in 0..low.len() {
        let next = (i + 1) % low.len();
        add([low[i], low[next], high[next]]);
        add([low[i], high[next], high[i]]);
    }
}

fn colour(material: Material) -> [u8; 3] {
    match material {
        Material::Wall => [225, 220, 210],
        Material::Door => [150, 110, 70],
        Material::Furniture => [180, 130, 80],
        Material::Metal => [130, 135, 145],
        Material::Glass => [150, 210, 235],
        Material::Person => [220, 90, 90],
        Material::Floor => [170, 165, 160],
        Material::Mirror => [240, 240, 255],
        Material::Ground => [120, 140, 80],
        Material::Foliage => [70, 150, 60],
        Material::Bark => [100, 75, 50],
    }
}
