//! A tree of transforms: static and moving frames, and lookups between any two of them.

mod input;
mod text;

use std::collections::BTreeMap;
use std::sync::Arc;

pub use input::{TfInput, frame_name};
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, TransformBuffer};
use portolan_issue::{Issue, IssueKind};

/// Maximum number of poses that are kept of one moving frame.
const BUFFER_POSES: usize = 100_000;
/// Difference below which two poses are the same (metres, radians).
const SAME_PLACE: f64 = 1e-9;
/// Number of steps over the known time span at which poses of moving frames are looked up.
const LOOKED_UP_OFTEN: i32 = 64;
/// Maximum number of frames of a tree; only damaged recordings have more.
const MAX_FRAMES: usize = 5000;

/// Words in the names of world-fixed frames, which move against every sensor, by convention of mapping
/// programs.
const WORDS_OF_FIXED_FRAMES: [&str; 5] = ["map", "odom", "world", "earth", "global"];
/// A name of such a frame without any of them.
const CAMERA_INIT: &str = "camera_init";

/// Whether a frame has the name of a world-fixed frame. Robots put their name before it.
pub fn is_fixed_frame(frame: &str) -> bool {
    let name = frame.rsplit('/').next().unwrap_or(frame);
    name == CAMERA_INIT || name.split('_').any(|word| WORDS_OF_FIXED_FRAMES.contains(&word))
}

/// Reasons why a transform is unknown, or was not inserted into the tree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TfError {
    /// A frame that no transform names.
    #[error(
        "frame \"{frame}\" is not in the transform tree, which has {known}; give its place with a URDF, or choose another frame"
    )]
    UnknownFrame {
        /// The frame.
        frame: String,
        /// The known frames.
        known: String,
    },
    /// Two frames in different trees.
    #[error(
        "no transforms connect \"{target}\" (below \"{target_root}\") with \"{origin}\" (below \"{origin_root}\"); give the missing one with a URDF"
    )]
    NotConnected {
        /// Requested target frame.
        target: String,
        /// Requested source frame.
        origin: String,
        /// Root of the tree of the target.
        target_root: String,
        /// Root of the tree of the source.
        origin_root: String,
    },
    /// A moving frame whose pose is not known at that time.
    #[error("the pose of \"{child}\" in \"{parent}\" is known {span} but not at {time}")]
    NotAtThisTime {
        /// The moving frame.
        child: String,
        /// Its parent.
        parent: String,
        /// Requested time.
        time: Time,
        /// "from … to …" or "nowhere".
        span: String,
    },
    /// A transform that would close a loop.
    #[error("{}", transform_loop(frames))]
    Loop {
        /// The frames from parent to child.
        frames: String,
    },
    /// More frames than any robot has.
    #[error("{}", too_many_frames(frame))]
    TooManyFrames {
        /// The frame that was one too many.
        frame: String,
    },
    /// A frame that would get a second parent.
    #[error("{}", second_parent(child, parent, second))]
    SecondParent {
        /// The frame.
        child: String,
        /// The parent it keeps.
        parent: String,
        /// The parent that was refused.
        second: String,
    },
}

fn transform_loop(frames: &str) -> Issue {
    Issue::new(IssueKind::TransformLoop).with("frames", frames)
}

fn too_many_frames(frame: &str) -> Issue {
    Issue::new(IssueKind::TooManyFrames).with_number("most", MAX_FRAMES).with("frame", frame)
}

fn second_parent(child: &str, parent: &str, second: &str) -> Issue {
    let issue = Issue::new(IssueKind::SecondParent).with("child", child);
    issue.with("parent", parent).with("second", second)
}

impl TfError {
    /// The error as an issue, where a transform could not be inserted.
    pub fn issue(&self) -> Issue {
        match self {
            Self::Loop { frames } => transform_loop(frames),
            Self::TooManyFrames { frame } => too_many_frames(frame),
            Self::SecondParent { child, parent, second } => second_parent(child, parent, second),
            error => Issue::new(IssueKind::UnknownFrame).with("error", error),
        }
    }
}

#[derive(Clone, Debug)]
enum Motion {
    /// `parent_from_child`.
    Static(Rigid3),
    Moving(Moving),
}

