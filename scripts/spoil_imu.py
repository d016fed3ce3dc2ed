#!/usr/bin/env python3
"""spoil_imu.py BAG OUT.bag HOW : a ROS 1 bag whose IMU is made worse, as those of other people are.

    bias       the gyroscope is off by 0.05 rad/s about each axis, the accelerometer by 0.3 m/s2 along each
    noise      0.05 rad/s and 1 m/s2 of noise on every sample
    drift      the bias of the gyroscope grows by 0.01 rad/s each second
    units      accelerations are in g
    degrees    the gyroscope is in degrees a second
    slow       ten samples a second are left
    gaps       one second in four is missing
    late       stamps are 0.3 s late
    jitter     stamps jitter by 5 ms
    stuck      from the middle on the last sample is sent again and again
    turned     mounted a quarter turn about z from what the transforms say
    tilted     mounted 10 degrees about x from what the transforms say
    upside     mounted upside down, and nobody says so
    mirrored   the gyroscope turns the wrong way round
    one+two    both

Other messages stay as they are. Needs rosbags and numpy. The seed is fixed: the same bag in every run.
"""
import sys

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
IMU = "sensor_msgs/msg/Imu"
GRAVITY = 9.81


def turn(axis, degrees):
    """A rotation about x or z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]] if axis == 0 else [[c, -s, 0], [s, c, 0], [0, 0, 1]])


MOUNTED = {"turned": turn(2, 90), "tilted": turn(0, 10), "upside": turn(0, 180)}


class Spoilt:
    """Samples one after the other; seconds count from the first."""

    def __init__(self, hows, seconds):
        self.hows, self.seconds, self.chance, self.count, self.last = hows, seconds, np.random.default_rng(7), 0, None

    def sample(self, elapsed, turns, pushes):
        """The sample made worse; none if it is missing."""
        self.count += 1
        hows, chance = self.hows, self.chance
        if "slow" in hows and self.count % 10 or "gaps" in hows and elapsed % 4 > 3:
            return None
        for how, mounted in MOUNTED.items():
            if how in hows:
                turns, pushes = mounted @ turns, mounted @ pushes
        if "bias" in hows:
            turns, pushes = turns + 0.05, pushes + 0.3
        if "noise" in hows:
            turns, pushes = turns + chance.normal(0, 0.05, 3), pushes + chance.normal(0, 1.0, 3)
        if "drift" in hows:
            turns = turns + 0.01 * elapsed
        if "units" in hows:
            pushes = pushes / GRAVITY
        if "degrees" in hows:
            turns = np.degrees(turns)
        if "mirrored" in hows:
            turns = -turns
        if "stuck" in hows and elapsed > 0.5 * self.seconds:
            return self.last
        self.last = turns, pushes
        return self.last

    def delay(self):
        """Nanoseconds by which a stamp is late."""
        late = 300_000_000 if "late" in self.hows else 0
        return late + (int(self.chance.normal(0, 5e6)) if "jitter" in self.hows else 0)


def main():
    source, output = sys.argv[1:3]
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        spoilt, first = Spoilt(sys.argv[3].split("+"), reader.duration / 1e9), reader.start_time
        for c, time, data in reader.messages():
            if c.msgtype == IMU:
                imu = STORE.deserialize_ros1(data, c.msgtype)
                turns, pushes = imu.angular_velocity, imu.linear_acceleration
                values = [np.array([v.x, v.y, v.z]) for v in (turns, pushes)]
                sample = spoilt.sample((time - first) / 1e9, *values)
                if sample is None:
                    continue
                turns.x, turns.y, turns.z = map(float, sample[0])
                pushes.x, pushes.y, pushes.z = map(float, sample[1])
                stamp = imu.header.stamp
                moved = stamp.sec * 10**9 + stamp.nanosec + spoilt.delay()
                stamp.sec, stamp.nanosec = divmod(moved, 10**9)
                data = STORE.serialize_ros1(imu, c.msgtype)
            writer.write(added[c.id], time, data)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main()
