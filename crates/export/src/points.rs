//! The pipeline of Cartographer's assets writer: stages through which the points of a recording go, batch
//! by batch, to be filtered, coloured and written (`tools.md` §3). Files come out byte for byte as there.

mod batch;
mod clouds;
mod colours;
mod error;
mod filters;
mod floors;
mod from_lua;
mod grid_files;
mod moving;
mod trajectories;
mod xray;

use std::path::PathBuf;

use portolan_geometry::{NearFrame, Rigid3, Time};

pub use batch::PointsBatch;
pub use error::PointsError;
pub use floors::{Floor, detect_floors};
pub use from_lua::{pipeline_from_lua, table_of};

/// What is to be done after all points went through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flush {
    /// All points once more.
    Restart,
    /// Nothing: files are written.
    Finished,
}

/// Where lines of the log go.
pub type Log<'a> = &'a mut dyn FnMut(&str);

/// One thing that is done with points.
pub(crate) trait Stage: Send {
    /// Changes a batch; false keeps it from later stages.
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError>;

    /// Whether all points are wanted once more. Asked at the end of each pass, before later stages learn of it.
    fn wants_another_pass(&mut self, _log: Log) -> bool {
        false
    }

    /// How the pass ended, after later stages have learnt of it.
    fn end_pass(&mut self, flush: Flush, log: Log) -> Result<(), PointsError>;
}

/// What stages need to know besides their options.
#[derive(Clone, Debug, Default)]
pub struct PipelineContext {
    /// Put before all names of files.
    pub file_prefix: String,
    /// Poses of the tracking frame, for each trajectory, in order of time: drawn into pictures.
    pub trajectories: Vec<Vec<(Time, Rigid3)>>,
    /// The frame of these poses and of all points, which have single precision; files hold places in the map.
    pub frame: NearFrame,
}

impl PipelineContext {
    fn file(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("{}{name}", self.file_prefix))
    }
}

/// Stages in their order.
pub struct Pipeline {
    stages: Vec<Box<dyn Stage>>,
}

impl Pipeline {
    /// Sends points through.
    ///
    /// # Errors
    /// If a file cannot be written, or colours and intensities of batches do not belong together.
    pub fn process(&mut self, mut batch: PointsBatch) -> Result<(), PointsError> {
        for stage in &mut self.stages {
            if !stage.process(&mut batch)? {
                break;
            }
        }
        Ok(())
    }

    /// To be called after all points; if the answer is to restart, all points are to come again.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn flush(&mut self, log: Log) -> Result<Flush, PointsError> {
        flush(&mut self.stages, log)
    }
}

fn flush(stages: &mut [Box<dyn Stage>], log: Log) -> Result<Flush, PointsError> {
    let Some((first, later)) = stages.split_first_mut() else { return Ok(Flush::Finished) };
    if first.wants_another_pass(log) {
        return Ok(Flush::Restart);
    }
    let outcome = flush(later, log)?;
    first.end_pass(outcome, log)?;
    Ok(outcome)
}

#[cfg(test)]
mod tests;
