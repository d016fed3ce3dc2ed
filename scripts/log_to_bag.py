#!/usr/bin/env python3
"""log_to_bag.py LOG OUT.bag HOW : a CARMEN log as a ROS 1 bag, as robots of other makes record it.

    plain         /scan, /odom, and where the laser is in /tf_static
    two-scanners  the left and the right half of every scan from a scanner of its own, each turned by 45 degrees
    in-turns      the same with three quarters of the view each, every other scan from the one and the rest from the other
    transforms    odometry in /tf alone
    cloud, cloud1 scans as sensor_msgs/PointCloud2, or as sensor_msgs/PointCloud
    descending    beams in descending order of their angles
    upside-down   the scanner is mounted upside down, as /tf_static says
    robots        two robots: the first half of the log is that of r1, the second half, moved in time, that of r2, with frames
                  of their own below "world"; robots-same-frames with the same names of frames and without transforms between
    never-moves, turns-alone, centimetres, mirrored, late
                  odometry that stays at zero, keeps its heading alone, is in other units, has left and right exchanged, or
                  is stamped 0.3 s late
    HOW+transforms the same of odometry in /tf

Stamps are the times in the lines of scans, moved by 10^9 s. Needs rosbags and numpy.
"""
import bz2
import math
import sys

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
TYPES = STORE.types
EPOCH = 1e9
LATE = 0.3
FARTHEST = 80.0
FAULTS = {
    "never-moves": lambda x, y, yaw: (0.0, 0.0, 0.0),
    "turns-alone": lambda x, y, yaw: (0.0, 0.0, yaw),
    "centimetres": lambda x, y, yaw: (100.0 * x, 100.0 * y, yaw),
    "mirrored": lambda x, y, yaw: (x, -y, -yaw),
}


def make(name, *values, **fields):
    return TYPES[name](*values, **fields)


def nanoseconds(seconds):
    return int(round((seconds + EPOCH) * 1e6)) * 1000


def header(seconds, frame):
    ns = nanoseconds(seconds)
    stamp = make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return make("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame)


def quaternion(yaw, roll_over=False):
    z, w = math.sin(yaw / 2), math.cos(yaw / 2)
    # Half a turn about x before the turn about z.
    return make("geometry_msgs/msg/Quaternion", *((w, z, 0.0, 0.0) if roll_over else (0.0, 0.0, z, w)))


def transform(seconds, parent, child, pose, roll_over=False):
    x, y, yaw = pose
    translation = make("geometry_msgs/msg/Vector3", x, y, 0.0)
    motion = make("geometry_msgs/msg/Transform", translation, quaternion(yaw, roll_over))
    return make("geometry_msgs/msg/TransformStamped", header(seconds, parent), child, motion)


def odometry(seconds, pose, prefix):
    x, y, yaw = pose
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    place = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", x, y, 0.0), quaternion(yaw))
    return make(
        "nav_msgs/msg/Odometry", header(seconds, prefix + "odom"), prefix + "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", place, np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)),
    )


def laser_scan(seconds, frame, first, increment, ranges):
    return make(
        "sensor_msgs/msg/LaserScan", header(seconds, frame), first, first + increment * (len(ranges) - 1), increment,
        0.0, 0.0, 0.02, FARTHEST, np.array(ranges, np.float32), np.zeros(0, np.float32),
    )


def points(first, increment, ranges):
    ranges = np.array(ranges)
    angles = first + increment * np.arange(len(ranges))
    is_return = (ranges > 0.02) & (ranges < FARTHEST)
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * ranges], 1)[is_return].astype("<f4")


