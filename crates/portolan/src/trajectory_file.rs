//! Reads trajectories from files of any format, distinguished by content.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use portolan_evaluation::{
    TimedPose, Trajectory, TrajectoryRepairs, kitti_trajectory, read_csv, read_kitti_poses, read_kitti_times,
    read_tum,
};
use portolan_geometry::Time;
use portolan_input::{Forward, unwanted_kind_of};
use portolan_pbstream::proto::mapping::{self, PoseGraph};
use portolan_pbstream::{MAGIC, MapReader, ReadLimits, pose_from_proto};

/// Reasons why no trajectory can be read from a file.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryFileError {
    /// It cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Its content cannot be used.
    #[error("{}: {reason}", path.display())]
    Content {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl TrajectoryFileError {
    fn in_file(path: &Path, reason: impl Display) -> Self {
        Self::Content { path: path.to_owned(), reason: reason.to_string() }
    }

    fn file(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        |source| Self::File { path: path.to_owned(), source }
    }
}

/// Number of bytes at the start of a text from which its format is determined: more than any comments there.
const HEAD: usize = 1 << 16;
/// Seconds between the scans of KITTI recordings.
const KITTI_PERIOD: f64 = 0.1;

/// A file with a trajectory.
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryFile<'a> {
    /// The file: a map, TUM, KITTI poses, or a table with a line of names.
    pub path: &'a Path,
    /// Which trajectory of a map. None takes all of them if they follow one another, as the pieces of one
    /// recording do, otherwise the one with the lowest number.
    pub trajectory_id: Option<i32>,
    /// Times of KITTI poses, one a line.
    pub times: Option<&'a Path>,
}

/// A trajectory that was read.
#[derive(Clone, Debug)]
pub struct ReadTrajectory {
    /// It has at least one pose.
    pub trajectory: Trajectory,
    /// Repairs and assumptions, in words.
    pub notes: Vec<String>,
}

impl TrajectoryFile<'_> {
    /// Reads the trajectory.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or has no trajectory with poses.
    pub fn read(&self) -> Result<ReadTrajectory, TrajectoryFileError> {
        self.read_from(open_forward(self.path)?)
    }

    /// Reads the trajectory from an opened input.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_from(&self, mut input: Forward) -> Result<ReadTrajectory, TrajectoryFileError> {
        let mut notes = Vec::new();
        let (trajectory, repairs) = if peek(&mut input, self.path, MAGIC.len())? == MAGIC {
            let (pose_graph, damage) = whole_pose_graph_from(input, self.path)?;
            notes.extend(damage.map(|damage| damaged_behind_poses(&damage)));
            Trajectory::new(match self.trajectory_id {
                Some(id) => nodes(self.path, &pose_graph, id)?,
                None => nodes_of_pieces(self.path, &pose_graph, &mut notes)?,
            })
        } else {
            self.read_text(input, &mut notes)?
        };
        if trajectory.is_empty() {
            return Err(TrajectoryFileError::in_file(self.path, "the trajectory has no poses"));
        }
        notes.extend(repairs.notes());
        Ok(ReadTrajectory { trajectory, notes })
    }

    fn read_text(
        &self,
        mut input: Forward,
        notes: &mut Vec<String>,
    ) -> Result<(Trajectory, TrajectoryRepairs), TrajectoryFileError> {
        if let Some(kind) = unwanted_kind_of(peek(&mut input, self.path, 16)?) {
            return Err(TrajectoryFileError::in_file(self.path, format!("this is {kind}")));
        }
        let read = match text_format(peek(&mut input, self.path, HEAD)?) {
            TextFormat::Tum => read_tum(input),
            TextFormat::Csv => read_csv(input),
            TextFormat::Kitti => {
                let poses = read_kitti_poses(input)
                    .map_err(|error| TrajectoryFileError::in_file(self.path, error))?;
                kitti_trajectory(&poses, &self.kitti_times(poses.len(), notes)?)
            }
        };
        read.map_err(|error| TrajectoryFileError::in_file(self.path, error))
    }

    fn kitti_times(&self, count: usize, notes: &mut Vec<String>) -> Result<Vec<Time>, TrajectoryFileError> {
        if let Some(path) = self.times {
            return read_kitti_times(open_forward(path)?)
                .map_err(|error| TrajectoryFileError::in_file(path, error));
        }
        notes.push(format!(
            "KITTI poses without times; taken as {KITTI_PERIOD} s apart from time 0 (give times.txt with --times)"
        ));
        Ok((0..count).map(|i| Time::from_unix_seconds(i as f64 * KITTI_PERIOD)).collect())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TextFormat {
    Tum,
    Kitti,
    Csv,
}

/// Determines the format from the first line that is not a comment: twelve numbers are a KITTI pose; commas
/// separate the columns of a table, whose line of names may begin like a comment.
fn text_format(text: &[u8]) -> TextFormat {
    let mut lines = text.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
    match lines.find(|line| !line.starts_with(b"#")) {
        Some(line) if line.contains(&b',') => TextFormat::Csv,
        Some(line) if line.split(u8::is_ascii_whitespace).filter(|f| !f.is_empty()).count() == 12 => {
            TextFormat::Kitti
        }
        _ => TextFormat::Tum,
    }
}

fn open_forward(path: &Path) -> Result<Forward, TrajectoryFileError> {
    Forward::open(path).map_err(TrajectoryFileError::file(path))
}

fn peek<'a>(input: &'a mut Forward, path: &Path, count: usize) -> Result<&'a [u8], TrajectoryFileError> {
    input.peek(count).map_err(TrajectoryFileError::file(path))
}

