#!/usr/bin/env python3
"""split_sweeps.py IN.bag EVEN.bag ODD.bag : every other point cloud of a ROS 1 bag into either of two, all else into both.

Needs rosbags.
"""
import sys

from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

CLOUD = "sensor_msgs/msg/PointCloud2"


def split(source, outputs):
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(source) as reader, Writer(outputs[0]) as even, Writer(outputs[1]) as odd:
        writers = (even, odd)
        added = {}
        for connection in reader.connections:
            definition = connection.msgdef if isinstance(connection.msgdef, str) else connection.msgdef.data
            more = {"msgdef": definition, "md5sum": connection.digest} if connection.msgtype not in store.types else {"typestore": store}
            added[connection.id] = [w.add_connection(connection.topic, connection.msgtype, **more) for w in writers]
        count = 0
        for connection, time, data in reader.messages():
            is_cloud = connection.msgtype == CLOUD
            for i, writer in enumerate(writers):
                if not is_cloud or count % 2 == i:
                    writer.write(added[connection.id][i], time, data)
            count += is_cloud
    return count


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    print(split(sys.argv[1], sys.argv[2:]), "clouds")
