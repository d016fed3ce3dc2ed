#!/usr/bin/env python3
"""retime_space.py BAG OUT.bag ... : a ROS 1 bag of a 3D lidar with fewer sweeps, and with other times of points or none.

    --every N          one sweep in N
    --sweeps A:B       from the A-th sweep on, before the B-th
    --times WHAT       none: the field is renamed; half, double, longer: too small, too large by two, by a half; ages: the sign is
                       wrong; wrapped, quarter, tenth: turns begin such a part of a turn off; alternating: in every other sweep
                       half a turn; mixed: those of other points of the sweep; holes: zero for every other point; zero: all alike;
                       shares: of the sweep, 0 to 1; ticks: of 55.296 us; coarse: a clock of 10 ms; late, early: half a sweep too
                       late, a whole one too early
    --by-beam          points beam by beam from ahead, counter-clockwise, as KITTI's files have them, not firing by firing
    --alone            the lidar alone, without IMU and all else

Needs rosbags and numpy. Beams are taken to lie 0.42 degrees apart, as those of an HDL-64.
"""
import argparse

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
LIDAR = "sensor_msgs/msg/PointCloud2"
TIMES = ("time", "t", "timestamp", "offset_time")
SCALES = {"half": 0.5, "double": 2.0, "ages": -1.0, "longer": 1.5}


def turned(part):
    """Times of a turn that begins such a part of a turn off."""
    return lambda times: times.min() + (times - times.min() + part * np.ptp(times)) % max(np.ptp(times), 1e-9)


OTHERS = {
    "wrapped": turned(0.5),
    "quarter": turned(0.25),
    "tenth": turned(0.1),
    "alternating": turned(0.5),
    "mixed": lambda times: np.random.default_rng(len(times)).permutation(times),
    "holes": lambda times: np.where(np.arange(len(times)) % 2, times, 0.0),
    "zero": lambda times: 0.0 * times,
    "shares": lambda times: (times - times.min()) / max(np.ptp(times), 1e-9),
    "ticks": lambda times: np.round(times / 55.296e-6),
    "coarse": lambda times: np.floor(times / 0.01) * 0.01,
    "late": lambda times: times + 0.5 * np.ptp(times),
    "early": lambda times: times - np.ptp(times),
}
CHANGES = {**{name: lambda times, scale=scale: times * scale for name, scale in SCALES.items()}, **OTHERS}
BEAM_DEGREES = 0.42


def floats(points, offset, count):
    return np.ascontiguousarray(points[:, offset : offset + 4 * count]).view("<f4")


def changed(message, times, by_beam):
    """The cloud with other times, in another order."""
    points = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step).copy()
    for field in message.fields:
        if field.name in TIMES and times in CHANGES:
            changed_times = CHANGES[times](floats(points, field.offset, 1)[:, 0]).astype("<f4")
            points[:, field.offset : field.offset + 4] = changed_times.reshape(-1, 1).view(np.uint8)
        elif field.name in TIMES and times == "none":
            field.name = "no_" + field.name
    if by_beam:
        x, y, z = floats(points, 0, 3).astype(float).T
        beam = np.round(np.degrees(np.arctan2(z, np.hypot(x, y))) / BEAM_DEGREES)
        points = points[np.lexsort((np.arctan2(y, x) % (2 * np.pi), -beam))]
    message.data = points.reshape(-1)
    return message


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag")
    parser.add_argument("out")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--sweeps", default=":")
    parser.add_argument("--times", choices=["none", *CHANGES])
    parser.add_argument("--by-beam", action="store_true")
    parser.add_argument("--alone", action="store_true")
    args = parser.parse_args()
    first, last = (int(part) if part else None for part in args.sweeps.split(":"))
    wanted = range(10**9)[first : last : 1]
    with Reader(args.bag) as reader, Writer(args.out) as writer:
        added, sweep = add_connections(reader, writer), 0
        for connection, time, data in reader.messages():
            if connection.msgtype != LIDAR:
                if not args.alone:
                    writer.write(added[connection.id], time, data)
                continue
            if sweep in wanted and sweep % args.every == 0:
                message = STORE.deserialize_ros1(data, LIDAR)
                times = None if args.times == "alternating" and sweep % 2 else args.times
                data = STORE.serialize_ros1(changed(message, times, args.by_beam), LIDAR)
                writer.write(added[connection.id], time, data)
            sweep += 1


if __name__ == "__main__":
    main()
