//! How fast are maps read and written? Prints megabytes of unpacked data per second, best of some runs.
//!
//! `cargo bench -p portolan-mapfile -- [map.pbstream] [copies]`: the map is repeated `copies` times.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

use std::io::Cursor;
use std::time::Instant;

use portolan_pbstream::{MapReader, PbstreamReader, PbstreamWriter, ReadLimits};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let given = arguments.first().map(std::path::PathBuf::from);
    let Some(path) = given.or_else(|| portolan_testing::real_data("maps/reference/aces.pbstream")) else {
        return;
    };
    let copies: usize = arguments.get(1).map_or(4, |c| c.parse().unwrap());

    let Ok(reader) = PbstreamReader::open(&path) else {
        println!("{} is not there: nothing measured", path.display());
        return;
    };
    let once: Vec<Vec<u8>> = reader.map(|m| m.unwrap().bytes).collect();
    // Header, pose graph and options once.
    let (start, rest) = once.split_at(3);
    let messages = || start.iter().chain((0..copies).flat_map(|_| rest));
    let unpacked = messages().map(Vec::len).sum::<usize>();
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.pbstream");

    let best = |name: &str, run: &mut dyn FnMut()| {
        let times = (0..5).map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_secs_f64()
        });
        let time = times.fold(f64::INFINITY, f64::min);
        println!(
            "{name}: {:.0} MB/s ({:.3} s for {:.1} MB)",
            unpacked as f64 / time / 1e6,
            time,
            unpacked as f64 / 1e6
        );
    };
    best("write", &mut || {
        let mut writer = PbstreamWriter::create(&copy).unwrap();
        messages().for_each(|m| writer.write_bytes(m.clone()).unwrap());
        writer.finish().unwrap();
    });
    let packed = std::fs::read(&copy).unwrap();
    println!(
        "{:.1} MB packed (other writers: {:.1} MB)",
        packed.len() as f64 / 1e6,
        (copies as u64 * std::fs::metadata(path).unwrap().len()) as f64 / 1e6
    );
    best("read", &mut || {
        let bytes: usize = PbstreamReader::open(&copy).unwrap().map(|m| m.unwrap().bytes.len()).sum();
        assert_eq!(bytes, unpacked);
    });
    best("read and decode", &mut || {
        let source = Cursor::new(packed.clone());
        let mut reader =
            MapReader::from_source(source, Some(packed.len() as u64), ReadLimits::default()).unwrap();
        while reader.next_message().unwrap().is_some() {}
    });
    println!("peak memory {} KiB", peak_memory().unwrap_or_default());
}

fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?.split_whitespace().next()?.parse().ok()
}
