#!/usr/bin/env python3
"""odometry_space.py BAG TRUTH.tum OUT.bag HOW X,Y,Z : odometry from the truth, or a wrong one, for a ROS 1 bag of a 3D lidar.

HOW, joined by +: right, never-moves, turns-alone, centimetres, scale (a fifth too far), small-scale (a tenth too short), stalls
(stands still from 2 to 4 s, then goes on), planar (neither height nor lean, as wheels measure), late and early (stamped by 0.15 s),
to-the-left and backwards (axes of the lidar are said to be others), mirrored, drift (turns by 1 degree per second too far),
wide (turns a fifth too far), slip and heavy-slip (every metre by 3 or 10 % too far or too short, at random, another one each
second), jump (2 m aside at 3 s),
ten-hertz (else 50).
X,Y,Z: where the lidar lies, seen from what the truth follows, metres: /tf_static says so, unless the bag has one already, whose
parent of the lidar is what the truth follows. Needs rosbags, numpy and scipy.
"""
import sys

import numpy as np
from bags import add_connections
from log_to_bag import STORE, make
from rosbags.rosbag1 import Reader, Writer
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

STALLS = (2.0, 4.0)
TOO_FAR = 1.2


def header(seconds, frame):
    ns = int(round(seconds * 1e6)) * 1000
    stamp = make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return make("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame)


def at_rate(poses, hertz):
    """Poses at regular times."""
    times = np.arange(poses[0, 0], poses[-1, 0], 1.0 / hertz)
    places = CubicSpline(poses[:, 0], poses[:, 1:4])(times)
    return times, places, Slerp(poses[:, 0], Rotation.from_quat(poses[:, 4:8]))(times)


def from_steps(places, turns, change):
    """Poses of a way whose steps, in the frame before each, were changed."""
    steps = turns[:-1].inv().apply(np.diff(places, axis=0))
    turned = (turns[:-1].inv() * turns[1:]).as_rotvec()
    steps, turned = change(steps, turned)
    pose, place = Rotation.identity(), np.zeros(3)
    all_turns, all_places = [pose], [place]
    for step, turn in zip(steps, Rotation.from_rotvec(turned)):
        place, pose = place + pose.apply(step), pose * turn
        all_places.append(place)
        all_turns.append(pose)
    return np.array(all_places), Rotation.concatenate(all_turns)


def planar(steps, turned):
    return steps * [1, 1, 0], turned * [0, 0, 1]


def slip(share, steps, turned):
    random = np.random.default_rng(1)
    count = len(steps) // 50 + 2
    factors = np.interp(np.arange(len(steps)), 50 * np.arange(count), random.normal(1.0, share, count))
    return steps * factors[:, None], turned


def told(poses, hows):
    """What odometry tells: times, places and quaternions."""
    times, places, turns = at_rate(poses, 10 if "ten-hertz" in hows else 50)
    changes = {
        "planar": planar,
        "slip": lambda *motions: slip(0.03, *motions),
        "heavy-slip": lambda *motions: slip(0.1, *motions),
        "mirrored": lambda steps, turned: (steps * [1, -1, 1], turned * [-1, 1, -1]),
        "drift": lambda steps, turned: (steps, turned + [0, 0, np.radians(1.0) * np.diff(times).mean()]),
        "wide": lambda steps, turned: (steps, turned * [1, 1, 1.2]),
        "to-the-left": lambda steps, turned: (steps[:, [1, 0, 2]] * [-1, 1, 1], turned[:, [1, 0, 2]] * [-1, 1, 1]),
        "backwards": lambda steps, turned: (steps * [-1, -1, 1], turned * [-1, -1, 1]),
    }
    for how in hows:
        if how in changes:
            places, turns = from_steps(places, turns, changes[how])
        scale = {"centimetres": 100.0, "scale": TOO_FAR, "small-scale": 0.9, "never-moves": 0.0, "turns-alone": 0.0}
        places = places * scale.get(how, 1.0)
        if how == "never-moves":
            turns = Rotation.concatenate([Rotation.identity()] * len(times))
        if how == "jump":
            places[np.searchsorted(times, times[0] + 3.0):] += [1.4, 1.4, 0.0]
    turns = turns.as_quat()
    if "stalls" in hows:
        begin, end = (np.searchsorted(times, times[0] + seconds) for seconds in STALLS)
        places[end:] += places[begin] - places[end]
        places[begin:end], turns[begin:end] = places[begin], turns[begin]
    delay = 0.15 if "late" in hows else -0.15 if "early" in hows else 0.0
    return times + delay, places, turns


def odometry(seconds, place, turn, frame):
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", *map(float, place)), make("geometry_msgs/msg/Quaternion", *map(float, turn)))
    return make(
        "nav_msgs/msg/Odometry", header(seconds, "odom"), frame,
        make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)),
    )


def parent_of(frame, reader):
    """The frame in which static transforms say that another lies."""
    static = [c for c in reader.connections if c.topic == "/tf_static"]
    for _, _, raw in reader.messages(static) if static else []:
        for transform in STORE.deserialize_ros1(raw, "tf2_msgs/msg/TFMessage").transforms:
            if transform.child_frame_id == frame:
                return transform.header.frame_id
    return None


def main():
    source, truth, output, how, lever = sys.argv[1:]
    times, places, turns = told(np.loadtxt(truth), how.split("+"))
    with Reader(source) as reader, Writer(output) as writer:
        connections = add_connections(reader, writer)
        messages = [(time, connections[connection.id], raw) for connection, time, raw in reader.messages()]
        clouds = next(c for c in reader.connections if c.msgtype == "sensor_msgs/msg/PointCloud2")
        first = next(raw for connection, _, raw in reader.messages() if connection.id == clouds.id)
        lidar = STORE.deserialize_ros1(first, clouds.msgtype).header.frame_id
        frame = parent_of(lidar, reader)
        if frame is None:
            frame = "base_link"
            place = make("geometry_msgs/msg/Vector3", *map(float, lever.split(",")))
            mounting = make("geometry_msgs/msg/Transform", place, make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
            stamped = make("geometry_msgs/msg/TransformStamped", header(times[0], frame), lidar, mounting)
            transforms = STORE.serialize_ros1(make("tf2_msgs/msg/TFMessage", [stamped]), "tf2_msgs/msg/TFMessage")
            of_transforms = writer.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=STORE)
            messages.append((messages[0][0], of_transforms, transforms))
        of_odometry = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=STORE)
        for seconds, place, turn in zip(times, places, turns):
            raw = STORE.serialize_ros1(odometry(seconds, place, turn, frame), "nav_msgs/msg/Odometry")
            messages.append((int(seconds * 1e9), of_odometry, raw))
        for time, connection, raw in sorted(messages, key=lambda message: message[0]):
            writer.write(connection, time, raw)


if __name__ == "__main__":
    main()
