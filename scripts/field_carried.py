#!/usr/bin/env python3
"""Maps pairs of pieces of real planar logs, glued as if the robot had been carried from one to the other without its wheels
turning, and prints where the second piece lies.

    scripts/field_carried.py [--program target/release/portolan] [--logs aces,intel]

The first piece is put over the reference poses; the figure is how far each piece lies from them then, the median in metres.
Needs Python 3 alone. The data folder is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import bisect
import bz2
import cmath
import pathlib
import statistics
import subprocess
import tempfile

from field import REPOSITORY, data_folder
from glue_log import glue, odometry

# Pieces as fractions of the scans: those on which the rules were chosen, and others.
CHOSEN = [
    ("intel", (0, 0.2), (0.5, 0.6)), ("intel", (0.3, 0.45), (0.8, 0.9)), ("aces", (0.1, 0.4), (0.75, 0.95)),
    ("aces", (0, 0.3), (0.6, 0.8)), ("fr079", (0, 0.3), (0.5, 0.7)), ("mit-csail", (0, 0.4), (0.6, 0.9)),
    ("mit-csail", (0.2, 0.6), (0.05, 0.2)), ("orebro", (0, 0.4), (0.6, 0.9)), ("fhw", (0, 0.3), (0.6, 0.8)),
    ("fr101-rawodo", (0, 0.4), (0.6, 0.9)),
]
OTHERS = [
    ("fr101-rawodo", (0.5, 0.9), (0, 0.3)), ("intel", (0.1, 0.25), (0.7, 0.8)), ("aces", (0.5, 0.7), (0.05, 0.2)),
    ("fr079", (0.6, 0.9), (0.1, 0.3)), ("intel", (0.6, 0.75), (0.1, 0.2)), ("mit-csail", (0.5, 0.9), (0.1, 0.3)),
]
# References farther apart than this tell nothing between them, seconds.
LONGEST = 8.0


def reference(log):
    """Times and places, as complex numbers, of the reference poses."""
    rows = [line.split(",") for line in open(log.parent / "reference_poses.csv") if line[0] != "#"]
    poses = sorted((float(row[0]), complex(float(row[2]), float(row[3]))) for row in rows)
    return [time for time, _ in poses], [place for _, place in poses]


def place_at(times, places, time):
    i = bisect.bisect(times, time)
    if not 0 < i < len(times) or times[i] - times[i - 1] > LONGEST:
        return None
    share = (time - times[i - 1]) / (times[i] - times[i - 1])
    return places[i - 1] + share * (places[i] - places[i - 1])


def mapped(program, log, recording, folder):
    """Seconds since the first scan and places of all scans, the exit code, and what was said of losses."""
    tracking = ["--tracking-frame", "laser"] if "fr079" in log.name else []
    command = [program, "map", recording, *tracking, "-o", folder, "--force", "--no-xray"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [[float(v) for v in line.split()] for line in open(folder / "trajectory.tum")]
    scans = {round(row[0] - rows[0][0], 3): complex(row[1], row[2]) for row in rows}
    said = [line for line in (run.stderr + run.stdout).splitlines() if line.startswith("lost from")]
    return scans, run.returncode, said[:1]


def distances(scans, times, pieces, found):
    """How far the scans of each piece lie from the reference, which the first piece is put over."""
    pairs = [[], []]
    for (piece, time), seconds in zip(pieces, times):
        place, right = scans.get(round(seconds - times[0], 3)), place_at(*found, time)
        if place is not None and right is not None:
            pairs[piece].append((place, right))
    (a, b) = [sum(of) / len(pairs[0]) for of in zip(*pairs[0])]
    turn = cmath.phase(sum((right - b) * (place - a).conjugate() for place, right in pairs[0]))
    put = lambda place: cmath.rect(1.0, turn) * (place - a) + b
    return [statistics.median(abs(put(place) - right) for place, right in of) for of in pairs]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=REPOSITORY / "target/release/portolan")
    parser.add_argument("--logs")
    arguments = parser.parse_args()
    wanted = arguments.logs.split(",") if arguments.logs else None
    with tempfile.TemporaryDirectory() as work:
        work = pathlib.Path(work)
        for name, *pieces in CHOSEN + OTHERS:
            if wanted and name not in wanted:
                continue
            log = data_folder() / f"lidar2d/{name}/{name}.clf.bz2"
            with bz2.open(log, "rt", errors="replace") as lines:
                all_scans = [line.split() for line in lines if line.startswith("FLASER")]
            recording = work / "glued.clf"
            with open(recording, "w") as output:
                glue(all_scans, pieces, output)
            stamps = [odometry(words)[1] for words in all_scans]
            n = len(stamps)
            of = [(i, t) for i, (f, u) in enumerate(pieces) for t in stamps[int(f * n) : int(u * n)]]
            times = [odometry(line.split())[1] for line in open(recording)]
            scans, code, said = mapped(arguments.program, log, recording, work / "map")
            first, second = distances(scans, times, of, reference(log))
            ends = " ".join(f"{f:g}-{u:g}" for f, u in pieces)
            print(f"{name:14}{ends:20} {first:6.2f} m {second:7.2f} m  exit {code}  {' '.join(said)}", flush=True)


if __name__ == "__main__":
    main()
