#!/usr/bin/env python3
"""turn_space.py BAG OUT.bag HOW : a ROS 1 bag of a spinning 3D lidar, driven or cut otherwise.

    backwards   sweeps in the opposite order, and mirrored (y to -y), so that the lidar still turns clockwise
    seam        sweeps cut half a turn later: what begins behind begins ahead
    ahead       driven backwards, looking the way it drives (turned by half a turn about z)

For clouds with the field `time`, seconds after the stamp, as ../tools/street_to_bag.py makes them; there must be no other
messages. Needs rosbags and numpy.
"""
import sys

import numpy as np
from bags import add_connections
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
LIDAR = "sensor_msgs/msg/PointCloud2"


class Sweep:
    """Points of a cloud as rows of bytes, and its stamp in nanoseconds."""

    def __init__(self, cloud):
        self.cloud, stamp = cloud, cloud.header.stamp
        self.stamp = stamp.sec * 10**9 + stamp.nanosec
        self.rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(-1, cloud.point_step).copy()
        self.offsets = {field.name: field.offset for field in cloud.fields}

    def get(self, name):
        at = self.offsets[name]
        return np.frombuffer(self.rows[:, at : at + 4].tobytes(), np.float32).astype(float)

    def set(self, name, values):
        at = self.offsets[name]
        self.rows[:, at : at + 4] = np.frombuffer(values.astype(np.float32).tobytes(), np.uint8).reshape(-1, 4)

    def message(self):
        cloud = self.cloud
        cloud.header.stamp.sec, cloud.header.stamp.nanosec = divmod(self.stamp, 10**9)
        cloud.data = np.frombuffer(self.rows.tobytes(), np.uint8)
        cloud.height, cloud.width, cloud.row_step = 1, len(self.rows), self.rows.size
        return STORE.serialize_ros1(cloud, LIDAR)


def backwards(sweeps, is_turned):
    mirror = sweeps[0].stamp + sweeps[-1].stamp
    for sweep in reversed(sweeps):
        times = sweep.get("time")
        sweep.stamp = mirror - sweep.stamp - int(times.max() * 1e9)
        sweep.set("time", times.max() - times)
        if is_turned:
            sweep.set("x", -sweep.get("x"))
        else:
            sweep.set("y", -sweep.get("y"))
        sweep.rows = np.ascontiguousarray(sweep.rows[::-1])
        yield sweep


def cut_later(sweeps):
    for sweep, following in zip(sweeps, sweeps[1:]):
        cut = sweep.get("time").max() / 2
        late, early = sweep.get("time") >= cut, following.get("time") < cut
        begin = sweep.stamp + int(cut * 1e9)
        rest = following.get("time")[early] + (following.stamp - begin) * 1e-9
        times = np.concatenate([sweep.get("time")[late] - cut, rest])
        sweep.rows = np.concatenate([sweep.rows[late], following.rows[early]])
        sweep.set("time", times)
        sweep.stamp = begin
        yield sweep


def main():
    source, output, how = sys.argv[1:]
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        read = [(c, Sweep(STORE.deserialize_ros1(raw, c.msgtype))) for c, _, raw in reader.messages()]
        connection, sweeps = added[read[0][0].id], [sweep for _, sweep in read]
        for sweep in cut_later(sweeps) if how == "seam" else backwards(sweeps, how == "ahead"):
            writer.write(connection, sweep.stamp, sweep.message())


if __name__ == "__main__":
    if len(sys.argv) != 4 or sys.argv[3] not in ("backwards", "seam", "ahead"):
        sys.exit(__doc__)
    main()
