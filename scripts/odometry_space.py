#!/usr/bin/env python3
"""odometry_space.py BAG TRUTH.tum OUT.bag HOW X,Y,Z : odometry from the truth, or a wrong one, for a ROS 1 bag of a 3D lidar.

HOW: right, never-moves, turns-alone, centimetres, scale (a fifth too far), stalls (stands still from 2 to 4 s, then goes on).
X,Y,Z: where the lidar lies, seen from what the truth follows, metres: /tf_static says so. Needs rosbags, numpy and scipy.
"""
import sys

import numpy as np
from bags import add_connections
from log_to_bag import STORE, make
from rosbags.rosbag1 import Reader, Writer
from scipy.spatial.transform import Rotation

STALLS = (2.0, 4.0)
TOO_FAR = 1.2


def header(seconds, frame):
    ns = int(round(seconds * 1e6)) * 1000
    stamp = make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return make("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame)


def told(poses, how):
    """What odometry tells: times, places and quaternions."""
    times, places, turns = poses[:, 0], poses[:, 1:4].copy(), poses[:, 4:8].copy()
    if how in ("never-moves", "turns-alone"):
        places[:] = 0.0
    if how == "never-moves":
        turns[:] = Rotation.identity().as_quat()
    places *= {"centimetres": 100.0, "scale": TOO_FAR}.get(how, 1.0)
    if how == "stalls":
        begin, end = (np.searchsorted(times, times[0] + seconds) for seconds in STALLS)
        places[end:] += places[begin] - places[end]
        places[begin:end], turns[begin:end] = places[begin], turns[begin]
    return times, places, turns


def odometry(seconds, place, turn):
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", *map(float, place)), make("geometry_msgs/msg/Quaternion", *map(float, turn)))
    return make(
        "nav_msgs/msg/Odometry", header(seconds, "odom"), "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)),
    )


def main():
    source, truth, output, how, lever = sys.argv[1:]
    times, places, turns = told(np.loadtxt(truth), how)
    with Reader(source) as reader, Writer(output) as writer:
        connections = add_connections(reader, writer)
        messages = [(time, connections[connection.id], raw) for connection, time, raw in reader.messages()]
        clouds = next(c for c in reader.connections if c.msgtype == "sensor_msgs/msg/PointCloud2")
        first = next(raw for connection, _, raw in reader.messages() if connection.id == clouds.id)
        lidar = STORE.deserialize_ros1(first, clouds.msgtype).header.frame_id
        place = make("geometry_msgs/msg/Vector3", *map(float, lever.split(",")))
        mounting = make("geometry_msgs/msg/Transform", place, make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
        stamped = make("geometry_msgs/msg/TransformStamped", header(times[0], "base_link"), lidar, mounting)
        of_odometry = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=STORE)
        of_transforms = writer.add_connection("/tf_static", "tf2_msgs/msg/TFMessage", typestore=STORE)
        transforms = make("tf2_msgs/msg/TFMessage", [stamped])
        messages.append((messages[0][0], of_transforms, STORE.serialize_ros1(transforms, "tf2_msgs/msg/TFMessage")))
        for seconds, place, turn in zip(times, places, turns):
            raw = STORE.serialize_ros1(odometry(seconds, place, turn), "nav_msgs/msg/Odometry")
            messages.append((int(seconds * 1e9), of_odometry, raw))
        for time, connection, raw in sorted(messages, key=lambda message: message[0]):
            writer.write(connection, time, raw)


if __name__ == "__main__":
    main()
