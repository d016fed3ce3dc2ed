//! Draws what the lidars of a simulation in 3D see: a top view and a section of all points, placed by
//! the true motion, with the trajectory in red.
//!
//! `cargo run --release -p portolan-simulator --example render_section -- museum 1 60 /tmp/museum 2`

use std::fs::File;
use std::io::BufWriter;

use portolan_geometry::{Duration, Vector3, nalgebra as na};
use portolan_simulator::{Scenario3dOptions, Simulation3d};
use portolan_worlds::three_d::Scene3d;

const PIXEL: f64 = 0.06;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut next = |default: &str| arguments.next().unwrap_or_else(|| default.to_owned());
    let scene: Scene3d = next("museum").parse()?;
    let (seed, seconds, stem) = (next("1").parse()?, next("60").parse::<f64>()?, next("/tmp/section"));
    let lidars: usize = next("1").parse()?;
    let mut options = Scenario3dOptions::new(scene, seed, lidars);
    options.duration = (seconds > 0.0).then_some(seconds);
    let simulation = Simulation3d::new(options)?;
    let mut points: Vec<(Vector3, f32)> = Vec::new();
    for lidar in 0..lidars {
        let base_from_lidar = simulation.options().lidars[lidar].base_from_lidar;
        for index in (0..simulation.sweep_count(lidar)).step_by(5) {
            let Some(cloud) = simulation.sweep(lidar, index) else { continue };
            for (i, bytes) in cloud.data.chunks_exact(cloud.point_step as usize).enumerate() {
                if i % 5 != 0 {
                    continue;
                }
                let value =
                    |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
                let time = cloud.header.stamp + Duration::from_seconds(f64::from(value(18)));
                let Some(pose) = simulation.truth_at(time) else { continue };
                let local = na::Point3::new(f64::from(value(0)), f64::from(value(4)), f64::from(value(8)));
                points.push(((pose * base_from_lidar * local).coords, value(12)));
            }
        }
    }
    let trajectory: Vec<Vector3> = simulation.truth(20.0).map(|(_, pose)| pose.translation.vector).collect();
    let everything = |_: &Vector3| true;
    draw(&format!("{stem}_top.png"), [0, 1], &points, &trajectory, &everything)?;
    let level = trajectory[0].z;
    draw(&format!("{stem}_floor.png"), [0, 1], &points, &trajectory, &|p| (p.z - level + 0.3).abs() < 0.25)?;
    let middle = trajectory.iter().map(|p| p.y).sum::<f64>() / trajectory.len() as f64;
    draw(&format!("{stem}_section.png"), [0, 2], &points, &trajectory, &|p| (p.y - middle).abs() < 2.5)?;
    Ok(())
}

fn draw(
    path: &str,
    [across, up]: [usize; 2],
    points: &[(Vector3, f32)],
    trajectory: &[Vector3],
    wanted: &dyn Fn(&Vector3) -> bool,
) -> Result<(), Box<dyn std::error::Error>> {
    let shown: Vec<&(Vector3, f32)> = points.iter().filter(|(p, _)| wanted(p)).collect();
    let range = |axis: usize| {
        let mut values: Vec<f64> = shown.iter().map(|(p, _)| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values.get((share * values.len() as f64) as usize).copied().unwrap_or(0.0);
        (at(0.002) - 1.0, at(0.998) + 1.0)
    };
    let ((x0, x1), (y0, y1)) = (range(across), range(up));
    let (width, height) = (((x1 - x0) / PIXEL) as usize, ((y1 - y0) / PIXEL) as usize);
    let mut pixels = vec![12_u8; width * height * 3];
    let mut put = |p: &Vector3, colour: [u8; 3]| {
        let (column, row) = ((p[across] - x0) / PIXEL, (y1 - p[up]) / PIXEL);
        if column >= 0.0 && row >= 0.0 && (column as usize) < width && (row as usize) < height {
            let at = 3 * (row as usize * width + column as usize);
            pixels[at..at + 3].copy_from_slice(&colour);
        }
    };
    for (p, intensity) in shown {
        let v = 70 + (*intensity * 0.9) as u8 / 2;
        put(p, [v, v.saturating_add(20), v.saturating_add(50)]);
    }
    trajectory.iter().for_each(|p| put(p, [255, 60, 40]));
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&pixels)?;
    Ok(())
}
