//! Checks the sizes stated in a file against its length: the library allocates as much memory as a file states.

use std::io::{Read, Seek, SeekFrom};

use las::{Header, raw};

/// Bytes of an extended record before its data.
const EVLR_HEAD: u64 = 60;
/// First bytes of the record that describes the compression, for points in sequence without chunks.
const WITHOUT_CHUNKS: [u8; 2] = [1, 0];

/// First stated size that cannot be in a file of this length, bytes, as text; none if all sizes are possible.
///
/// # Errors
/// The file cannot be read, or its header is damaged.
pub(super) fn beyond_the_file(file: &mut (impl Read + Seek), bytes: u64) -> las::Result<Option<String>> {
    file.rewind()?;
    let header = raw::Header::read_from(&mut *file)?;
    if let Some(evlr) = header.evlr
        && has_too_long_evlr(file, bytes, evlr)?
    {
        return Ok(Some("a record behind its points is longer than the file".to_owned()));
    }
    let offset = u64::from(header.offset_to_point_data);
    file.rewind()?;
    let header = Header::new(&mut *file)?;
    if !header.point_format().is_compressed || is_without_chunks(&header) {
        return Ok(None);
    }
    let Some((table, chunks)) = chunk_table(file, offset, bytes)? else { return Ok(None) };
    // The first point of a chunk is not compressed; after the last full chunk there may be an empty one.
    let room = table.saturating_sub(offset) / u64::from(header.point_format().len().max(1)) + 1;
    Ok((u64::from(chunks) > room).then(|| {
        format!("its table promises {chunks} chunks of points, but there is room for {room} at most")
    }))
}

fn has_too_long_evlr(
    file: &mut (impl Read + Seek),
    bytes: u64,
    evlr: raw::header::Evlr,
) -> std::io::Result<bool> {
    let mut start = evlr.start_of_first_evlr;
    for _ in 0..evlr.number_of_evlrs {
        if bytes.saturating_sub(start) < EVLR_HEAD {
            break;
        }
        file.seek(SeekFrom::Start(start + 20))?;
        let length = number(file)?;
        if length > bytes - start - EVLR_HEAD {
            return Ok(true);
        }
        start += EVLR_HEAD + length;
    }
    Ok(false)
}

fn is_without_chunks(header: &Header) -> bool {
    let mut records = header.vlrs().iter().filter(|vlr| las::laz::is_laszip_vlr(vlr));
    records.next().is_some_and(|vlr| vlr.data.starts_with(&WITHOUT_CHUNKS))
}

/// Offset of the table of chunks and number of chunks it states; none if there is no table, which the library
/// handles.
fn chunk_table(
    file: &mut (impl Read + Seek),
    offset: u64,
    bytes: u64,
) -> std::io::Result<Option<(u64, u32)>> {
    // A writer that cannot seek back writes the offset at the end of the file.
    for place in [offset, bytes.saturating_sub(8)] {
        if bytes.saturating_sub(place) < 8 {
            return Ok(None);
        }
        file.seek(SeekFrom::Start(place))?;
        let table = number(file)?;
        // Interpreted as by the library: a negative offset means no table.
        if table.cast_signed() > offset.cast_signed() {
            if bytes.saturating_sub(table) < 8 {
                return Ok(None);
            }
            // The version precedes the number of chunks.
            file.seek(SeekFrom::Start(table))?;
            return Ok(Some((table, (number(file)? >> 32) as u32)));
        }
    }
    Ok(None)
}

fn number(file: &mut impl Read) -> std::io::Result<u64> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}