/// Poses of a frame that is sent repeatedly.
#[derive(Clone, Debug)]
struct Moving {
    buffer: TransformBuffer,
    /// The pose, as long as it was always the same: fixed frames are often sent like moving ones.
    unchanged: Option<Rigid3>,
}

impl Moving {
    fn push(&mut self, time: Time, parent_from_child: Rigid3) {
        let is_first = self.buffer.is_empty();
        let same = |pose: &Rigid3| {
            let difference = pose.inverse() * parent_from_child;
            difference.translation.vector.norm() < SAME_PLACE && difference.rotation.angle() < SAME_PLACE
        };
        self.unchanged =
            if is_first { Some(parent_from_child) } else { self.unchanged.filter(|pose| same(pose)) };
        self.buffer.push(time, parent_from_child);
    }

    /// Interpolated pose; a frame that never moved has the same pose at any time.
    fn lookup(&self, time: Time) -> Option<Rigid3> {
        self.buffer.lookup(time).or(self.unchanged)
    }
}

#[derive(Clone, Debug)]
struct Edge {
    parent: usize,
    motion: Motion,
}

#[derive(Clone, Debug)]
struct Frame {
    name: Arc<str>,
    edge: Option<Edge>,
}

/// Frames and their poses. Every frame has at most one parent.
#[derive(Clone, Debug, Default)]
pub struct TfTree {
    frames: Vec<Frame>,
    index: BTreeMap<Arc<str>, usize>,
}

impl TfTree {
    /// A tree without frames.
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether any transform names the frame.
    pub fn has_frame(&self, name: &str) -> bool {
        self.index.contains_key(name)
    }

    /// All frames in ascending order.
    pub fn frames(&self) -> impl Iterator<Item = &str> {
        self.index.keys().map(|name| &**name)
    }

    /// Sets the pose of `child` in `parent` for all times. An existing pose stays: the first one counts.
    ///
    /// # Errors
    /// If the frame has another parent already, if the frames would form a loop, or if there are too many.
    pub fn insert_static(
        &mut self,
        parent: &str,
        child: &str,
        parent_from_child: Rigid3,
    ) -> Result<(), TfError> {
        let (parent, child) = self.edge_ends(parent, child)?;
        if let Some(frame) = self.frames.get_mut(child) {
            let motion = Motion::Static(parent_from_child);
            frame.edge.get_or_insert(Edge { parent, motion });
        }
        Ok(())
    }

    /// Sets the pose of `child` in `parent` at one time. A static frame stays unchanged.
    ///
    /// # Errors
    /// As for [`Self::insert_static`].
    pub fn insert_moving(
        &mut self,
        parent: &str,
        child: &str,
        time: Time,
        parent_from_child: Rigid3,
    ) -> Result<(), TfError> {
        let (parent, child) = self.edge_ends(parent, child)?;
        let Some(frame) = self.frames.get_mut(child) else { return Ok(()) };
        let edge = frame.edge.get_or_insert_with(|| {
            let buffer = TransformBuffer::with_size_limit(BUFFER_POSES);
            Edge { parent, motion: Motion::Moving(Moving { buffer, unchanged: None }) }
        });
        if let Motion::Moving(moving) = &mut edge.motion {
            moving.push(time, parent_from_child);
        }
        Ok(())
    }

    fn edge_ends(&mut self, parent: &str, child: &str) -> Result<(usize, usize), TfError> {
        let (parent, child) = (self.frame(parent)?, self.frame(child)?);
        match self.edge(child) {
            Some(edge) if edge.parent == parent => {}
            Some(edge) => {
                return Err(TfError::SecondParent {
                    child: self.name(child).to_owned(),
                    parent: self.name(edge.parent).to_owned(),
                    second: self.name(parent).to_owned(),
                });
            }
            None => {
                let mut path = self.path_to_root(parent);
                if let Some(position) = path.iter().position(|frame| *frame == child) {
                    path.truncate(position + 1);
                    let mut names: Vec<&str> = path.iter().rev().map(|f| self.name(*f)).collect();
                    names.push(self.name(child));
                    return Err(TfError::Loop { frames: names.join(" → ") });
                }
            }
        }
        Ok((parent, child))
    }