def cloud(seconds, frame, xyz):
    fields = [make("sensor_msgs/msg/PointField", name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    data = np.frombuffer(xyz.tobytes(), np.uint8)
    return make("sensor_msgs/msg/PointCloud2", header(seconds, frame), 1, len(xyz), fields, False, 12, 12 * len(xyz), data, True)


def cloud1(seconds, frame, xyz):
    return make("sensor_msgs/msg/PointCloud", header(seconds, frame), [make("geometry_msgs/msg/Point32", *map(float, p)) for p in xyz], [])


def scans(log):
    """(seconds, first angle, increment, ranges, pose of the laser on the robot, pose of the odometry)."""
    with (bz2.open(log, "rt", errors="replace") if log.endswith("bz2") else open(log, errors="replace")) as lines:
        for words in map(str.split, lines):
            if not words or words[0] != "FLASER":
                continue
            n = int(words[1])
            lx, ly, lyaw, x, y, yaw, seconds = map(float, words[2 + n : 9 + n])
            increment = math.pi / n if n in (180, 360) else math.pi / (n - 1)
            c, s = math.cos(yaw), math.sin(yaw)
            mounted = (c * (lx - x) + s * (ly - y), -s * (lx - x) + c * (ly - y), math.remainder(lyaw - yaw, 2 * math.pi))
            yield seconds, -math.pi / 2, increment, [float(w) for w in words[2 : 2 + n]], mounted, (x, y, yaw)


class Robot:
    """Writes what one robot records."""

    def __init__(self, writer, how, topics="", frames=""):
        self.writer, self.how, self.topics, self.frames, self.connections = writer, how, topics, frames, {}
        self.scans = 0

    def put(self, topic, seconds, message):
        kind = message.__msgtype__
        if topic not in self.connections:
            known = next((c for c in self.writer.connections if c.topic == topic), None)
            self.connections[topic] = known or self.writer.add_connection(topic, kind, typestore=STORE)
        self.writer.write(self.connections[topic], nanoseconds(seconds), STORE.serialize_ros1(message, kind))

    def put_transforms(self, topic, seconds, transforms):
        self.put(topic, seconds, make("tf2_msgs/msg/TFMessage", transforms))

    def begin(self, seconds, mounted, world):
        x, y, yaw = mounted
        base, laser = self.frames + "base_link", self.frames + "laser"
        places = [transform(seconds, base, laser, mounted, self.how == "upside-down")]
        if self.how in ("two-scanners", "in-turns"):
            sides = (("left", 1), ("right", -1))
            places = [transform(seconds, base, f"laser_{side}", (x, y, yaw + sign * math.pi / 4)) for side, sign in sides]
        if world:
            places.append(transform(seconds, "world", self.frames + "odom", world))
        self.put_transforms("/tf_static", seconds, places)

    def put_odometry(self, seconds, pose):
        fault, _, carrier = self.how.partition("+")
        pose = FAULTS.get(fault, lambda *pose: pose)(*pose)
        at = seconds + (LATE if fault == "late" else 0.0)
        in_transforms = "transforms" in (fault, carrier)
        if in_transforms or self.how == "robots":
            self.put_transforms("/tf", at, [transform(at, self.frames + "odom", self.frames + "base_link", pose)])
        if not in_transforms:
            self.put(self.topics + "/odom", at, odometry(at, pose, self.frames))

    def put_scan(self, seconds, first, increment, ranges):
        laser = self.frames + "laser"
        if self.how == "two-scanners":
            half = len(ranges) // 2
            self.put("/scan_right", seconds, laser_scan(seconds, "laser_right", first + math.pi / 4, increment, ranges[:half]))
            middle = first + increment * half
            self.put("/scan_left", seconds, laser_scan(seconds, "laser_left", middle - math.pi / 4, increment, ranges[half:]))
        elif self.how == "in-turns":
            self.scans += 1
            quarter, turn = len(ranges) // 4, math.pi / 4
            if self.scans % 2:
                self.put("/scan_right", seconds, laser_scan(seconds, "laser_right", first + turn, increment, ranges[:-quarter]))
            else:
                first += increment * quarter - turn
                self.put("/scan_left", seconds, laser_scan(seconds, "laser_left", first, increment, ranges[quarter:]))
        elif self.how in ("cloud", "cloud1"):
            message = {"cloud": cloud, "cloud1": cloud1}[self.how]
            self.put("/points", seconds, message(seconds, laser, points(first, increment, ranges)))
        else:
            last = first + increment * (len(ranges) - 1)
            if self.how == "descending":
                first, increment, ranges = last, -increment, ranges[::-1]
            elif self.how == "upside-down":
                first, ranges = -last, ranges[::-1]
            self.put(self.topics + "/scan", seconds, laser_scan(seconds, laser, first, increment, ranges))


def main():
    log, output, how = sys.argv[1:]
    recorded = sorted(scans(log), key=lambda scan: scan[0])
    with Writer(output) as writer:
        robots = [(Robot(writer, how), recorded, None)]
        if how.startswith("robots"):
            half = len(recorded) // 2
            earlier = recorded[half][0] - recorded[0][0]
            halves = recorded[:half], [(scan[0] - earlier, *scan[1:]) for scan in recorded[half:]]
            is_same = how == "robots-same-frames"
            robots = [
                (Robot(writer, how, f"/r{i}", "" if is_same else f"r{i}/"), part, None if is_same else (0.0, 5.0 * i, 0.0))
                for i, part in enumerate(halves, 1)
            ]
        for robot, part, world in robots:
            robot.begin(part[0][0], part[0][4], world)
        everything = [(scan, i) for i, (_, part, _) in enumerate(robots) for scan in part]
        for (seconds, first, increment, ranges, _, pose), i in sorted(everything, key=lambda entry: (entry[0][0], entry[1])):
            robots[i][0].put_odometry(seconds, pose)
            robots[i][0].put_scan(seconds, first, increment, ranges)


if __name__ == "__main__":
    main()
