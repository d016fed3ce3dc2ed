//! Reads recordings from start to end and prints what is in them and how fast it was read.
//!
//! `cargo run --release -p portolan-recording --example count_messages -- FILE…`

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use portolan_recording::{RecordingError, open_all};

#[allow(clippy::print_stdout)]
fn main() -> Result<(), RecordingError> {
    let paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let start = Instant::now();
    let recording = open_all(&paths)?;
    println!("{}, {} bytes", recording.format(), recording.size_bytes());
    if let Some((first, last)) = recording.time_range() {
        println!("{} to {}", first.unix_decimal(), last.unix_decimal());
    }
    for topic in recording.topics() {
        println!("  {} {} {:?}", topic.topic, topic.type_name, topic.count);
    }
    let opened = start.elapsed();
    let mut reader = recording.read(&|_| true)?;
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    while let Some(message) = reader.next_message()? {
        *counts.entry(format!("{} {}", message.topic, message.message.type_name())).or_default() += 1;
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("read: {counts:#?}");
    for issue in reader.issues() {
        println!("{} × {}{}", issue.count, issue, if issue.lost_data() { " (data lost)" } else { "" });
    }
    let megabytes = recording.size_bytes() as f64 / 1e6;
    println!("opened in {opened:?}, all in {seconds:.3} s, {:.0} MB/s", megabytes / seconds);
    Ok(())
}
