#!/usr/bin/env python3
"""handheld.py IMU.txt POSES.txt OUT.bag TRUTH.tum WORLD LIDAR [FROM UNTIL]: a real IMU beside a made lidar.

What the IMU of a sensor rig measured that somebody carried, as it was recorded, and sweeps that a lidar on the same rig would have
seen in a made world. Motion, noise and biases of the IMU are real, and so is how the rig leans (up to 46 degrees); the world, the
noise of ranges (2 cm) and stamps are not. IMU.txt: time, acceleration, turn rate; POSES.txt: time, place, quaternion of the IMU
(imu/handheld_237s of the data folder). TRUTH.tum: poses of the IMU, z up, at the times of its samples: splines through POSES that
agree with the IMU within 0.2 mm and 0.02 m/s2.

WORLD: room (a room with boxes), hall (a large one), corridor (bare walls 120 m long), posts (a floor and twelve boxes), pillars (walls
and pillars as high as the room). LIDAR: vlp16, os32, planar. FROM, UNTIL: seconds. Needs numpy, scipy, numba and rosbags.
"""
import sys

import numba
import numpy as np
import scipy.sparse as sparse
from log_to_bag import STORE, make
from rosbags.rosbag1 import Writer
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import lsqr, spsolve
from scipy.spatial.transform import Rotation, Slerp

# The rig's y axis points down; that of the lidar does not.
LIDAR_FROM_IMU = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
LIDAR_IN_IMU = np.array([0.03, -0.08, 0.02])
SWEEP = 0.1
# Elevations in degrees, columns a turn, farthest reading in metres.
LIDARS = {
    "vlp16": (np.linspace(-15, 15, 16), 900, 80.0),
    "os32": (np.linspace(-22, 22, 32), 512, 80.0),
    "planar": (np.zeros(1), 720, 30.0),
}


def cubic(times, step, count, derivative=0):
    """Values, or second derivatives, of uniform cubic B-splines."""
    index = np.floor(times / step).astype(int)
    u = times / step - index
    if derivative == 0:
        weights = np.stack([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], 1) / 6
    else:
        weights = np.stack([1 - u, 3 * u - 2, -3 * u + 1, u], 1) / step**2
    rows = np.repeat(np.arange(len(times)), 4)
    columns = (index[:, None] + np.arange(4)).ravel()
    return sparse.csr_matrix((weights.ravel(), (rows, columns)), shape=(len(times), count))


def attitude(times, rates, at, turns):
    """Rotations at the times of the IMU: its rates without their bias, drawn to poses at knots of a second."""

    def integrated(bias):
        steps = Rotation.from_rotvec((0.5 * (rates[1:] + rates[:-1]) - bias) * np.diff(times)[:, None]).as_matrix()
        all_of_them = np.empty((len(times), 3, 3))
        all_of_them[0] = np.eye(3)
        for i, step in enumerate(steps):
            all_of_them[i + 1] = all_of_them[i] @ step
        return Rotation.from_matrix(all_of_them)

    bias, apart = np.zeros(3), 50
    for _ in range(4):
        by_rates = Slerp(times, integrated(bias))
        error = (by_rates(at[:-apart]).inv() * by_rates(at[apart:])).inv() * (turns[:-apart].inv() * turns[apart:])
        bias = bias - np.median(error.as_rotvec(), 0) / (at[apart] - at[0])
    by_rates = integrated(bias)
    drift = turns * Slerp(times, by_rates)(at).inv()
    change = (drift * drift[0].inv()).as_rotvec()
    count = int(times[-1]) + 5
    both = sparse.vstack([cubic(at, 1.0, count), sparse.identity(count) * 1e-6])
    knots = np.column_stack([lsqr(both, np.r_[change[:, j], np.zeros(count)])[0] for j in range(3)])
    smooth = Rotation.from_rotvec(cubic(np.minimum(times, at[-1]), 1.0, count) @ knots)
    return smooth * drift[0] * by_rates


