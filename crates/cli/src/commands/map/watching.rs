//! Shows a mapping job on the terminal.

use std::time::Instant;

use portolan::job::{CloudResults, Event, Finished, Job};
use portolan_recording::Recording;

use super::words::{describe, summary};
use super::{cloud, remarks};
use crate::GlobalArgs;
use crate::error::CliError;
use crate::interrupt::Saving;
use crate::output::print_summary;
use crate::progress::Progress;

/// Runs the job with a progress bar, writes the results and prints their paths.
pub fn run_job(job: &Job, recording: &dyn Recording, global: &GlobalArgs) -> Result<Finished, CliError> {
    let mut watch = Watch { global, size_bytes: recording.size_bytes(), stage: Stage::Loading };
    let mut observe = remarks(global);
    let finished = job.run(&mut |event| {
        watch.see(event);
        observe(event)
    });
    watch.enter(Stage::Loading);
    Ok(finished?)
}

/// Stage of the job, with its progress bar.
enum Stage {
    /// Known maps are loaded, or the job is between two stages.
    Loading,
    /// Mapping, then writing the results: the first interruption saves partial results.
    Mapping { bar: Option<Progress>, start: Instant, _saving: Saving },
    /// The recording is read again, to transform its raw points by the final trajectory.
    PlacingPoints { bar: Progress },
}

struct Watch<'a> {
    global: &'a GlobalArgs,
    size_bytes: u64,
    stage: Stage,
}

impl Watch<'_> {
    fn see(&mut self, event: &Event) {
        match event {
            Event::Mapping(state) => {
                if !matches!(self.stage, Stage::Mapping { .. }) {
                    let bar = Some(Progress::start("mapping", self.size_bytes, self.global.quiet));
                    self.enter(Stage::Mapping { bar, start: Instant::now(), _saving: Saving::begin() });
                }
                if let Stage::Mapping { bar: Some(bar), start, .. } = &mut self.stage
                    && bar.is_due()
                {
                    bar.update(state.position_bytes, state.total_bytes, describe(state, *start));
                }
            }
            Event::Drawing => {
                if let Stage::Mapping { bar, .. } = &mut self.stage {
                    bar.take().into_iter().for_each(Progress::finish);
                }
            }
            Event::Written { summary: mapped, files, seconds } => {
                self.enter(Stage::Loading);
                print_summary(&summary(mapped, files, *seconds, self.global.verbose > 0));
            }
            Event::PlacingPoints { position_bytes, total_bytes } => {
                if !matches!(self.stage, Stage::PlacingPoints { .. }) {
                    let bar = Progress::start("placing points", self.size_bytes, self.global.quiet);
                    self.enter(Stage::PlacingPoints { bar });
                }
                if let Stage::PlacingPoints { bar, .. } = &mut self.stage
                    && bar.is_due()
                {
                    bar.update(*position_bytes, *total_bytes, String::new());
                }
            }
            Event::PointsPlaced => self.enter(Stage::Loading),
            Event::CloudsWritten(clouds) => name_clouds(clouds),
            _ => {}
        }
    }

    /// Enters another stage; removes the bar of the previous one.
    fn enter(&mut self, stage: Stage) {
        match std::mem::replace(&mut self.stage, stage) {
            Stage::Mapping { bar: Some(bar), .. } | Stage::PlacingPoints { bar } => bar.finish(),
            Stage::Mapping { bar: None, .. } | Stage::Loading => {}
        }
    }
}

/// Prints the summary of the cloud and the paths of the files of the second pass.
fn name_clouds(clouds: &CloudResults) {
    let text = clouds.cloud.as_ref().map(|(points, of)| cloud::summary(*points, of));
    let files = clouds.files.iter().map(|file| file.display().to_string());
    let lines: Vec<String> = text.into_iter().chain(files).filter(|line| !line.is_empty()).collect();
    if !lines.is_empty() {
        print_summary(&lines.join("\n"));
    }
}
