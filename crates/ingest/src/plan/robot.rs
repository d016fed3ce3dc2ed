//! Which sensors are on one robot: recordings may hold several.

use crate::tf::TfTree;

/// Whether transforms join two frames, and not through a frame that stays where it is while robots move.
pub(super) fn are_on_one_robot(tree: &TfTree, a: &str, b: &str) -> bool {
    tree.connected(a, b) && tree.fixed_frame_between(a, b).is_none()
}

/// Why two frames cannot be used together; none if both are on one robot.
pub(super) fn why_apart(tree: &TfTree, frame: &str, other: &str) -> Option<String> {
    if !tree.connected(frame, other) {
        return Some(format!("no transforms connect its frame \"{frame}\" with \"{other}\""));
    }
    let fixed = tree.fixed_frame_between(frame, other)?;
    Some(format!(
        "transforms connect its frame \"{frame}\" with \"{other}\" only by \"{fixed}\": it is on another robot"
    ))
}

/// How many parts the names of two topics begin with that are the same: those of one robot may all begin with its name.
pub(super) fn shared_parts(a: &str, b: &str) -> usize {
    a.split('/').zip(b.split('/')).take_while(|(a, b)| a == b).count()
}
