#!/usr/bin/env python3
"""there_and_back.py BAG OUT.bag [--ahead] [--reversed] [--pause SECONDS] [--truth IN.tum OUT.tum] : a drive that comes back the way it went.

Odd sweeps of a 3D lidar come as they are, then even ones in the opposite order, as if the platform reversed along its whole
way: every place is met again, by another sweep than the first time. With --ahead it looks the way it drives on its way
back (turned by half a turn about z). IMU samples are mirrored in time with the sweeps, and stay those of an IMU mounted as before;
where it tells frames, /tf_static stays, all else goes. The way back begins SECONDS
(0.1 unless told) after the end. --truth writes the trajectory of both ways from one of the way there. Clouds without the
field `time` keep their points in the opposite order. Needs rosbags and numpy.
"""
import argparse

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from turn_space import LIDAR, STORE, Sweep

IMU = "sensor_msgs/msg/Imu"


def turned(sweep):
    """The sweep of a lidar that looks the other way."""
    for axis in "xy":
        sweep.set(axis, -sweep.get(axis))


def on_the_way_back(sweep, mirror, looks_ahead):
    if "time" in sweep.offsets:
        times = sweep.get("time")
        sweep.stamp = mirror - sweep.stamp - int(times.max() * 1e9)
        sweep.set("time", times.max() - times)
    else:
        sweep.stamp = mirror - sweep.stamp
    if looks_ahead:
        turned(sweep)
    sweep.rows = np.ascontiguousarray(sweep.rows[::-1])
    return sweep


def imu_on_the_way_back(raw, mirror, looks_ahead):
    sample = STORE.deserialize_ros1(raw, IMU)
    stamp = sample.header.stamp
    time = mirror - stamp.sec * 10**9 - stamp.nanosec
    stamp.sec, stamp.nanosec = divmod(time, 10**9)
    turn, force = sample.angular_velocity, sample.linear_acceleration
    sign = -1.0 if looks_ahead else 1.0
    turn.x, turn.y, turn.z = -sign * turn.x, -sign * turn.y, -turn.z
    force.x, force.y = sign * force.x, sign * force.y
    return time, STORE.serialize_ros1(sample, IMU)


def convert(source, output, looks_ahead, pause, is_reversed):
    """Gives the stamp at which time is mirrored, twice, in nanoseconds."""
    messages = []
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        read = [(c, raw) for c, _, raw in reader.messages()]
        sweeps = [(c, Sweep(STORE.deserialize_ros1(raw, LIDAR))) for c, raw in read if c.msgtype == LIDAR]
        first, last = sweeps[0][1].stamp, sweeps[-1][1].stamp
        mirror = 2 * first - int(pause * 1e9) if is_reversed else 2 * last + int(pause * 1e9)
        for number, (c, sweep) in enumerate(sweeps):
            if number % 2 == 0:
                messages.append((sweep.stamp, c, sweep.message()))
            else:
                back = on_the_way_back(sweep, mirror, looks_ahead)
                messages.append((back.stamp, c, back.message()))
        messages.extend((min(first, mirror - last), c, raw) for c, raw in read if c.topic == "/tf_static")
        for c, raw in ((c, raw) for c, raw in read if c.msgtype == IMU):
            sample = STORE.deserialize_ros1(raw, IMU)
            time = sample.header.stamp.sec * 10**9 + sample.header.stamp.nanosec
            if first <= time <= last:
                messages.append((time, c, raw))
                time, raw = imu_on_the_way_back(raw, mirror, looks_ahead)
                messages.append((time, c, raw))
        for time, c, raw in sorted(messages, key=lambda message: message[0]):
            writer.write(added[c.id], time, raw)
    return mirror


def write_truth(source, output, mirror, looks_ahead):
    poses = [line.split() for line in open(source) if line.strip() and not line.startswith("#")]
    middle = mirror / 2e9
    there = [pose for pose in poses if (float(pose[0]) < middle) == (float(poses[0][0]) < middle)]
    with open(output, "w") as out:
        lines = [(float(pose[0]), " ".join(pose)) for pose in there]
        for time, x, y, z, qx, qy, qz, qw in there:
            rotation = [float(q) for q in (qx, qy, qz, qw)]
            if looks_ahead:
                # Times a half turn about z of its own.
                a, b, c, d = rotation
                rotation = [b, -a, d, -c]
            words = [x, y, z, *(f"{q:.9f}" for q in rotation)]
            time = mirror / 1e9 - float(time)
            lines.append((time, f"{time:.9f} {' '.join(words)}"))
        out.writelines(f"{line}\n" for _, line in sorted(lines))


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("source")
    parser.add_argument("output")
    parser.add_argument("--ahead", action="store_true")
    parser.add_argument("--reversed", action="store_true")
    parser.add_argument("--pause", type=float, default=0.1)
    parser.add_argument("--truth", nargs=2)
    arguments = parser.parse_args()
    mirror = convert(arguments.source, arguments.output, arguments.ahead, arguments.pause, arguments.reversed)
    if arguments.truth:
        write_truth(*arguments.truth, mirror, arguments.ahead)


if __name__ == "__main__":
    main()
