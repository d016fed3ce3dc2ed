//! Maps: any bytes as a file, checked, summed up, drawn, repaired, migrated and edited.

use std::path::Path;

use portolan_mapfile::{MapDraft, MigrateOptions, PaintOptions, info, load_textures, migrate, paint, repair};
use portolan_pbstream::{MapReader, PbstreamReader, PbstreamWriter, ReadLimits, Severity, validate};

/// Small, so that the fuzzer does not call honest large messages a fault.
const LIMITS: ReadLimits = ReadLimits { max_compressed_bytes: 1 << 20, max_message_bytes: 1 << 20 };

/// The first byte says whether the rest is a file as it is, or one message that is packed and put in its place in a map,
/// so that the content of messages is reached and not only their compression.
///
/// # Panics
/// A map that was repaired has errors.
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

/// A map of four messages of which one is the bytes.
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
