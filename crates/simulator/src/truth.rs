//! Ground truth as files: trajectory, walls, occupancy.

use std::io::{self, Write};

use portolan_geometry::{Rigid3, Time, Vector2};

use crate::Simulation;
use crate::motion::Motion;
use portolan_worlds::two_d::{Outline, Shape};

/// Number of corners of the polygons as which circles are written.
const CIRCLE_CORNERS: usize = 24;

impl Simulation {
    /// Writes all fixed surfaces as straight segments: a header line, then `x0,y0,x1,y1,material`, metres.
    /// Circles become polygons with 24 corners on the circle.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_walls_csv(&self, out: &mut dyn Write) -> io::Result<()> {
        writeln!(out, "x0,y0,x1,y1,material")?;
        for shape in self.world().fixed().shapes() {
            let corners = corners(shape);
            for pair in corners.windows(2) {
                let name = shape.material.name();
                writeln!(out, "{:.6},{:.6},{:.6},{:.6},{name}", pair[0].x, pair[0].y, pair[1].x, pair[1].y)?;
            }
        }
        Ok(())
    }

    /// The true occupancy with cells of `resolution` metres (at least 5 mm): occupied where a fixed
    /// surface, glass too, passes; free where cells are connected with the walk; unknown elsewhere.
    pub fn occupancy(&self, resolution: f64) -> OccupancyPicture {
        let mut picture = OccupancyPicture::unknown(self.plan().size, resolution.max(0.005));
        for shape in self.world().fixed().shapes() {
            for pair in corners(shape).windows(2) {
                picture.mark_line(&pair[0], &pair[1]);
            }
        }
        let mut time = 0.0;
        while time < self.walk().duration() {
            picture.fill_free(&self.walk().state_2d(time).position);
            time += 0.5;
        }
        picture
    }
}

/// Writes poses in TUM format, one a line.
pub(crate) fn write_tum(out: &mut dyn Write, poses: impl Iterator<Item = (Time, Rigid3)>) -> io::Result<()> {
    for (time, pose) in poses {
        let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
        write!(out, "{} {:.9} {:.9} {:.9} ", time.unix_decimal(), t.x, t.y, t.z)?;
        writeln!(out, "{:.12} {:.12} {:.12} {:.12}", q.i, q.j, q.k, q.w)?;
    }
    Ok(())
}

/// The corners of an outline, the first again at the end of a closed one.
fn corners(shape: &Shape) -> Vec<Vector2> {
    match shape.outline {
        Outline::Segment { start, along } => vec![start, start + along],
        Outline::Circle { centre, radius } => (0..=CIRCLE_CORNERS)
            .map(|i| {
                let turn = (i % CIRCLE_CORNERS) as f64 / CIRCLE_CORNERS as f64;
                let (sine, cosine) = libm::sincos(std::f64::consts::TAU * turn);
                centre + Vector2::new(cosine, sine) * radius
            })
            .collect(),
    }
}

/// An occupancy grid as a grey picture, as ROS map servers use it.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancyPicture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Metres per pixel.
    pub resolution: f64,
    /// Lower left corner of the picture in the map, metres.
    pub origin: Vector2,
    /// Row by row from the top: 0 occupied, 254 free, 205 unknown.
    pub pixels: Vec<u8>,
}

impl OccupancyPicture {
    /// Pixel of an occupied cell.
    pub const OCCUPIED: u8 = 0;
    /// Pixel of a free cell.
    pub const FREE: u8 = 254;
    /// Pixel of an unknown cell.
    pub const UNKNOWN: u8 = 205;

    /// All cells unknown, with half a metre more than the floor on each side.
    fn unknown(size: Vector2, resolution: f64) -> Self {
        let margin = 0.5;
        let width = ((size.x + 2.0 * margin) / resolution).ceil() as usize;
        let height = ((size.y + 2.0 * margin) / resolution).ceil() as usize;
        let origin = Vector2::new(-margin, -margin);
        Self { width, height, resolution, origin, pixels: vec![Self::UNKNOWN; width * height] }
    }

    /// The pixel around a point of the map; none outside.
    pub fn pixel_at(&self, point: &Vector2) -> Option<u8> {
        self.index_of(point).map(|index| self.pixels[index])
    }

    fn index_of(&self, point: &Vector2) -> Option<usize> {
        let cell = (point - self.origin) / self.resolution;
        let (column, row) = (cell.x.floor(), cell.y.floor());
        let is_inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        is_inside.then(|| (self.height - 1 - row as usize) * self.width + column as usize)
    }

    /// Marks the cells along a line as occupied, by samples a fifth of a cell apart.
    fn mark_line(&mut self, from: &Vector2, to: &Vector2) {
        let steps = ((to - from).norm() / (0.2 * self.resolution)).ceil().max(1.0) as usize;
        for i in 0..=steps {
            let point = from + (to - from) * (i as f64 / steps as f64);
            if let Some(index) = self.index_of(&point) {
                self.pixels[index] = Self::OCCUPIED;
            }
        }
    }

    /// Marks all cells as free that are connected with `point` by cells side by side.
    fn fill_free(&mut self, point: &Vector2) {
        let mut open: Vec<usize> = self.index_of(point).into_iter().collect();
        while let Some(index) = open.pop() {
            if self.pixels[index] != Self::UNKNOWN {
                continue;
            }
            self.pixels[index] = Self::FREE;
            let (column, row) = (index % self.width, index / self.width);
            open.extend((column > 0).then(|| index - 1));
            open.extend((column + 1 < self.width).then_some(index + 1));
            open.extend((row > 0).then(|| index - self.width));
            open.extend((row + 1 < self.height).then_some(index + self.width));
        }
    }

    /// As a binary PGM file.
    pub fn to_pgm(&self) -> Vec<u8> {
        let mut bytes = format!("P5\n{} {}\n255\n", self.width, self.height).into_bytes();
        bytes.extend_from_slice(&self.pixels);
        bytes
    }

    /// The description that ROS map servers read beside the picture `image`.
    pub fn to_yaml(&self, image: &str) -> String {
        format!(
            "image: {image}\nresolution: {}\norigin: [{}, {}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
            self.resolution, self.origin.x, self.origin.y
        )
    }
}
