//! Measures the throughput of writing and reading clouds: two million points with intensity and time, by
//! format.
//!
//! `cargo run --release -p portolan-pointcloud --example throughput`

use std::time::Instant;

use portolan_pointcloud::{Attributes, Encoding, PointCloud, WriteOptions, create, open};

const POINTS: usize = 2_000_000;
const BATCH: usize = 50_000;

#[allow(clippy::print_stdout)] // a measurement is there to be printed
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let attributes = Attributes { intensity: true, time: true, color: false };
    for (name, encoding) in [
        ("a.ply", Encoding::Binary),
        ("a.ply", Encoding::Ascii),
        ("a.pcd", Encoding::Binary),
        ("a.pcd", Encoding::Compressed),
        ("a.xyz", Encoding::Ascii),
        ("a.las", Encoding::Binary),
        ("a.laz", Encoding::Binary),
        ("a.e57", Encoding::Binary),
    ] {
        let path = folder.path().join(name);
        let start = Instant::now();
        let mut writer = create(&path, attributes, &WriteOptions { encoding, ..WriteOptions::default() })?;
        let mut batch = PointCloud::new(attributes);
        for i in 0..POINTS {
            let t = i as f64;
            let position = [(t * 0.01).sin() * 20.0, (t * 0.003).cos() * 15.0, (t * 0.07).sin() * 2.0];
            batch.push(position, (i % 200) as f32, 1.7e9 + t * 3e-6, [0; 3]);
            if batch.len() == BATCH {
                writer.write(&batch)?;
                batch.reset(attributes);
            }
        }
        writer.finish()?;
        let (written, start) = (start.elapsed().as_secs_f64(), Instant::now());
        let mut reader = open(&path)?;
        let mut count = 0;
        while reader.next_batch(&mut batch)? {
            count += batch.len();
        }
        let read = start.elapsed().as_secs_f64();
        let rate = |seconds: f64| count as f64 / seconds / 1e6;
        let size = std::fs::metadata(&path)?.len() as f64 / count as f64;
        println!(
            "{name} {encoding:?}: {size:.1} bytes a point, written {:.1} and read {:.1} million points/s",
            rate(written),
            rate(read)
        );
    }
    Ok(())
}