/// The pose graph of a map.
///
/// # Errors
/// Fails if the file is no map.
pub fn read_pose_graph(path: &Path) -> Result<PoseGraph, TrajectoryFileError> {
    pose_graph_from(open_forward(path)?, path)
}

/// The pose graph of a map that is opened; `path` is named in errors.
///
/// # Errors
/// As [`read_pose_graph`].
pub fn pose_graph_from(input: Forward, path: &Path) -> Result<PoseGraph, TrajectoryFileError> {
    let length = input.length();
    let reader = MapReader::from_source(input, length, ReadLimits::default());
    Ok(reader.map_err(|error| TrajectoryFileError::in_file(path, error))?.take_pose_graph())
}

/// The pose graph of a map, and the damage of the data after it, which are read to their end.
///
/// # Errors
/// As [`read_pose_graph`].
pub fn whole_pose_graph_from(
    input: Forward,
    path: &Path,
) -> Result<(PoseGraph, Option<String>), TrajectoryFileError> {
    let length = input.length();
    let reader = MapReader::from_source_for_summary(input, length, ReadLimits::default());
    let mut reader = reader.map_err(|error| TrajectoryFileError::in_file(path, error))?;
    let graph = reader.take_pose_graph();
    loop {
        match reader.next_message() {
            Ok(Some(_)) => {}
            Ok(None) => return Ok((graph, None)),
            Err(error) => return Ok((graph, Some(error.to_string()))),
        }
    }
}

/// Message for a map whose poses are intact, while the data after them are damaged.
pub fn damaged_behind_poses(damage: &str) -> String {
    format!("damaged after its poses, which are complete: {damage}")
}

/// One trajectory of a map.
///
/// # Errors
/// Fails if the map does not have it.
pub fn trajectory_of<'a>(
    path: &Path,
    pose_graph: &'a PoseGraph,
    id: i32,
) -> Result<&'a mapping::Trajectory, TrajectoryFileError> {
    pose_graph.trajectory.iter().find(|t| t.trajectory_id == id).ok_or_else(|| {
        let ids: Vec<String> = pose_graph.trajectory.iter().map(|t| t.trajectory_id.to_string()).collect();
        TrajectoryFileError::in_file(
            path,
            format!("there is no trajectory {id} in this map; it has: {}", ids.join(", ")),
        )
    })
}

/// The poses of all nodes of a trajectory, in the order of the file.
///
/// # Errors
/// Fails if the map does not have the trajectory, or a pose is invalid.
pub fn nodes(path: &Path, pose_graph: &PoseGraph, id: i32) -> Result<Vec<TimedPose>, TrajectoryFileError> {
    let pose = |node: &mapping::trajectory::Node| {
        let invalid = || {
            let reason = format!("node ({id}, {}) has no valid pose; see `portolan check`", node.node_index);
            TrajectoryFileError::in_file(path, reason)
        };
        let map_from_tracking = pose_from_proto(node.pose.as_ref()).ok_or_else(invalid)?;
        Ok(TimedPose { time: Time::from_ticks(node.timestamp), map_from_tracking })
    };
    trajectory_of(path, pose_graph, id)?.node.iter().map(pose).collect()
}

