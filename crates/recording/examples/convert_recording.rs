//! Writes the understood messages of recordings anew, as ROS 1 bag or MCAP.
//!
//! `cargo run --release -p portolan-recording --example convert_recording -- IN… OUT.bag|OUT.mcap`

use std::path::PathBuf;

use portolan_recording::{Message, RecordingError, create, open_all};

fn main() -> Result<(), RecordingError> {
    let mut paths: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let output = paths.pop().unwrap_or_default();
    let mut writer = create(output, None)?;
    let mut reader = open_all(&paths)?.read(&|_| true)?;
    while let Some(message) = reader.next_message()? {
        if !matches!(message.message, Message::Other { .. }) {
            writer.write(&message)?;
        }
    }
    writer.finish()
}
