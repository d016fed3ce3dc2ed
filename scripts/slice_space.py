#!/usr/bin/env python3
"""slice_space.py BAG OUT.bag ... : the planar scanner that a 3D lidar contains: a ROS 1 bag of laser scans.

Of each sweep the nearest point of every beam is taken, in a fan of some degrees of elevation seen from the lidar.

    --elevation D      middle of the fan, degrees (0)
    --height D         height of the fan, degrees (0.5)
    --beams N          beams of a turn (720)
    --view D           degrees of view, ahead in the middle (360)
    --range M          longest range, metres (80)
    --ahead            turns begin ahead, not behind
    --still            the points are de-skewed: scans without times
    --alone            the scanner alone, without IMU and all else
    --odometry F.tum   odometry of the lidar's own motion in the plane, from these poses
    --scale S          its way is S times as long (1)
    --delay D          its stamps are D seconds late (0)
    --fault F          it fails: stands (always) | freezes, slips (twice as far), is-missing (each for 2 s from 0.4 of the
                       recording on) | ends (there) | jumps (5 m ahead, there) | begins-late (2 s) | is-sparse (every tenth pose)
                       | has-no-turns | turns-backwards | goes-backwards

Turns are taken to be clockwise, at constant speed, with the stamp in their middle, as KITTI's are. Needs rosbags and numpy.
"""
import argparse

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
LIDAR = "sensor_msgs/msg/PointCloud2"
SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
FAULTS = [
    "stands", "freezes", "slips", "is-missing", "ends", "jumps", "begins-late", "is-sparse", "has-no-turns", "turns-backwards",
    "goes-backwards",
]


def coordinates(cloud):
    raw = np.frombuffer(bytes(cloud.data), np.uint8).reshape(-1, cloud.point_step)
    offsets = {field.name: field.offset for field in cloud.fields}
    return [np.ascontiguousarray(raw[:, offsets[axis] : offsets[axis] + 4]).view("<f4")[:, 0].astype(float) for axis in "xyz"]


def stamp_of(seconds):
    whole = int(np.floor(seconds))
    return STORE.types["builtin_interfaces/msg/Time"](whole, int(round((seconds - whole) * 1e9)) % 10**9)


def scan_of(cloud, period, options):
    """The fan of a sweep as a scan, clockwise."""
    x, y, z = coordinates(cloud)
    distance = np.hypot(x, y)
    off = np.degrees(np.arctan2(z, distance)) - options.elevation
    used = (np.abs(off) <= 0.5 * options.height) & (distance > 1.0) & (distance < options.range)
    step = 2 * np.pi / options.beams
    count = int(round(options.beams * options.view / 360))
    first = (0.0 if options.ahead else np.pi) if options.view == 360 else np.radians(0.5 * options.view)
    beam = np.floor((first - np.arctan2(y[used], x[used])) % (2 * np.pi) / step).astype(int)
    ranges = np.full(options.beams, np.inf)
    np.minimum.at(ranges, beam, distance[used])
    header = cloud.header
    seconds = header.stamp.sec + 1e-9 * header.stamp.nanosec
    increment = 0.0 if options.still else period / options.beams
    header.stamp = stamp_of(seconds - 0.5 * count * increment)
    ranges = ranges[:count].astype(np.float32)
    angles = (first - 0.5 * step, first - (count - 0.5) * step, -step)
    return STORE.types[SCAN](header, *angles, increment, period, 0.5, options.range, ranges, np.zeros(0, np.float32))


