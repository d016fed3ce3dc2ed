#!/usr/bin/env python3
"""spoil_space.py BAG OUT.bag HOW : a ROS 1 bag of a 3D lidar made worse, as recordings of other sensors and people are.

    lines    about 16 lines instead of 64     front    points ahead alone, 100 degrees
    near     points up to 25 m alone          few      one point in eight, at random
    slow     every second sweep               noise    4 cm of noise along every beam
    packets  30 % of sectors of 10 degrees missing, others in every sweep
    rain     5 % of points end at random nearer than they do
    behind   nothing behind: 120 degrees are hidden
    late     stamps of sweeps jitter by 10 ms
    tilted   the lidar is mounted 30 degrees down, upside upside down, onside on its side; nobody says so
    carrier  who carries it hides 40 degrees behind, 0.6 m away, and sways by 5 cm
    hull     and 300 points of the vehicle, up to 1.5 m away, are in every sweep
    cover    10 of every 40 sweeps see a sheet over the lidar, 0.8 to 1.6 m away
    gone     one sweep in five is missing, at random
    doubled  every sweep comes twice
    stale    every fifth sweep has the points of the one before under its own stamp
    swapped  every tenth sweep comes behind the one after it
    mirror   y has the wrong sign, as where somebody mixed left-handed and right-handed frames
    pieces   every sweep comes as six messages of a sixth of its points, in their order, without times of points
    one+two  both

Other messages stay as they are. Needs rosbags and numpy. The seed is fixed: the same bag in every run.
"""
import sys

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
LIDAR = "sensor_msgs/msg/PointCloud2"


def kept(points, how, chance):
    """Which points of a sweep remain."""
    x, y, z = points.T
    bearing, distance = np.degrees(np.arctan2(y, x)), np.linalg.norm(points, axis=1)
    if how == "lines":
        return np.round(np.degrees(np.arcsin(z / np.maximum(distance, 1e-6))) / 0.42).astype(int) % 4 == 0
    if how == "front":
        return np.abs(bearing) < 50
    if how == "behind":
        return np.abs(bearing) < 120
    if how == "near":
        return distance < 25
    if how == "few":
        return chance.random(len(points)) < 0.125
    if how == "packets":
        return (chance.random(36) > 0.3)[np.floor((bearing + 180) / 10).astype(int) % 36]
    return np.ones(len(points), bool)


def scaled(points, how, chance):
    """By what factor each beam is longer than it was."""
    distance = np.maximum(np.linalg.norm(points, axis=1), 0.1)
    if how == "noise":
        return 1 + chance.normal(0, 0.04, len(points)) / distance
    if how == "cover":
        return chance.uniform(0.8, 1.6, len(points)) / distance
    if how == "rain":
        return np.where(chance.random(len(points)) < 0.05, chance.random(len(points)), 1)
    return np.ones(len(points))


def mounted(points, how):
    """The points as a lidar sees them that is mounted otherwise."""
    axis, degrees = {"tilted": (1, -30), "upside": (0, 180), "onside": (0, 90)}[how]
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    turned = points.copy()
    turned[:, first] = cosine * points[:, first] - sine * points[:, second]
    turned[:, second] = sine * points[:, first] + cosine * points[:, second]
    return turned


def hidden(points, how, chance):
    """What the carrier or the vehicle itself hides ends there."""
    seen, distance = points.copy(), np.maximum(np.linalg.norm(points, axis=1), 0.1)
    if how == "carrier":
        bearing = np.degrees(np.arctan2(points[:, 1], -points[:, 0]))
        behind = np.abs(bearing + chance.normal(0, 3)) < 20
        nearer = 0.6 + chance.normal(0, 0.05) + 0.05 * np.cos(np.radians(4 * bearing[behind]))
        seen[behind] *= (nearer / distance[behind])[:, None]
    else:
        # A box of 1.4 m by 0.9 m below the lidar, its upper edges as steady as a hull is.
        hit = chance.choice(len(points), min(300, len(points)), replace=False)
        edges = np.random.default_rng(3).uniform([-0.7, -0.45, -0.5], [0.7, 0.45, -0.45], (300, 3))
        seen[hit] = edges[: len(hit)] + chance.normal(0, 0.01, (len(hit), 3))
    return seen


def changed(points, how, chance):
    """The same points, elsewhere."""
    if how in ("tilted", "upside", "onside"):
        return mounted(points, how)
    if how == "mirror":
        return points * [1, -1, 1]
    if how in ("carrier", "hull"):
        return hidden(points, how, chance)
    return points * scaled(points, how, chance)[:, None]


def spoilt(cloud, how, chance):
    """The sweep made worse; its fields stay as they are."""
    raw = np.frombuffer(bytes(cloud.data), np.uint8).reshape(-1, cloud.point_step).copy()
    at = next(f.offset for f in cloud.fields if f.name == "x")
    points = np.frombuffer(raw[:, at : at + 12].tobytes(), np.float32).reshape(-1, 3).astype(float)
    moved = changed(points, how, chance).astype(np.float32)
    raw[:, at : at + 12] = np.frombuffer(moved.tobytes(), np.uint8).reshape(-1, 12)
    raw = raw[kept(points, how, chance)]
    cloud.height, cloud.width, cloud.row_step = 1, len(raw), raw.size
    cloud.data = raw.reshape(-1)
    if how == "late":
        stamp = cloud.header.stamp
        moved = stamp.sec * 10**9 + stamp.nanosec + int(chance.normal(0, 1e7))
        stamp.sec, stamp.nanosec = divmod(moved, 10**9)
    return cloud


def pieces(cloud, count):
    """The sweep as so many messages, whose stamps say when their points were taken if a turn takes 0.1 s."""
    cloud.fields = [f for f in cloud.fields if f.name in ("x", "y", "z", "intensity", "ring")]
    raw = np.frombuffer(bytes(cloud.data), np.uint8).reshape(-1, cloud.point_step)
    start = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
    for k, part in enumerate(np.array_split(raw, count)):
        stamp = cloud.header.stamp
        stamp.sec, stamp.nanosec = divmod(start + k * 10**8 // count, 10**9)
        cloud.height, cloud.width, cloud.row_step = 1, len(part), part.size
        cloud.data = part.reshape(-1).copy()
        yield k * 10**8 // count, STORE.serialize_ros1(cloud, cloud.__msgtype__)


def main():
    source, output = sys.argv[1:3]
    hows = sys.argv[3].split("+")
    chance, sweeps, waiting, last = np.random.default_rng(7), 0, None, None
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        for c, time, data in reader.messages():
            if c.msgtype != LIDAR:
                writer.write(added[c.id], time, data)
                continue
            sweeps += 1
            if "slow" in hows and sweeps % 2 == 0 or "gone" in hows and chance.random() < 0.2:
                continue
            cloud = STORE.deserialize_ros1(data, c.msgtype)
            is_covered = sweeps // 10 % 4 == 3
            for how in hows:
                if how == "cover" and not is_covered:
                    continue
                cloud = spoilt(cloud, how, chance)
            if "stale" in hows and last and sweeps % 5 == 0:
                last.header.stamp = cloud.header.stamp
                cloud = last
            last = cloud
            if "pieces" in hows:
                for later, data in pieces(cloud, 6):
                    writer.write(added[c.id], time + later, data)
                continue
            data = STORE.serialize_ros1(cloud, c.msgtype)
            if "swapped" in hows and sweeps % 10 == 0:
                waiting = data
                continue
            for _ in range(2 if "doubled" in hows else 1):
                writer.write(added[c.id], time, data)
            if waiting:
                writer.write(added[c.id], time, waiting)
                waiting = None


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main()