    fn frame(&mut self, name: &str) -> Result<usize, TfError> {
        if let Some(index) = self.index.get(name) {
            return Ok(*index);
        }
        if self.frames.len() >= MAX_FRAMES {
            return Err(TfError::TooManyFrames { frame: name.to_owned() });
        }
        let name: Arc<str> = name.into();
        self.frames.push(Frame { name: name.clone(), edge: None });
        self.index.insert(name, self.frames.len() - 1);
        Ok(self.frames.len() - 1)
    }

    /// Empty if there is no such frame.
    fn name(&self, frame: usize) -> &str {
        self.frames.get(frame).map_or("", |frame| &frame.name)
    }

    /// The edge from a frame to its parent; none for a root.
    fn edge(&self, frame: usize) -> Option<&Edge> {
        self.frames.get(frame)?.edge.as_ref()
    }

    /// The frame itself, its parent and so on. Ends because insertion refuses loops.
    fn path_to_root(&self, mut frame: usize) -> Vec<usize> {
        let mut path = vec![frame];
        while let Some(edge) = self.edge(frame) {
            frame = edge.parent;
            path.push(frame);
        }
        path
    }

    fn known(&self, name: &str) -> Result<usize, TfError> {
        self.index.get(name).copied().ok_or_else(|| TfError::UnknownFrame {
            frame: name.to_owned(),
            known: if self.index.is_empty() {
                "no frames".to_owned()
            } else {
                self.frames().take(30).collect::<Vec<_>>().join(", ")
            },
        })
    }

    /// The paths from both frames up to, and not including, their common ancestor.
    fn paths(&self, target: &str, source: &str) -> Result<(Vec<usize>, Vec<usize>), TfError> {
        let mut up = self.path_to_root(self.known(target)?);
        let mut down = self.path_to_root(self.known(source)?);
        let roots = (up.last().copied(), down.last().copied());
        if let ((Some(target_root), Some(source_root)), true) = (roots, roots.0 != roots.1) {
            return Err(TfError::NotConnected {
                target: target.to_owned(),
                origin: source.to_owned(),
                target_root: self.name(target_root).to_owned(),
                origin_root: self.name(source_root).to_owned(),
            });
        }
        while let (Some(a), Some(b)) = (up.last(), down.last())
            && a == b
        {
            up.pop();
            down.pop();
        }
        Ok((up, down))
    }

    /// `target_from_source` at `time`: transforms coordinates in `source` to coordinates in `target`. Moving
    /// frames are interpolated; times outside of the known span are an error, unless the frame has never
    /// moved so far.
    ///
    /// # Errors
    /// If a frame is not known, the two are not connected, or one that moves is not known at this time.
    pub fn lookup(&self, target: &str, source: &str, time: Time) -> Result<Rigid3, TfError> {
        if target == source {
            return Ok(Rigid3::identity());
        }
        let (up, down) = self.paths(target, source)?;
        let ancestor_from_target = self.compose(&up, time)?;
        let ancestor_from_source = self.compose(&down, time)?;
        let mut result = ancestor_from_target.inverse() * ancestor_from_source;
        result.rotation = Quaternion::new_normalize(*result.rotation.quaternion());
        Ok(result)
    }

    /// `ancestor_from_frame` along a path of edges that begins at the frame.
    fn compose(&self, path: &[usize], time: Time) -> Result<Rigid3, TfError> {
        let mut result = Rigid3::identity();
        for frame in path {
            let Some(edge) = self.edge(*frame) else { continue };
            let parent_from_frame = match &edge.motion {
                Motion::Static(transform) => *transform,
                Motion::Moving(moving) => moving.lookup(time).ok_or_else(|| TfError::NotAtThisTime {
                    child: self.name(*frame).to_owned(),
                    parent: self.name(edge.parent).to_owned(),
                    time,
                    span: match (moving.buffer.earliest_time(), moving.buffer.latest_time()) {
                        (Some(first), Some(last)) => format!("from {first} to {last}"),
                        _ => "nowhere".to_owned(),
                    },
                })?,
            };
            result = parent_from_frame * result;
        }
        Ok(result)
    }

