//! The pipeline of Cartographer's assets writer: stages that filter, colour and write the points of a
//! recording, batch by batch (`tools.md` §3). Files are equal to Cartographer's byte for byte.

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

/// Next step after all points have been processed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flush {
    /// Process all points once more.
    Restart,
    /// None: files are written.
    Finished,
}

/// Receives lines of the log.
pub type Log<'a> = &'a mut dyn FnMut(&str);

/// A stage of the pipeline.
pub(crate) trait Stage: Send {
    /// Changes a batch; false withholds it from later stages.
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError>;

    /// Whether the stage needs all points once more. Called at the end of each pass, before later stages are
    /// asked.
    fn needs_another_pass(&mut self, _log: Log) -> bool {
        false
    }

    /// Ends the pass with its outcome, after later stages have ended it.
    fn end_pass(&mut self, flush: Flush, log: Log) -> Result<(), PointsError>;
}

/// Input of stages besides their options.
#[derive(Clone, Debug, Default)]
pub struct PipelineContext {
    /// Prefix of all file names.
    pub file_prefix: String,
    /// Poses of the tracking frame for each trajectory, in order of time; they are drawn into pictures.
    pub trajectories: Vec<Vec<(Time, Rigid3)>>,
    /// Frame of these poses and of all points, which have single precision; files have positions in the map.
    pub frame: NearFrame,
}

impl PipelineContext {
    fn file(&self, name: &str) -> PathBuf {
        PathBuf::from(format!("{}{name}", self.file_prefix))
    }
}

/// A sequence of stages.
pub struct Pipeline {
    stages: Vec<Box<dyn Stage>>,
}

impl Pipeline {
    /// Sends points through the stages.
    ///
    /// # Errors
    /// If a file cannot be written, or if colours or intensities are missing in some batches.
    pub fn process(&mut self, mut batch: PointsBatch) -> Result<(), PointsError> {
        for stage in &mut self.stages {
            if !stage.process(&mut batch)? {
                break;
            }
        }
        Ok(())
    }

    /// To be called after all points; with [`Flush::Restart`] all points must be processed again.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn flush(&mut self, log: Log) -> Result<Flush, PointsError> {
        flush(&mut self.stages, log)
    }
}

fn flush(stages: &mut [Box<dyn Stage>], log: Log) -> Result<Flush, PointsError> {
    let Some((first, later)) = stages.split_first_mut() else { return Ok(Flush::Finished) };
    if first.needs_another_pass(log) {
        return Ok(Flush::Restart);
    }
    let outcome = flush(later, log)?;
    first.end_pass(outcome, log)?;
    Ok(outcome)
}

#[cfg(test)]
mod tests;