def with_fault(fault, time, place, yaw):
    """Times, places and headings of odometry that fails: its steps, as it sees them, are changed and put together again."""
    since = time - time[0]
    begin = 0.4 * since[-1]
    fails = (since >= begin) & (since < begin + 2)
    turn = (np.diff(yaw) + np.pi) % (2 * np.pi) - np.pi
    step, before = np.diff(place, axis=0), yaw[:-1]
    ahead = np.cos(before) * step[:, 0] + np.sin(before) * step[:, 1]
    left = np.cos(before) * step[:, 1] - np.sin(before) * step[:, 0]
    if fault in ("stands", "freezes"):
        moves = 0 if fault == "stands" else ~fails[1:]
        ahead, left, turn = ahead * moves, left * moves, turn * moves
    elif fault == "slips":
        ahead = ahead * (1 + fails[1:])
    elif fault == "jumps":
        ahead[np.argmax(fails[1:])] += 5
    elif fault == "has-no-turns":
        turn = 0 * turn
    elif fault == "turns-backwards":
        left, turn = -left, -turn
    elif fault == "goes-backwards":
        ahead, left = -ahead, -left
    angle = yaw[0] + np.concatenate([[0], np.cumsum(turn)])
    cos, sin = np.cos(angle[:-1]), np.sin(angle[:-1])
    steps = np.stack([cos * ahead - sin * left, sin * ahead + cos * left], 1)
    kept = {"is-missing": ~fails, "ends": since < begin, "begins-late": since >= 2, "is-sparse": np.arange(len(time)) % 10 == 0}
    kept = kept.get(fault, np.full(len(time), True))
    return time[kept], np.concatenate([[[0, 0]], np.cumsum(steps, 0)])[kept], angle[kept]


def odometry(poses, scale, delay, fault):
    """Messages made of poses (time, x, y, z, quaternion), in order of their stamps."""
    time, x, y, z, w = poses[:, 0] + delay, *poses[:, 4:8].T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    place = scale * (poses[:, 1:3] - poses[0, 1:3])
    if fault:
        time, place, yaw = with_fault(fault, time, place, yaw)
    types = STORE.types
    none = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](none, none), np.zeros(36))
    for t, (px, py), angle in zip(time, place, yaw):
        pose = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](px, py, 0.0),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(0.5 * angle), np.cos(0.5 * angle)),
        )
        header = types["std_msgs/msg/Header"](0, stamp_of(t), "odom")
        pose = types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
        yield t, types[ODOMETRY](header, "velodyne", pose, twist)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag")
    parser.add_argument("out")
    parser.add_argument("--elevation", type=float, default=0.0)
    parser.add_argument("--height", type=float, default=0.5)
    parser.add_argument("--beams", type=int, default=720)
    parser.add_argument("--view", type=float, default=360)
    parser.add_argument("--range", type=float, default=80)
    parser.add_argument("--ahead", action="store_true")
    parser.add_argument("--still", action="store_true")
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--odometry")
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--delay", type=float, default=0.0)
    parser.add_argument("--fault", choices=FAULTS)
    options = parser.parse_args()
    with Reader(options.bag) as reader, Writer(options.out) as writer:
        clouds = [m for m in reader.messages() if m[0].msgtype == LIDAR]
        times = [m[1] * 1e-9 for m in clouds]
        period = float(np.median(np.diff(times)))
        added = add_connections(reader, writer)
        scans = writer.add_connection("/scan", SCAN, typestore=STORE)
        waiting = []
        if options.odometry:
            odom = writer.add_connection("/odom", ODOMETRY, typestore=STORE)
            waiting = list(odometry(np.loadtxt(options.odometry), options.scale, options.delay, options.fault))
        for connection, time, data in reader.messages():
            while waiting and waiting[0][0] * 1e9 <= time:
                stamp, message = waiting.pop(0)
                writer.write(odom, int(stamp * 1e9), STORE.serialize_ros1(message, ODOMETRY))
            if connection.msgtype == LIDAR:
                scan = scan_of(STORE.deserialize_ros1(data, LIDAR), period, options)
                writer.write(scans, time, STORE.serialize_ros1(scan, SCAN))
            elif not options.alone:
                writer.write(added[connection.id], time, data)


if __name__ == "__main__":
    main()
