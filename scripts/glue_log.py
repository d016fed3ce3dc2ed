#!/usr/bin/env python3
"""glue_log.py LOG.clf.bz2 OUT.clf FROM:TO [FROM:TO ...] : pieces of a CARMEN log as one recording.

Pieces are given as fractions of the log's scans and follow each other 0.3 s apart. The odometry of each goes on where that
of the piece before ended, as if the robot had been carried from the end of one to the beginning of the next without its
wheels turning. Needs Python 3 alone.
"""
import argparse
import bz2

from field_odometry_faults import compose, inverse

GAP = 0.3


def odometry(words):
    """Pose by odometry and stamp of a FLASER message: count, ranges, laser pose, odometry pose, stamps."""
    at = 5 + int(words[1])
    return tuple(map(float, words[at : at + 3])), float(words[at + 3])


def glue(scans, pieces, output):
    end = None
    for begin, until in pieces:
        piece = scans[int(begin * len(scans)) : int(until * len(scans))]
        start_pose, start_time = odometry(piece[0])
        moved = compose(end[0], inverse(start_pose)) if end else (0.0, 0.0, 0.0)
        later = end[1] + GAP - start_time if end else 0.0
        for words in piece:
            pose, time = odometry(words)
            end = compose(moved, pose), time + later
            ranges, host = words[: 2 + int(words[1])], words[2 + int(words[1]) + 7]
            place, stamp = [f"{v:.6f}" for v in end[0]], f"{end[1]:.6f}"
            output.write(" ".join([*ranges, *place, *place, stamp, host, stamp]) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("output")
    parser.add_argument("pieces", nargs="+", type=lambda text: tuple(float(v) for v in text.split(":")))
    arguments = parser.parse_args()
    with bz2.open(arguments.log, "rt", errors="replace") as lines:
        found = [line.split() for line in lines if line.startswith("FLASER")]
    with open(arguments.output, "w") as out:
        glue(found, arguments.pieces, out)
