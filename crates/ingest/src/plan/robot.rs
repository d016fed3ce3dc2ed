//! Determines which sensors are on one robot, and which frame is the robot's: recordings may hold several
//! robots.

use portolan_geometry::Dimension;

use crate::tf::TfTree;

/// Conventional names of robot frames, best first.
const BASE_FRAMES: [&str; 6] = ["base_link", "base_footprint", "base", "base_frame", "robot_base", "chassis"];

/// Frames named like those of robots, also as `robot/base_link`, the best first.
pub(super) fn base_frames(tree: &TfTree) -> impl Iterator<Item = &str> {
    let named = |base: &'static str| tree.frames().filter(move |f| f.rsplit('/').next() == Some(base));
    BASE_FRAMES.into_iter().flat_map(named)
}

/// The frame whose z axis points up, if known: that of the robot which carries a sensor, otherwise, in 2D,
/// that of a planar scanner on the same robot. None in 3D without a robot: a handheld sensor may be tilted.
pub fn upright_frame<'a>(
    tree: &'a TfTree,
    frame: &str,
    scanners: impl IntoIterator<Item = &'a str>,
    dimension: Dimension,
) -> Option<&'a str> {
    let beside = |other: &&str| are_on_one_robot(tree, other, frame);
    let scanner = || scanners.into_iter().filter(|_| dimension == Dimension::TwoD).find(beside);
    base_frames(tree).find(beside).or_else(scanner)
}

/// Whether transforms connect two frames without a frame that is fixed in the world while robots move.
pub(super) fn are_on_one_robot(tree: &TfTree, a: &str, b: &str) -> bool {
    tree.connected(a, b) && tree.fixed_frame_between(a, b).is_none()
}

/// Why two frames cannot be used together; none if both are on one robot.
pub(super) fn reason_apart(tree: &TfTree, frame: &str, other: &str) -> Option<String> {
    if !tree.connected(frame, other) {
        return Some(format!("no transforms connect its frame \"{frame}\" with \"{other}\""));
    }
    let fixed = tree.fixed_frame_between(frame, other)?;
    Some(format!(
        "transforms connect its frame \"{frame}\" with \"{other}\" only by \"{fixed}\": it is on another robot"
    ))
}

/// Number of leading name parts that two topics share: topics of one robot may all begin with its name.
pub(super) fn shared_parts(a: &str, b: &str) -> usize {
    a.split('/').zip(b.split('/')).take_while(|(a, b)| a == b).count()
}
