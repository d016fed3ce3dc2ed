#!/usr/bin/env python3
"""How much of what a planar scanner saw is in the picture of the map: the fraction of readings that end at a drawn wall.

    scripts/walls.py aces.clf.bz2 aces_map        a CARMEN log and the folder that `portolan map` made from it

A reading up to 15 m counts as explained if a cell darker than the yaml's threshold lies within 0.1 m of where it ends, with
the scan at its pose of trajectory.tum. Every tenth scan is looked at. Where the first beam of a log points is not
written in it, so -90, -89.75 and -89.5 degrees are tried. Needs Python 3 alone.
"""
import argparse
import bisect
import bz2
import math
import pathlib
import re

FARTHEST, NEAR = 15.0, 0.1
FIRST_BEAMS = (-90.0, -89.75, -89.5)


class Walls:
    """The cells of a map's picture that lie near a wall."""

    def __init__(self, folder):
        words = (folder / "map.yaml").read_text()
        number = lambda key: float(re.search(key + r"\D*?(-?[\d.]+)", words)[1])
        self.resolution = number("resolution")
        self.x, self.y = map(float, re.search(r"origin: \[([-\d.]+), ([-\d.]+)", words).groups())
        darkest = 255.0 * (1.0 - number("occupied_thresh"))
        data = (folder / "map.pgm").read_bytes()
        header = re.match(rb"P5\s(?:#.*\n)?\s*(\d+)\s+(\d+)\s+(\d+)\s", data)
        self.width, self.height = int(header[1]), int(header[2])
        pixels, reach = data[header.end() :], round(NEAR / self.resolution)
        self.near = set()
        for index, value in enumerate(pixels):
            if value < darkest:
                row, column = divmod(index, self.width)
                for dy in range(-reach, reach + 1):
                    self.near.update((row + dy) * self.width + column + dx for dx in range(-reach, reach + 1))

    def explain(self, x, y):
        column = math.floor((x - self.x) / self.resolution)
        row = self.height - 1 - math.floor((y - self.y) / self.resolution)
        return row * self.width + column in self.near


def read_trajectory(path):
    """Times, and x, y, heading."""
    rows = [list(map(float, line.split())) for line in path.read_text().splitlines()]
    return [r[0] for r in rows], [(r[1], r[2], 2 * math.atan2(r[6], r[7])) for r in rows]


def read_scans(log, every):
    """Time and ranges of every so manieth scan of the log."""
    count = 0
    with (bz2.open if str(log).endswith(".bz2") else open)(log, "rt", errors="replace") as lines:
        for line in lines:
            if line.startswith("FLASER"):
                count += 1
                if count % every == 0:
                    words = line.split()
                    n = int(words[1])
                    yield float(words[8 + n]), list(map(float, words[2 : 2 + n]))


def explained(walls, scans, times, poses, first_beam):
    hits = readings = 0
    # Logs that count from zero are moved by this.
    moved = 1e9 if times[0] >= 1e9 > scans[0][0] else 0.0
    for time, ranges in scans:
        index = bisect.bisect_left(times, time + moved - 0.03)
        if index == len(times) or times[index] > time + moved + 0.03:
            continue
        x, y, heading = poses[index]
        step = 180.0 / (len(ranges) - len(ranges) % 2)
        for i, distance in enumerate(ranges):
            if 0.3 < distance < FARTHEST:
                angle = heading + math.radians(first_beam + i * step)
                readings += 1
                hits += walls.explain(x + distance * math.cos(angle), y + distance * math.sin(angle))
    return hits / max(readings, 1), readings


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=pathlib.Path)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--every", type=int, default=10, help="look at one scan in so many")
    arguments = parser.parse_args()
    walls = Walls(arguments.folder)
    times, poses = read_trajectory(arguments.folder / "trajectory.tum")
    scans = list(read_scans(arguments.log, arguments.every))
    fraction, readings = max(explained(walls, scans, times, poses, first) for first in FIRST_BEAMS)
    print(f"{arguments.folder}: {100 * fraction:.1f} % of {readings} readings end at a wall of the map")


if __name__ == "__main__":
    main()
