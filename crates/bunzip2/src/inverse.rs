//! Inverts the Burrows-Wheeler transform.
//!
//! The transform gives a permutation whose cycle, followed from the origin, spells the text. Each step waits
//! for a memory access at an apparently random address. Therefore the cycle is cut into many pieces, and
//! sixteen of them are followed at the same time, so that sixteen accesses are in flight. The end of a piece
//! gives the piece that follows it.

use std::io::Result;

use crate::block::Transformed;
use crate::damaged;

/// Entries of the permutation; blocks have at most 900,000 bytes.
const ENTRIES: usize = 1 << 20;
const INDEX: usize = ENTRIES - 1;
/// An entry that points to itself, for idle lanes.
const REST: usize = INDEX;
/// Marks the entry at which a piece begins.
const BEGIN: u32 = 1 << 31;
const LANES: usize = 16;
/// Mean length of a piece, bytes; the shorter the pieces, the less time lanes are idle at the end.
const PIECE_BYTES: usize = 1024;

/// Buffers for inverting transforms.
#[derive(Default)]
pub(crate) struct Inverse {
    /// Index of the next entry from bit 8 on, and the byte at that index; or [`BEGIN`] and the number of a
    /// piece.
    next: Vec<u32>,
    pieces: Vec<Piece>,
    /// Bytes that were read along the lanes, step by step.
    steps: Vec<[u8; LANES]>,
    text: Vec<u8>,
}

/// A piece of the cycle.
#[derive(Clone, Copy, Default)]
struct Piece {
    /// The entry that the mark of this piece replaced.
    first: u32,
    /// Lane of its bytes in `steps`; they are the steps from `begin` to `end`.
    lane: usize,
    begin: usize,
    end: usize,
    /// Number of the piece that follows it.
    behind: usize,
}

impl Inverse {
    /// The text whose sorted rotations end in `transformed`; the text itself is rotation number `origin`.
    ///
    /// # Errors
    /// If there is no such rotation.
    pub(crate) fn undo(&mut self, transformed: &Transformed, origin: usize) -> Result<&[u8]> {
        let length = transformed.bytes().len();
        if length >= REST || origin >= length {
            return Err(damaged("a block that begins behind its end"));
        }
        self.sort(transformed);
        self.cut(length, origin);
        self.follow();
        self.join(length);
        Ok(&self.text)
    }

    /// Computes the permutation: all bytes in ascending order, each with its index in `transformed`.
    fn sort(&mut self, transformed: &Transformed) {
        let mut places = transformed.counts;
        let mut sum = 0;
        for place in &mut places {
            sum += std::mem::replace(place, sum);
        }
        self.next.resize(ENTRIES, 0);
        let Some(next) = self.next.first_chunk_mut::<ENTRIES>() else { return };
        for (index, &byte) in transformed.bytes().iter().enumerate() {
            let Some(place) = places.get_mut(usize::from(byte)) else { return };
            if let Some(entry) = next.get_mut(*place as usize & INDEX) {
                *entry = (index as u32) << 8 | u32::from(byte);
            }
            *place += 1;
        }
        next[REST] = (REST as u32) << 8;
    }

    /// Marks the beginnings of pieces; the first piece has the beginning of the text.
    fn cut(&mut self, length: usize, origin: usize) {
        self.pieces.clear();
        let pieces = length.div_ceil(PIECE_BYTES);
        let evenly = (0..pieces).map(|i| i * length / pieces);
        for place in std::iter::once(origin).chain(evenly) {
            let Some(entry) = self.next.get_mut(place).filter(|entry| **entry & BEGIN == 0) else { continue };
            let first = std::mem::replace(entry, BEGIN | self.pieces.len() as u32);
            self.pieces.push(Piece { first, ..Piece::default() });
        }
    }

    /// Follows every piece until another one begins.
    fn follow(&mut self) {
        let Some(next) = self.next.first_chunk::<ENTRIES>() else { return };
        self.steps.clear();
        let mut entries = [(REST as u32) << 8; LANES];
        let mut pieces = [None; LANES];
        let lanes = entries.iter_mut().zip(&mut pieces).enumerate();
        for ((lane, (entry, number)), piece) in lanes.zip(&mut self.pieces) {
            (*entry, *number, piece.lane) = (piece.first, Some(lane), lane);
        }
        let mut waiting = LANES.min(self.pieces.len());
        let mut busy = waiting;
        while busy > 0 {
            self.steps.push(entries.map(|entry| entry as u8));
            let mut marks = 0;
            for entry in &mut entries {
                *entry = next.get((*entry >> 8) as usize & INDEX).copied().unwrap_or(BEGIN);
                marks |= *entry;
            }
            if marks & BEGIN == 0 {
                continue;
            }
            for (entry, piece) in entries.iter_mut().zip(&mut pieces) {
                let (Some(ended), true) = (*piece, *entry & BEGIN != 0) else { continue };
                let Some(ended) = self.pieces.get_mut(ended) else { continue };
                let (end, lane) = (self.steps.len(), ended.lane);
                (ended.end, ended.behind) = (end, (*entry & !BEGIN) as usize);
                *piece = None;
                match self.pieces.get_mut(waiting) {
                    Some(new) => {
                        (new.lane, new.begin, *entry) = (lane, end, new.first);
                        *piece = Some(waiting);
                        waiting += 1;
                    }
                    None => {
                        *entry = (REST as u32) << 8;
                        busy -= 1;
                    }
                }
            }
        }
    }

    /// Joins the pieces in the order of the text. A text that repeats itself has a shorter cycle, which is
    /// traversed more than once.
    fn join(&mut self, length: usize) {
        self.text.clear();
        let mut number = 0;
        while let missing @ 1.. = length - self.text.len() {
            let Some(Piece { lane, begin, end, behind, .. }) = self.pieces.get(number).copied() else {
                return;
            };
            let Some(steps) = self.steps.get(begin..end).filter(|_| lane < LANES) else { return };
            let bytes = steps.iter().take(missing).map(|step| step.get(lane).copied().unwrap_or_default());
            self.text.extend(bytes);
            number = behind;
        }
    }
}
