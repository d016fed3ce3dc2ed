#!/usr/bin/env python3
"""Recordings that go on in a known map, from starts that are right and wrong: what `map --from` says of each, and what is true.

    known_places.py PORTOLAN FOLDER KNOWN.bag NEW.bag [MORE OPTIONS OF map]       simulated, with NAME.truth.tum beside each
    known_places.py PORTOLAN FOLDER --split SECONDS LOG [MORE OPTIONS OF map]     real: the first seconds are known, the rest is new

Real logs are judged by the map of the whole log. Each line: the shift of the start (metres), exit code, median and largest error
of the trajectory (metres), and what the report says of the known map. Needs numpy.
"""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np


def poses(path):
    return np.loadtxt(path, ndmin=2)


def yaw(pose):
    x, y, z, w = pose[4:8]
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def nearest(times, of):
    return of[np.searchsorted(of[:, 0], times).clip(0, len(of) - 1)]


def alignment(source, target):
    """The planar motion (R, t, angle) that lays points of `source` onto those of `target`, least squares."""
    a, b = source.mean(0), target.mean(0)
    h = (source - a).T @ (target - b)
    angle = math.atan2(h[0, 1] - h[1, 0], h[0, 0] + h[1, 1])
    r = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return r, b - r @ a, angle


def main():
    portolan, folder, *rest = sys.argv[1:]
    folder = Path(folder)
    run = lambda *arguments: subprocess.run([portolan, "map", "-q", "--no-xray", "--force", *arguments], capture_output=True)
    if rest[0] == "--split":
        split, log, *more = rest[1:]
        first, again = [log, f"--duration={split}"], [log, f"--skip={split}"]
        run(log, "-o", folder / "whole", *more)
        truth_of_known = truth = poses(folder / "whole/trajectory.tum")
        begin = truth[0, 0] + float(split)
    else:
        known, new, *more = rest
        first, again = [known], [new]
        truth_of_known, truth = (poses(Path(bag).with_suffix("").as_posix() + ".truth.tum") for bag in (known, new))
        begin = truth[0, 0]
    run(*first, "-o", folder / "known", *more)
    mapped = poses(folder / "known/trajectory.tum")
    r, t, angle = alignment(nearest(mapped[:, 0], truth_of_known)[:, 1:3], mapped[:, 1:3])
    start = nearest(np.array([begin]), truth)[0]
    shifts = [None, (0.0, 0.0)] + [(d * math.cos(a), d * math.sin(a)) for d in (2, 5, 10) for a in (0.3, 3.4)]
    for shift in shifts:
        told = []
        if shift is not None:
            x, y = r @ start[1:3] + t + shift
            told = [f"--start={x},{y},{math.degrees(angle + yaw(start))}"]
        output = folder / "again"
        code = run(*again, "--from", folder / "known/map.pbstream", "-o", output, *told, *more).returncode
        found = poses(output / "trajectory.tum")
        errors = np.linalg.norm(nearest(found[:, 0], truth)[:, 1:3] @ r.T + t - found[:, 1:3], axis=1)
        report = json.loads((output / "report.json").read_text())["known_map"]
        shown = "none" if shift is None else f"{shift[0]:.1f},{shift[1]:.1f}"
        print(f"{shown:>10}  exit {code}  error {np.median(errors):.3f}, {errors.max():.3f}  {json.dumps(report)}", flush=True)


main()
