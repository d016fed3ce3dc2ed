//! Writes sorted runs of cells to a temporary file, and merges them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::path::{Path, PathBuf};

use portolan_spatial::VoxelKey as Key;

use super::VoxelPoint;
use crate::error::CloudError;
use crate::output::Spool;

/// Size of a cell in the file, bytes.
const CELL_BYTES: usize = 60;
/// Number of cells of each run that are read at a time.
const CELLS_AT_ONCE: u64 = 1024;

/// Sums over the points of a voxel. Positions are in voxels from its lower corner.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cell {
    within: [f64; 3],
    intensity: f64,
    time: f64,
    count: u64,
}

impl Cell {
    #[inline]
    pub fn add(&mut self, within: [f64; 3], intensity: f32, time: f64) {
        for (sum, value) in self.within.iter_mut().zip(within) {
            *sum += value;
        }
        self.intensity += f64::from(intensity);
        self.time += time;
        self.count += 1;
    }

    fn join(&mut self, other: &Self) {
        for (sum, value) in self.within.iter_mut().zip(other.within) {
            *sum += value;
        }
        self.intensity += other.intensity;
        self.time += other.time;
        self.count += other.count;
    }

    pub fn point(&self, key: Key, voxel_size: f64, first_time: f64) -> VoxelPoint {
        let count = self.count.max(1) as f64;
        let ([x, y, z], [a, b, c]) = (key.map(f64::from), self.within);
        VoxelPoint {
            position: [x + a / count, y + b / count, z + c / count].map(|v| v * voxel_size),
            intensity: (self.intensity / count) as f32,
            time: first_time + self.time / count,
            count: self.count,
        }
    }

    fn encode(&self, key: Key, bytes: &mut Vec<u8>) {
        for value in key {
            bytes.extend(value.to_le_bytes());
        }
        for value in [self.within[0], self.within[1], self.within[2], self.intensity, self.time] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(self.count.to_le_bytes());
    }

    /// Decodes a whole record of a buffer of a run.
    fn decode(bytes: &[u8]) -> (Key, Self) {
        fn part<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
            let mut value = [0; N];
            if let Some(source) = bytes.get(at..at + N) {
                value.copy_from_slice(source);
            }
            value
        }
        let key = [0, 4, 8].map(|at| i32::from_le_bytes(part(bytes, at)));
        let double = |i: usize| f64::from_le_bytes(part(bytes, 12 + 8 * i));
        let cell = Self {
            within: [double(0), double(1), double(2)],
            intensity: double(3),
            time: double(4),
            count: u64::from_le_bytes(part(bytes, 52)),
        };
        (key, cell)
    }
}

/// All runs, in sequence in one file.
pub(super) struct Runs {
    folder: PathBuf,
    file: Option<Spool>,
    /// Start and end of each run, in cells.
    spans: Vec<(u64, u64)>,
}

/// State while reading a run.
struct RunReader {
    next: u64,
    end: u64,
    buffer: Vec<u8>,
    at: usize,
}

impl RunReader {
    fn next(&mut self, file: &mut Spool, folder: &Path) -> Result<Option<(Key, Cell)>, CloudError> {
        if self.at == self.buffer.len() {
            let count = CELLS_AT_ONCE.min(self.end - self.next);
            if count == 0 {
                return Ok(None);
            }
            self.buffer.resize(count as usize * CELL_BYTES, 0);
            file.read_at(self.next * CELL_BYTES as u64, &mut self.buffer)
                .map_err(|e| CloudError::temporary(folder, e))?;
            (self.next, self.at) = (self.next + count, 0);
        }
        let record = self.buffer.get(self.at..self.at + CELL_BYTES).unwrap_or_default();
        self.at += CELL_BYTES;
        Ok(Some(Cell::decode(record)))
    }
}

impl Runs {
    /// No runs; the first one creates a file in this folder.
    pub fn in_folder(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), file: None, spans: Vec::new() }
    }

    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// Appends a run of cells in ascending order.
    ///
    /// # Errors
    /// The temporary file cannot be created or written.
    pub fn write(&mut self, cells: &[(Key, Cell)]) -> Result<(), CloudError> {
        let failed = |e| CloudError::temporary(&self.folder, e);
        let file = match &mut self.file {
            Some(file) => file,
            None => self.file.insert(Spool::in_folder(&self.folder).map_err(failed)?),
        };
        let mut bytes = Vec::with_capacity(CELL_BYTES * CELLS_AT_ONCE as usize);
        for part in cells.chunks(CELLS_AT_ONCE as usize) {
            bytes.clear();
            part.iter().for_each(|(key, cell)| cell.encode(*key, &mut bytes));
            file.append(&bytes).map_err(failed)?;
        }
        let start = self.spans.last().map_or(0, |span| span.1);
        self.spans.push((start, start + cells.len() as u64));
        Ok(())
    }

    /// Visits all cells in ascending order; cells of one voxel are added up in the order of their runs.
    ///
    /// # Errors
    /// The temporary file cannot be read, or `visit` fails.
    pub fn merge(
        &mut self,
        visit: &mut dyn FnMut(&Key, &Cell) -> Result<(), CloudError>,
    ) -> Result<(), CloudError> {
        let (Some(file), folder) = (&mut self.file, &self.folder) else { return Ok(()) };
        let reader =
            |(start, end): &(u64, u64)| RunReader { next: *start, end: *end, buffer: Vec::new(), at: 0 };
        let mut readers: Vec<RunReader> = self.spans.iter().map(reader).collect();
        let mut heads: Vec<Cell> = Vec::with_capacity(readers.len());
        let mut queue = BinaryHeap::with_capacity(readers.len());
        for (run, reader) in readers.iter_mut().enumerate() {
            let head = reader.next(file, folder)?;
            heads.push(head.map(|(_, cell)| cell).unwrap_or_default());
            queue.extend(head.map(|(key, _)| Reverse((key, run))));
        }
        let mut current: Option<(Key, Cell)> = None;
        while let Some(Reverse((key, run))) = queue.pop() {
            let (Some(reader), Some(head)) = (readers.get_mut(run), heads.get_mut(run)) else { continue };
            let cell = *head;
            match &mut current {
                Some((same, sum)) if *same == key => sum.join(&cell),
                _ => {
                    if let Some((done, sum)) = current.replace((key, cell)) {
                        visit(&done, &sum)?;
                    }
                }
            }
            if let Some((key, cell)) = reader.next(file, folder)? {
                *head = cell;
                queue.push(Reverse((key, run)));
            }
        }
        current.map_or(Ok(()), |(key, sum)| visit(&key, &sum))
    }
}