def motion(imu, poses):
    """Times from the first sample, places and rotations of the IMU with z up."""
    start, times = imu[0, 0], imu[:, 0] - imu[0, 0]
    at = poses[:, 0] - start
    inside = (at > 0) & (at < times[-1] - 0.1)
    at, seen, turns = at[inside], poses[inside, 1:4], Rotation.from_quat(poses[inside, 4:8])
    rotations = attitude(times, imu[:, 4:7], at, turns)
    # Places, gravity and the bias of the accelerometer that fit both: p'' = R (a - bias) + g.
    step, size = 0.05, int(times[-1] / 0.05) + 5
    turned, three = rotations.as_matrix(), sparse.identity(3)
    of_places = sparse.hstack([sparse.kron(cubic(at, step, size) / 0.005, three), sparse.csr_matrix((3 * len(at), 6))])
    of_forces = sparse.hstack([
        sparse.kron(cubic(times, step, size, 2) / 0.1, three),
        -sparse.kron(np.ones((len(times), 1)), three) / 0.1,
        sparse.csr_matrix(turned.reshape(-1, 3)) / 0.1,
    ])
    priors = sparse.diags(np.r_[np.full(3 * size, 1e-3), np.zeros(3), np.full(3, 1 / 0.3)])
    matrix = sparse.vstack([of_places, of_forces, priors]).tocsr()
    forces = np.einsum("nij,nj->ni", turned, imu[:, 1:4])
    right = np.r_[(seen / 0.005).ravel(), (forces / 0.1).ravel(), np.zeros(3 * size + 6)]
    found = spsolve((matrix.T @ matrix).tocsc(), matrix.T @ right)
    gravity = found[3 * size : 3 * size + 3]
    upright, _ = Rotation.align_vectors([[0, 0, 1]], [-gravity / np.linalg.norm(gravity)])
    places = cubic(times, step, size) @ found[: 3 * size].reshape(size, 3)
    return times, upright.apply(places), upright * rotations


class World:
    """A room, and boxes in it that the way does not touch."""

    def __init__(self, name, way):
        self.way, self.random = way, np.random.default_rng(1)
        low, high = way.min(0), way.max(0)
        around = {
            "room": ([2.5, 3, 1.2], [2.5, 2, 1.0]),
            "hall": ([15, 12, 1.2], [20, 16, 6.0]),
            "corridor": ([1.2, 60, 1.2], [1.2, 60, 1.0]),
            "posts": ([500, 500, 1.2], [500, 500, 500]),
            "pillars": ([4, 5, 1.2], [5, 4, 1.0]),
        }[name]
        self.low, self.high = low - around[0], high + around[1]
        floor, boxes = self.low, []
        if name == "room":
            boxes = self.boxes(25, floor, self.high, (0.4, 1.6), 0.5)
        elif name == "hall":
            boxes = self.boxes(40, floor, self.high, (0.5, 4), 0.8)
        elif name == "posts":
            boxes = self.boxes(12, np.r_[low[:2] - 25, floor[2]], high + 25, (0.5, 2), 2)
        elif name == "pillars":
            boxes = self.boxes(14, floor, self.high, (0.3, 1.5), 0.5, height=self.high[2] - floor[2])
        self.boxes_low = np.array([a for a, _ in boxes]).reshape(-1, 3)
        self.boxes_high = np.array([b for _, b in boxes]).reshape(-1, 3)

    def boxes(self, count, low, high, sizes, clear, height=None):
        found = []
        while len(found) < count:
            middle, half = self.random.uniform(low, high), self.random.uniform(*sizes, 3) / 2
            half[2] = half[2] if height is None else height / 2
            middle[2] = low[2] + half[2]
            a, b = middle - half, middle + half
            if np.linalg.norm(np.maximum(np.maximum(a - self.way, self.way - b), 0), axis=1).min() > clear:
                found.append((a, b))
        return found

    def ranges(self, origins, directions):
        return cast(origins, np.ascontiguousarray(directions), self.low, self.high, self.boxes_low, self.boxes_high)


@numba.njit
def cast(origins, directions, low, high, boxes_low, boxes_high):
    ranges = np.empty(len(origins))
    for k in range(len(origins)):
        o, d, nearest = origins[k], directions[k], 1e9
        for j in range(3):
            if d[j] != 0:
                nearest = min(nearest, ((high[j] if d[j] > 0 else low[j]) - o[j]) / d[j])
        for i in range(len(boxes_low)):
            begin, end = -1e9, 1e9
            for j in range(3):
                if d[j] == 0:
                    end = end if boxes_low[i, j] <= o[j] <= boxes_high[i, j] else -1e9
                    continue
                a, b = (boxes_low[i, j] - o[j]) / d[j], (boxes_high[i, j] - o[j]) / d[j]
                begin, end = max(begin, min(a, b)), min(end, max(a, b))
            if 0.05 < begin < end:
                nearest = min(nearest, begin)
        ranges[k] = nearest
    return ranges


def header(seconds, frame):
    ns = int(round(seconds * 1e6)) * 1000
    stamp = make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return make("std_msgs/msg/Header", seq=0, stamp=stamp, frame_id=frame)


def vector(xyz):
    return make("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, xyz))))


def quaternion(rotation):
    return make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, rotation.as_quat()))))


def imu_message(time, acceleration, rate):
    unknown = np.r_[-1.0, np.zeros(8)]
    return make("sensor_msgs/msg/Imu", header=header(time, "imu_link"), orientation=quaternion(Rotation.identity()),
                orientation_covariance=unknown, angular_velocity=vector(rate), angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(acceleration), linear_acceleration_covariance=np.zeros(9))


