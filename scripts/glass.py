#!/usr/bin/env python3
"""glass.py LOG.clf.bz2 RESULTS OUT.clf [--share 0.25] [--mirrors] : a CARMEN log as of a building with panes of glass, or mirrors.

RESULTS is what `portolan map LOG --tracking-frame laser -o RESULTS` wrote: trajectory and map tell where each beam ends and what
stands behind that. Walls are divided into panes of 2 m, of which a share is glass. A scanner sees a pane only where its beams
meet it within 12 degrees of the normal; others go on to what stands behind it, as far as the map knows that, or see nothing.
Mirrors turn all other beams back: what they show lies behind the wall as far as the beam goes on in front of it.
Odometry stays as it is. Needs numpy and pillow. The same log in every run.
"""
import argparse
import bz2
import pathlib
import re

import numpy as np
from PIL import Image

PANE = 2.0
SEEN_WITHIN = np.radians(12.0)
FARTHEST = 25.0
NOTHING = 81.83
# Of probabilities as map_server draws them: darker is solid.
SOLID = 100


class Map:
    """Where the map is solid, in cells of `resolution` metres; `origin` is the lower left corner."""

    def __init__(self, folder):
        text = (folder / "map.yaml").read_text()
        number = r"[-+0-9.eE]+"
        self.resolution = float(re.search(rf"resolution:\s*({number})", text)[1])
        self.origin = np.array([float(x) for x in re.search(r"origin:\s*\[([^\]]*)\]", text)[1].split(",")[:2]])
        self.solid = np.flipud(np.array(Image.open(folder / "map.pgm"))) < SOLID

    def is_solid(self, points):
        cells = np.floor((points - self.origin) / self.resolution).astype(int)
        height, width = self.solid.shape
        inside = (cells[..., 0] >= 0) & (cells[..., 0] < width) & (cells[..., 1] >= 0) & (cells[..., 1] < height)
        x, y = np.clip(cells[..., 0], 0, width - 1), np.clip(cells[..., 1], 0, height - 1)
        return inside & self.solid[y, x]

    def ways(self, starts, directions):
        """How far it is from each start to something solid, metres; infinite if farther than `FARTHEST`."""
        steps = np.arange(0.0, FARTHEST, self.resolution)
        hit = self.is_solid(starts[:, None, :] + steps[None, :, None] * directions[:, None, :])
        return np.where(hit.any(axis=1), steps[hit.argmax(axis=1)], np.inf)


def is_pane(points, share):
    """Whether there is glass in the wall at these points."""
    cells = np.floor(points / PANE).astype(np.int64)
    mixed = (cells[:, 0] * 73856093) ^ (cells[:, 1] * 19349663)
    mixed = (mixed ^ (mixed >> 13)) * 1274126177 % (1 << 31)
    return mixed % 1000 < 1000 * share


def normals(ends):
    """Directions across the wall at the ends of beams that lie side by side."""
    along = np.roll(ends, -1, axis=0) - np.roll(ends, 1, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)


def through_panes(ranges, pose, walls, share, mirrors):
    """What a scanner at a pose (x, y, yaw) measures."""
    angles = pose[2] + (np.arange(len(ranges)) / len(ranges) - 0.5) * np.pi
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = pose[:2] + ranges[:, None] * directions
    normal = normals(ends)
    slope = (normal * directions).sum(axis=1)
    turned = (ranges < 60.0) & is_pane(ends, share) & (np.abs(slope) < np.cos(SEEN_WITHIN))
    onward = directions - 2.0 * slope[:, None] * normal if mirrors else directions
    # Walls are rough: what stands behind begins half a metre on.
    skipped = 0.5
    further = walls.ways(ends[turned] + skipped * onward[turned], onward[turned]) + skipped
    measured = ranges.copy()
    measured[turned] = np.where(np.isfinite(further), ranges[turned] + further, NOTHING)
    return measured


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=pathlib.Path)
    parser.add_argument("results", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--share", type=float, default=0.25, help="of the walls, 0 to 1")
    parser.add_argument("--mirrors", action="store_true", help="mirrors in place of glass")
    arguments = parser.parse_args()
    walls = Map(arguments.results)
    poses = np.loadtxt(arguments.results / "trajectory.tum", usecols=(0, 1, 2, 6, 7))
    times, yaws = poses[:, 0], 2.0 * np.arctan2(poses[:, 3], poses[:, 4])
    log = bz2.open(arguments.log, "rt", errors="replace")
    changed = measured = 0
    with log as lines, open(arguments.output, "w") as out:
        for line in lines:
            if line.startswith("FLASER"):
                words = line.split()
                n, stamp = int(words[1]), float(words[-3])
                # Times below 1e8 s count from the start, and `map` moves them by 1e9.
                stamp += 1e9 if stamp < 1e8 else 0.0
                i = int(np.argmin(np.abs(times - stamp)))
                if abs(times[i] - stamp) < 0.05:
                    ranges = np.array([float(w) for w in words[2 : 2 + n]])
                    new = through_panes(ranges, (*poses[i, 1:3], yaws[i]), walls, arguments.share, arguments.mirrors)
                    changed, measured = changed + int((new != ranges).sum()), measured + n
                    line = " ".join(["FLASER", str(n), *(f"{r:.3f}" for r in new), *words[2 + n :]]) + "\n"
            out.write(line)
    print(f"{changed} of {measured} readings changed")


if __name__ == "__main__":
    main()
