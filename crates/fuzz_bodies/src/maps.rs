//! Fuzz target for maps: arbitrary bytes as a file are validated, summarised, drawn, repaired, migrated and edited.

use std::path::Path;

use portolan_mapfile::{MapDraft, MigrateOptions, PaintOptions, info, load_textures, migrate, paint, repair};
use portolan_pbstream::{MapReader, PbstreamReader, PbstreamWriter, ReadLimits, Severity, validate};

/// Small limits, so that the fuzzer does not report valid large messages as faults.
const LIMITS: ReadLimits = ReadLimits { max_compressed_bytes: 1 << 20, max_message_bytes: 1 << 20 };

/// Reads and processes a map. The first byte selects whether the rest is a whole file, or one message that is compressed
/// and inserted into a map, so that the fuzzer reaches the content of messages and not only their compression.
///
/// # Panics
/// If a repaired map has errors.
pub fn pbstream(bytes: &[u8]) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let (path, out) = (folder.path().join("map.pbstream"), folder.path().join("out.pbstream"));
    let Some((first, rest)) = bytes.split_first() else { return };
    let written = match first % 4 {
        0 => std::fs::write(&path, rest).is_ok(),
        place => write_map(&path, usize::from(place), rest),
    };
    if written {
        use_map(&path, &out);
    }
}

/// Writes a map of four messages, of which the one at index `place` is `message`; returns whether it was written.
fn write_map(path: &Path, place: usize, message: &[u8]) -> bool {
    let empty = [&[8, 2][..], &[10, 0], &[18, 0], &[26, 0]];
    let write = || -> Result<(), portolan_pbstream::PbstreamError> {
        let mut writer = PbstreamWriter::create(path)?;
        for (i, other) in empty.iter().enumerate() {
            writer.write_bytes(if i == place { message.to_vec() } else { other.to_vec() })?;
        }
        writer.finish()
    };
    write().is_ok()
}

fn use_map(path: &Path, out: &Path) {
    if let Ok(mut reader) = PbstreamReader::open_with(path, LIMITS) {
        validate(&mut reader);
    }
    if let Ok(mut reader) = MapReader::open_with(path, LIMITS) {
        let _ = info(&mut reader);
    }
    if let Ok(textures) = MapReader::open_with(path, LIMITS).and_then(|mut r| load_textures(&mut r)) {
        let _ = paint(&textures.textures, &PaintOptions { max_pixels: 1 << 20, ..PaintOptions::default() });
    }
    let _ = migrate(path, out, MigrateOptions { limits: LIMITS, ..MigrateOptions::default() });
    if let Ok(draft) = MapDraft::open(path, LIMITS) {
        draft.loop_residuals();
        let _ = draft.to_graph();
        let _ = draft.write(out);
    }
    if repair(path, out, LIMITS).is_ok()
        && let Ok(mut reader) = PbstreamReader::open_with(out, LIMITS)
    {
        let left = validate(&mut reader);
        assert!(left.iter().all(|finding| finding.severity < Severity::Error), "{left:?}");
    }
}