def cloud_message(time, points, times):
    field = STORE.types["sensor_msgs/msg/PointField"]
    names, columns = ["x", "y", "z"], points
    if times is not None:
        names, columns = names + ["time"], np.column_stack([points, times])
    fields = [field(name=name, offset=4 * i, datatype=7, count=1) for i, name in enumerate(names)]
    data = columns.astype("<f4").tobytes()
    return make("sensor_msgs/msg/PointCloud2", header=header(time, "lidar"), height=1, width=len(points), fields=fields,
                is_bigendian=False, point_step=4 * len(names), row_step=4 * len(names) * len(points), data=np.frombuffer(data, np.uint8), is_dense=True)


def scan_message(time, ranges, farthest):
    step = -2 * np.pi / len(ranges)
    return make("sensor_msgs/msg/LaserScan", header=header(time, "lidar"), angle_min=0.0, angle_max=step * (len(ranges) - 1),
                angle_increment=step, time_increment=SWEEP / len(ranges), scan_time=SWEEP, range_min=0.3, range_max=farthest,
                ranges=ranges.astype(np.float32), intensities=np.zeros(0, np.float32))


def sweep(begin, lidar, world, place, rotation):
    """Points, or ranges of a planar lidar, of the sweep that begins at a time."""
    elevations, columns, farthest = lidar
    azimuths, up = -2 * np.pi * np.arange(columns) / columns, np.radians(elevations)
    beams = np.stack([np.outer(np.cos(azimuths), np.cos(up)), np.outer(np.sin(azimuths), np.cos(up)),
                      np.tile(np.sin(up), (columns, 1))], -1).reshape(-1, 3)
    late = np.arange(columns) * SWEEP / columns
    turns = rotation(begin + late)
    origins = place(begin + late) + turns.apply(LIDAR_IN_IMU)
    turned = np.einsum("nij,nj->ni", np.repeat(turns.as_matrix(), len(up), 0), LIDAR_FROM_IMU.inv().apply(beams))
    ranges = world.ranges(np.repeat(origins, len(up), 0), turned) + world.random.normal(0, 0.02, len(beams))
    is_seen = (ranges > 0.3) & (ranges < farthest)
    if len(up) == 1:
        return np.where(is_seen, ranges, np.inf), None
    return (beams * ranges[:, None])[is_seen], np.repeat(late, len(up))[is_seen]


def main():
    imu, poses = np.loadtxt(sys.argv[1]), np.loadtxt(sys.argv[2])
    out, truth, world_name, lidar_name = sys.argv[3:7]
    first, last = map(float, sys.argv[7:9]) if len(sys.argv) > 7 else (0.0, 1e9)
    times, places, rotations = motion(imu, poses)
    world, lidar = World(world_name, places), LIDARS[lidar_name]
    place, rotation = CubicSpline(times, places), Slerp(times, rotations)
    used = np.nonzero((times >= first) & (times <= last))[0]
    start = imu[0, 0]
    # What an IMU measures is told 2 ms later, and sweeps when they end.
    events = [(times[k] + 0.002, "imu", k) for k in used]
    events += [(t + SWEEP, "sweep", t) for t in np.arange(times[used[0]] + 0.06, times[used[-1]] - 0.12, SWEEP)]
    with Writer(out) as writer:
        kinds = {"imu": ("/imu", "sensor_msgs/msg/Imu"), "tf": ("/tf_static", "tf2_msgs/msg/TFMessage")}
        is_planar = lidar_name == "planar"
        kinds["sweep"] = ("/scan", "sensor_msgs/msg/LaserScan") if is_planar else ("/points", "sensor_msgs/msg/PointCloud2")
        to = {kind: writer.add_connection(*topic, typestore=STORE) for kind, topic in kinds.items()}

        def write(kind, seconds, message):
            writer.write(to[kind], int((start + seconds) * 1e9), STORE.serialize_ros1(message, message.__msgtype__))

        pose = make("geometry_msgs/msg/Transform", translation=vector(LIDAR_IN_IMU), rotation=quaternion(LIDAR_FROM_IMU.inv()))
        transform = make("geometry_msgs/msg/TransformStamped", header=header(start + times[used[0]], "imu_link"),
                         child_frame_id="lidar", transform=pose)
        write("tf", times[used[0]], make("tf2_msgs/msg/TFMessage", transforms=[transform]))
        for seconds, kind, what in sorted(events, key=lambda event: event[0]):
            if kind == "imu":
                write(kind, seconds, imu_message(start + times[what], imu[what, 1:4], imu[what, 4:7]))
                continue
            seen, late = sweep(what, lidar, world, place, rotation)
            message = scan_message(start + what, seen, lidar[2]) if is_planar else cloud_message(start + what, seen, late)
            write(kind, seconds, message)
    with open(truth, "w") as file:
        for k in used:
            values = [start + times[k], *places[k], *rotations[k].as_quat()]
            file.write(" ".join(f"{value:.8f}" for value in values) + "\n")


if __name__ == "__main__":
    main()