/// The poses of all trajectories one after the other if none begins before the one before it ended, otherwise
/// those of the trajectory with the lowest number.
fn nodes_of_pieces(
    path: &Path,
    pose_graph: &PoseGraph,
    notes: &mut Vec<String>,
) -> Result<Vec<TimedPose>, TrajectoryFileError> {
    let mut ids: Vec<i32> = pose_graph.trajectory.iter().map(|trajectory| trajectory.trajectory_id).collect();
    ids.sort_unstable();
    let first = ids.first().copied().unwrap_or(0);
    let mut pieces = ids.iter().map(|id| nodes(path, pose_graph, *id)).collect::<Result<Vec<_>, _>>()?;
    pieces.retain(|piece| !piece.is_empty());
    let span = |piece: &[TimedPose]| {
        let times = || piece.iter().map(|pose| pose.time);
        Some((times().min()?, times().max()?))
    };
    pieces.sort_by_key(|piece| span(piece));
    let follow = pieces.is_sorted_by(|before, after| match (span(before), span(after)) {
        (Some((_, end)), Some((begin, _))) => end < begin,
        _ => false,
    });
    if pieces.len() < 2 || !follow {
        return nodes(path, pose_graph, first);
    }
    notes.push(format!("its {} trajectories follow one another and are joined", pieces.len()));
    Ok(pieces.concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Rigid3;
    use portolan_pbstream::pose_to_proto;

    /// A map with trajectories of these numbers, with this many nodes a second apart.
    fn map(trajectories: &[(i32, i64, i64)]) -> PoseGraph {
        let node = |second: i64| mapping::trajectory::Node {
            timestamp: 10_000_000 * second,
            pose: Some(pose_to_proto(&Rigid3::translation(second as f64, 0.0, 0.0))),
            ..Default::default()
        };
        let trajectory = |(id, begin, count): &(i32, i64, i64)| mapping::Trajectory {
            trajectory_id: *id,
            node: (*begin..begin + count).map(node).collect(),
            ..Default::default()
        };
        PoseGraph { trajectory: trajectories.iter().map(trajectory).collect(), ..Default::default() }
    }

    #[test]
    fn pieces_of_one_recording_are_one_trajectory() {
        let seconds = |trajectories: &[(i32, i64, i64)]| {
            let mut notes = Vec::new();
            let nodes = nodes_of_pieces(Path::new("map"), &map(trajectories), &mut notes).unwrap();
            let seconds: Vec<i64> = nodes.iter().map(|n| n.map_from_tracking.translation.x as i64).collect();
            (seconds, notes.len())
        };
        assert_eq!(seconds(&[(0, 10, 2), (3, 20, 3), (1, 0, 2)]), (vec![0, 1, 10, 11, 20, 21, 22], 1));
        // Two recordings of the same time, and one with a piece that has no nodes.
        assert_eq!(seconds(&[(1, 0, 9), (0, 5, 3)]), (vec![5, 6, 7], 0));
        assert_eq!(seconds(&[(0, 0, 3), (1, 7, 0)]), (vec![0, 1, 2], 0));
        assert_eq!(seconds(&[(2, 4, 1)]), (vec![4], 0));
        assert!(nodes_of_pieces(Path::new("map"), &map(&[]), &mut Vec::new()).is_err());
    }

    #[test]
    fn text_formats_are_distinguished() {
        assert_eq!(text_format(b"# time x\n1 2 3 4 0 0 0 1\n"), TextFormat::Tum);
        assert_eq!(text_format(b"\n1 0 0 5 0 1 0 6 0 0 1 7\n"), TextFormat::Kitti);
        assert_eq!(text_format(b"# time,x,y\n1,2,3\n"), TextFormat::Csv);
        assert_eq!(text_format(b""), TextFormat::Tum);
    }
}
