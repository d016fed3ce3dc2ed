#!/usr/bin/env python3
"""glue.py IN.bag OUT.bag FROM:TO [FROM:TO ...] [--gap SECONDS] : pieces of a ROS 1 bag as one recording.

Pieces are given in seconds since the beginning and follow each other SECONDS apart (0.1 unless told), as if the platform
had been carried from the end of one to the beginning of the next. Stamps are moved with the times. Needs rosbags.
"""
import argparse

from bags import add_connections
from rosbags.rosbag1 import Reader, Writer

STAMP_AT = 4  # A header begins with its sequence number; seconds and nanoseconds of the stamp follow.


def moved(data, offset):
    """A message with a header whose stamp is later by `offset` nanoseconds."""
    data = bytearray(data)
    seconds, nanoseconds = (int.from_bytes(data[i : i + 4], "little") for i in (STAMP_AT, STAMP_AT + 4))
    stamp = seconds * 10**9 + nanoseconds + offset
    data[STAMP_AT : STAMP_AT + 8] = (stamp // 10**9).to_bytes(4, "little") + (stamp % 10**9).to_bytes(4, "little")
    return bytes(data)


def glue(source, output, pieces, gap):
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        end = None
        for begin_seconds, end_seconds in pieces:
            begin = reader.start_time + int(begin_seconds * 1e9)
            offset = 0 if end is None else end + int(gap * 1e9) - begin
            for c, time, data in reader.messages():
                if "tf_static" in c.topic:
                    if end is None:
                        writer.write(added[c.id], begin, data)
                elif begin <= time < reader.start_time + int(end_seconds * 1e9):
                    writer.write(added[c.id], time + offset, moved(data, offset))
            end = reader.start_time + int(end_seconds * 1e9) + offset


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("source")
    parser.add_argument("output")
    parser.add_argument("pieces", nargs="+", type=lambda text: tuple(float(v) for v in text.split(":")))
    parser.add_argument("--gap", type=float, default=0.1)
    arguments = parser.parse_args()
    glue(arguments.source, arguments.output, arguments.pieces, arguments.gap)
