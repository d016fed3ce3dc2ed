//! Draws a simulated building with the walk, the people and one scan as a PNG.
//!
//! ```text
//! cargo run -p portolan-simulator --example draw_world -- office 1 world.png [seconds of the scan]
//! ```

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;

use portolan_geometry::Vector2;
use portolan_recording::LaserScan;
use portolan_simulator::motion::Motion;
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_worlds::two_d::{Material, Outline, Scene, Shape};

/// Metres per pixel.
const PIXEL: f64 = 0.03;
/// White border, metres.
const MARGIN: f64 = 1.0;

type Colour = [u8; 3];

struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Canvas {
    fn new(size: &Vector2) -> Self {
        let width = ((size.x + 2.0 * MARGIN) / PIXEL) as usize;
        let height = ((size.y + 2.0 * MARGIN) / PIXEL) as usize;
        Self { width, height, pixels: vec![255; 3 * width * height] }
    }

    fn dot(&mut self, at: &Vector2, radius: i64, colour: Colour) {
        let column = ((at.x + MARGIN) / PIXEL).floor() as i64;
        let row = self.height as i64 - 1 - ((at.y + MARGIN) / PIXEL).floor() as i64;
        for y in row - radius..=row + radius {
            for x in column - radius..=column + radius {
                if x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64 {
                    let index = 3 * (y as usize * self.width + x as usize);
                    self.pixels[index..index + 3].copy_from_slice(&colour);
                }
            }
        }
    }

    fn line(&mut self, from: &Vector2, to: &Vector2, radius: i64, colour: Colour) {
        let steps = ((to - from).norm() / (0.5 * PIXEL)).ceil().max(1.0) as usize;
        for i in 0..=steps {
            self.dot(&(from + (to - from) * (i as f64 / steps as f64)), radius, colour);
        }
    }

    fn shape(&mut self, shape: &Shape) {
        let colour = match shape.material {
            Material::Wall | Material::Floor | Material::Ground | Material::Bark => [20, 20, 20],
            Material::Foliage => [40, 150, 60],
            Material::Mirror => [200, 200, 250],
            Material::Door => [160, 90, 20],
            Material::Furniture => [110, 110, 150],
            Material::Metal => [120, 120, 120],
            Material::Glass => [60, 190, 230],
            Material::Person => [220, 0, 160],
        };
        match shape.outline {
            Outline::Segment { start, along } => self.line(&start, &(start + along), 0, colour),
            Outline::Circle { centre, radius } => {
                for i in 0..64 {
                    let (sine, cosine) = (f64::from(i) * std::f64::consts::TAU / 64.0).sin_cos();
                    self.dot(&(centre + Vector2::new(cosine, sine) * radius), 0, colour);
                }
            }
        }
    }

    fn write(&self, path: &str) -> Result<(), Box<dyn Error>> {
        let file = BufWriter::new(File::create(path)?);
        let mut encoder = png::Encoder::new(file, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&self.pixels)?;
        Ok(())
    }
}

/// End points in the map of the beams of a scan that begins at `seconds`.
fn points(simulation: &Simulation, scan: &LaserScan) -> Vec<Vector2> {
    let Some(base_from_lidar) = simulation.base_from_lidar(0) else { return Vec::new() };
    let start = scan.header.stamp.seconds_since(simulation.start_time());
    let in_map = scan.ranges.iter().enumerate().filter(|(_, range)| range.is_finite()).map(|(i, range)| {
        let angle = f64::from(scan.angle_min) + i as f64 * f64::from(scan.angle_increment);
        let in_lidar = portolan_geometry::Vector3::new(angle.cos(), angle.sin(), 0.0) * f64::from(*range);
        let time = start + i as f64 * f64::from(scan.time_increment);
        let map_from_base = simulation.walk().state_2d(time).map_from_base();
        (map_from_base * base_from_lidar * portolan_geometry::nalgebra::Point3::from(in_lidar)).coords.xy()
    });
    in_map.collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |i: usize, default: &'static str| arguments.get(i).map_or(default, String::as_str);
    let scene: Scene = argument(0, "office").parse()?;
    let simulation = Simulation::new(ScenarioOptions::new(scene, argument(1, "1").parse()?))?;
    let seconds: f64 = argument(3, "60").parse()?;
    let mut canvas = Canvas::new(&simulation.plan().size);

    let walk = simulation.walk();
    let steps = (walk.duration() / 0.02) as usize;
    for i in 0..steps {
        let share = (255.0 * i as f64 / steps as f64) as u8;
        canvas.dot(&walk.state_2d(0.02 * i as f64).position, 0, [share, 200 - share / 2, 60]);
    }
    for shape in simulation.world().fixed().shapes() {
        canvas.shape(shape);
    }
    let robot = walk.state_2d(seconds).position;
    for leg in simulation.world().people().iter().flat_map(|person| person.legs(seconds, &robot)) {
        canvas.shape(&leg);
    }
    if let Some(scan) = simulation.scan(0, (seconds * simulation.options().lidars[0].rate) as u64) {
        for point in points(&simulation, &scan) {
            canvas.dot(&point, 1, [230, 30, 30]);
        }
    }
    canvas.dot(&robot, 4, [230, 30, 30]);
    for place in &simulation.plan().places {
        canvas.dot(&place.position, 2, if place.is_room { [40, 160, 40] } else { [40, 40, 200] });
    }
    canvas.write(argument(2, "world.png"))
}