    /// Whether two frames belong to one tree, moving or not.
    pub fn connected(&self, a: &str, b: &str) -> bool {
        a == b || self.paths(a, b).is_ok()
    }

    /// A world-fixed frame between two frames of one tree, the first from `a`. None where no frame moves
    /// between the two: then they are rigidly connected.
    pub fn fixed_frame_between(&self, a: &str, b: &str) -> Option<&str> {
        let (up, down) = self.paths(a, b).ok()?;
        if self.lookup_static(a, b).is_some() {
            return None;
        }
        let ancestor = match up.last() {
            Some(top) => self.edge(*top).map(|edge| edge.parent),
            None => self.index.get(a).copied(),
        };
        let mut path = up.iter().copied().chain(ancestor).chain(down.iter().rev().copied());
        let name = |frame: usize| self.name(frame);
        path.find(|frame| ![a, b].contains(&name(*frame)) && is_fixed_frame(name(*frame))).map(name)
    }

    /// `target_from_source` if there is no moving frame between the two.
    pub fn lookup_static(&self, target: &str, source: &str) -> Option<Rigid3> {
        if target == source {
            return Some(Rigid3::identity());
        }
        let (up, down) = self.paths(target, source).ok()?;
        let fixed = |path: &[usize]| {
            path.iter().all(|f| !matches!(self.edge(*f), Some(Edge { motion: Motion::Moving(_), .. })))
        };
        (fixed(&up) && fixed(&down)).then(|| self.lookup(target, source, Time::MIN).ok()).flatten()
    }

    /// `target_from_source` at times that are spread evenly over the known span of moving frames between the
    /// two; once if there is none between them.
    pub fn lookup_often(&self, target: &str, source: &str) -> Vec<Rigid3> {
        let Ok((up, down)) = self.paths(target, source) else { return Vec::new() };
        let buffers = up.iter().chain(&down).filter_map(|frame| match &self.edge(*frame)?.motion {
            Motion::Moving(moving) => Some(&moving.buffer),
            Motion::Static(_) => None,
        });
        let (mut first, mut last) = (Time::MIN, Time::MAX);
        for buffer in buffers {
            first = first.max(buffer.earliest_time().unwrap_or(Time::MAX));
            last = last.min(buffer.latest_time().unwrap_or(Time::MIN));
        }
        if (first, last) == (Time::MIN, Time::MAX) {
            return self.lookup(target, source, Time::MIN).into_iter().collect();
        }
        let span = last.seconds_since(first);
        let at = |i: i32| first + Duration::from_seconds(span * f64::from(i) / f64::from(LOOKED_UP_OFTEN));
        let times = (0..=LOOKED_UP_OFTEN).map(at).filter(|_| span >= 0.0);
        times.filter_map(|time| self.lookup(target, source, time).ok()).collect()
    }

    /// Moving frames as (parent, child), in ascending order of the child.
    pub fn moving_frames(&self) -> Vec<(&str, &str)> {
        let moving = |index: &usize| match self.edge(*index) {
            Some(Edge { parent, motion: Motion::Moving(_) }) => Some((self.name(*parent), self.name(*index))),
            _ => None,
        };
        self.index.values().filter_map(moving).collect()
    }

    /// Mean interval between the known poses of a moving frame, seconds.
    pub fn moving_interval(&self, child: &str) -> Option<f64> {
        let edge = self.edge(*self.index.get(child)?);
        let Some(Edge { motion: Motion::Moving(Moving { buffer, .. }), .. }) = edge else { return None };
        let span = buffer.latest_time()?.seconds_since(buffer.earliest_time()?);
        (span > 0.0).then(|| span / (buffer.len() - 1) as f64)
    }

    /// Forgets poses of moving frames before `time`, except the last one before it.
    pub fn forget_before(&mut self, time: Time) {
        for frame in &mut self.frames {
            if let Some(Edge { motion: Motion::Moving(moving), .. }) = &mut frame.edge {
                moving.buffer.forget_before(time);
            }
        }
    }
}

#[cfg(test)]
mod tests;
