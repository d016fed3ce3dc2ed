//! `cartographer_dev_pbstream_trajectories_to_rosbag`: writes the nodes of a map as transforms to a bag.

use std::sync::Arc;

use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan_geometry::Rigid3;
use portolan_recording::{
    BagCompression, Header, Message, Pose, RecordedMessage, RecordingFormat, TfMessage, TransformStamped,
    create,
};

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console};

/// Writes each node twice: on a topic of its trajectory, and on `/tf`.
///
/// # Errors
/// If flags are wrong, the map cannot be read, or the bag cannot be written.
pub fn pbstream_trajectories_to_rosbag(
    arguments: &[String],
    console: &mut dyn Console,
) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[("input", ""), ("output", ""), ("parent_frame", "map")],
            switches: &[],
            usage: "usage: cartographer_dev_pbstream_trajectories_to_rosbag -input MAP -output BAG \
                    [-parent_frame map]",
        },
    )?;
    let (input, output) = (flags.path("input")?, flags.path("output")?);
    let parent: Arc<str> = flags.value("parent_frame").into();
    let graph = read_pose_graph(&input)?;
    // A path with an unknown ending becomes a ROS 1 bag, as in Cartographer.
    let format = RecordingFormat::from_path(&output);
    let format = format.unwrap_or(RecordingFormat::Ros1Bag(BagCompression::default()));
    let mut bag = create(&output, Some(format))?;
    for trajectory in &graph.trajectory {
        let child: Arc<str> = format!("trajectory_{}", trajectory.trajectory_id).into();
        let nodes = nodes(&input, &graph, trajectory.trajectory_id)?;
        console.info(&format!("Writing {} poses of {child}.", nodes.len()));
        for node in nodes {
            let transform = TransformStamped {
                header: Header { stamp: node.time, frame_id: parent.clone() },
                child_frame_id: child.clone(),
                transform: pose(&node.map_from_tracking),
            };
            let write = |topic: Arc<str>, message| RecordedMessage { topic, log_time: node.time, message };
            bag.write(&write(child.clone(), Message::TransformStamped(transform.clone())))?;
            let tf = TfMessage { is_static: false, transforms: vec![transform] };
            bag.write(&write("/tf".into(), Message::Tf(tf)))?;
        }
    }
    bag.finish()?;
    Ok(Completeness::Complete)
}

fn pose(map_from_tracking: &Rigid3) -> Pose {
    let (t, q) = (map_from_tracking.translation, map_from_tracking.rotation.quaternion());
    Pose { position: [t.x, t.y, t.z], orientation_xyzw: [q.i, q.j, q.k, q.w] }
}
