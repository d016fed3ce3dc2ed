//! Estimates the memory that a message needs when it is decoded, before it is decoded.
//!
//! Two bytes of a file can stand for an empty message within a message, which takes hundreds of bytes in
//! memory. Such bytes compress to nearly nothing, so a file of some kilobytes could request many gigabytes.

use std::mem::size_of;

use crate::message::MessageKind;
use crate::proto::mapping as m;
use crate::proto::sensor;
use crate::wire::{Fields, WireValue, joined, put_bytes_field, without_field};

/// Maximum size of a decoded message, bytes; larger ones are rejected. A valid pose graph at the limits of
/// [`ReadLimits`](crate::ReadLimits) needs less.
pub(crate) const MAX_DECODED_BYTES: u64 = 1 << 30;

/// Upper bound of the memory that the content of a message takes when it is decoded, bytes.
pub(crate) fn decoded_size(message: &[u8]) -> u64 {
    let mut size = 0;
    for (tag, value) in Fields::new(message).map_while(Result::ok) {
        let WireValue::Bytes(content) = value else { continue };
        size += match MessageKind::from_tag(tag) {
            MessageKind::PoseGraph => pose_graph(content),
            MessageKind::Options => options(content),
            MessageKind::Submap => nested(content, &[2, 3], submap),
            // Clouds are packed numbers of four bytes; histograms need as much memory as in the file.
            MessageKind::Node => numbers(content),
            MessageKind::LandmarkData => nested(content, &[2], |data| {
                count(data, 2) * size_of::<sensor::landmark_data::LandmarkObservation>() as u64
            }),
            _ => 0,
        };
    }
    // Names and ids need as much memory as in the file.
    size + message.len() as u64
}

/// Sums up `size` of the fields with these numbers, which hold messages.
fn nested(message: &[u8], numbers: &[u32], mut size: impl FnMut(&[u8]) -> u64) -> u64 {
    let fields = Fields::new(message).map_while(Result::ok);
    let sizes = fields.map(|(number, value)| match value {
        WireValue::Bytes(content) if numbers.contains(&number) => size(content),
        _ => 0,
    });
    sizes.sum()
}

/// Number of occurrences of a field.
fn count(message: &[u8], number: u32) -> u64 {
    Fields::new(message).map_while(Result::ok).filter(|(found, _)| *found == number).count() as u64
}

fn pose_graph(message: &[u8]) -> u64 {
    let mut size = 0;
    for (number, value) in Fields::new(message).map_while(Result::ok) {
        size += match (number, value) {
            (2, _) => size_of::<m::pose_graph::Constraint>() as u64,
            (4, WireValue::Bytes(trajectory)) => {
                let parts = Fields::new(trajectory).map_while(Result::ok).map(|(number, _)| match number {
                    1 => size_of::<m::trajectory::Node>() as u64,
                    2 => size_of::<m::trajectory::Submap>() as u64,
                    _ => 0,
                });
                size_of::<m::Trajectory>() as u64 + parts.sum::<u64>()
            }
            (5, _) => size_of::<m::pose_graph::LandmarkPose>() as u64,
            _ => 0,
        };
    }
    // Vectors grow by doubling.
    2 * size
}

fn options(message: &[u8]) -> u64 {
    /// Maximum memory per byte of the lists within options (initial poses, IMU data), bytes.
    const PER_BYTE: u64 = 64;
    let one = |entry: &[u8]| {
        size_of::<m::TrajectoryBuilderOptionsWithSensorIds>() as u64 + PER_BYTE * entry.len() as u64
    };
    2 * nested(message, &[1], one)
}

/// Size of a 2D or 3D submap: that of its grids.
fn submap(message: &[u8]) -> u64 {
    nested(message, &[4, 5], |grid| nested(grid, &[2, 3, 4, 5, 6], numbers))
}

/// Size of packed numbers of four bytes each, also in nested messages.
fn numbers(packed: &[u8]) -> u64 {
    // Counting the numbers is only worth the time for large messages.
    if (4 * packed.len() as u64) < MAX_DECODED_BYTES {
        return 4 * packed.len() as u64;
    }
    4 * packed.iter().filter(|byte| **byte < 0x80).count() as u64
}

/// The message of a submap without the cells of its 2D grid, and the number of these cells. None if there is
/// no such grid, or the message is damaged.
pub(crate) fn without_cells(message: &[u8]) -> Option<(Vec<u8>, u64)> {
    let submap = joined(message, MessageKind::Submap.tag());
    let submap_2d = joined(&submap, 2);
    let grid = joined(&submap_2d, 4);
    let tsdf = joined(&grid, 5);
    let is_whole = |bytes: &[u8]| Fields::new(bytes).all(|field| field.is_ok());
    if grid.is_empty() || ![message, &submap, &submap_2d, &grid, &tsdf].into_iter().all(is_whole) {
        return None;
    }
    let mut cells = 0;
    for (number, value) in Fields::new(&grid).map_while(Result::ok) {
        cells += match (number, value) {
            (2, WireValue::Bytes(packed)) => packed.iter().filter(|byte| **byte < 0x80).count() as u64,
            (2, _) => 1,
            _ => 0,
        };
    }
    let replaced = |message: &[u8], number: u32, content: &[u8]| {
        let mut replaced = without_field(message, number);
        put_bytes_field(&mut replaced, number, content);
        replaced
    };
    let mut grid = without_field(&grid, 2);
    if !tsdf.is_empty() {
        grid = replaced(&grid, 5, &without_field(&tsdf, 3));
    }
    let submap = replaced(&submap, 2, &replaced(&submap_2d, 4, &grid));
    Some((replaced(message, MessageKind::Submap.tag(), &submap), cells))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::RawMessage;

    /// A message of a kind with `inner` repeated `times` times as its fields.
    fn bomb(kind: u32, field: u32, inner: &[u8], times: usize) -> Vec<u8> {
        let mut one = Vec::new();
        crate::wire::put_bytes_field(&mut one, field, inner);
        let mut message = Vec::new();
        crate::wire::put_bytes_field(&mut message, kind, &one.repeat(times));
        message
    }

    #[test]
    fn small_messages_that_become_large_are_refused() {
        let mut nodes = Vec::new();
        crate::wire::put_bytes_field(&mut nodes, 1, &[]);
        let nodes = nodes.repeat(20_000_000);
        let bombs = [
            bomb(1, 2, &[], 20_000_000),
            bomb(1, 4, &nodes, 1),
            bomb(2, 1, &[], 2_000_000),
            bomb(9, 2, &[0x12, 0].repeat(20_000_000), 1),
        ];
        for bytes in bombs {
            assert!(bytes.len() < 50_000_000);
            let error = RawMessage { index: 1, offset: 0, bytes }.decode().unwrap_err();
            assert!(error.to_string().contains("would need"), "{error}");
        }
    }

    #[test]
    fn valid_messages_pass() {
        let constraint = [0x1a, 60].iter().copied().chain([0x0a; 60]).collect::<Vec<u8>>();
        assert!(decoded_size(&bomb(1, 2, &constraint, 1_000_000)) < MAX_DECODED_BYTES / 2);
    }
}
