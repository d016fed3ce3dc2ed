#!/usr/bin/env python3
"""g2o_to_log.py GRAPH.g2o OUT.clf OUT.relations [--all OUT2.relations] [--doubtful FROM:TO]
A planar pose graph with scans as a CARMEN log.

For graphs with VERTEX_SE2 and ROBOTLASER1 lines, one scan a vertex, such as killian.g2o (MIT, Killian Court, 1.9 km, 3,873
scans; in the Python package rtb-data). Odometry is the chain of edges from vertex to vertex, which drifts; relations are the
other edges; those of --all are between vertices up to 8 m apart, as the poses of the graph have them. Relations of one scan
from FROM to TO, seconds, and one outside are left out: in killian.g2o, scans from 4030 to 4345 s lie 1.7 m along a corridor
from where they show the same walls as others (--doubtful 4030:4345). Needs Python 3 alone.
"""
import argparse
import math
import random


def composed(a, b):
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], math.remainder(a[2] + b[2], 2 * math.pi)


def between(a, b):
    cos, sin = math.cos(a[2]), math.sin(a[2])
    x, y = b[0] - a[0], b[1] - a[1]
    return cos * x + sin * y, -sin * x + cos * y, math.remainder(b[2] - a[2], 2 * math.pi)


def read(path):
    """Poses, scans as (readings, seconds), steps by vertex, and the other edges."""
    poses, scans, steps, loops = [], [], {}, []
    for line in open(path):
        words = line.split()
        if words[:1] == ["VERTEX_SE2"]:
            poses.append(tuple(map(float, words[2:5])))
        elif words[:1] == ["ROBOTLASER1"]:
            count = int(words[8])
            scans.append((words[9:9 + count], float(words[-1])))
        elif words[:1] == ["EDGE_SE2"]:
            i, j = int(words[1]), int(words[2])
            motion = tuple(map(float, words[3:6]))
            if j == i + 1:
                steps[i] = motion
            else:
                loops.append((i, j, motion))
    return poses, scans, steps, loops


def seconds_span(text):
    first, last = map(float, text.split(":"))
    return first, last


def is_doubtful(seconds, span):
    """Whether one scan is of the span, and the other is not."""
    inside = [span is not None and span[0] < s < span[1] for s in seconds]
    return inside[0] != inside[1]


def write_relations(path, relations, scans, doubtful):
    with open(path, "w") as out:
        for i, j, (x, y, turn) in relations:
            seconds = scans[i][1], scans[j][1]
            if not is_doubtful(seconds, doubtful):
                out.write(f"{seconds[0]:.6f} {seconds[1]:.6f} {x:.5f} {y:.5f} 0 0 0 {turn:.6f}\n")


def neighbours(poses):
    """Up to three vertices within 8 m of each, taken at random."""
    chosen = random.Random(2)
    for i, a in enumerate(poses):
        near = [j for j, b in enumerate(poses) if math.hypot(a[0] - b[0], a[1] - b[1]) < 8]
        for j in sorted(chosen.sample(near, min(3, len(near)))):
            if j > i:
                yield i, j, between(a, poses[j])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("graph")
    parser.add_argument("log")
    parser.add_argument("relations")
    parser.add_argument("--all")
    parser.add_argument("--doubtful", type=seconds_span, metavar="FROM:TO")
    arguments = parser.parse_args()
    poses, scans, steps, loops = read(arguments.graph)
    odometry = [(0.0, 0.0, 0.0)]
    for i in range(len(poses) - 1):
        odometry.append(composed(odometry[-1], steps.get(i) or between(poses[i], poses[i + 1])))
    with open(arguments.log, "w") as out:
        for (readings, seconds), pose in zip(scans, odometry):
            place = "%.6f %.6f %.6f" % pose
            out.write(f"FLASER {len(readings)} {' '.join(readings)} {place} {place} {seconds:.6f} robot {seconds:.6f}\n")
    write_relations(arguments.relations, loops, scans, arguments.doubtful)
    if arguments.all:
        write_relations(arguments.all, neighbours(poses), scans, arguments.doubtful)


if __name__ == "__main__":
    main()
