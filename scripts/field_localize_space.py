"""Localises the odd sweeps of every real 3D drive of the data folder in a map of its even ones: `field_localize.py --space`.

Every n-th odd sweep is a start without a start pose. The truth is the way of the map itself between its sweeps, good to
a few centimetres in bends. Needs rosbags, and what the tools that make bags need.
"""
import concurrent.futures
import csv
import math
import pathlib
import statistics
import tempfile

import field_space
from field import run
from split_sweeps import split

DRIVES = ["kitti_0001", "kitti_0005", "kitti_0059", "street_hdl64"]
# Seconds that are looked at from each start; wrong beyond metres and degrees.
SECONDS = 8.0
WRONG = (0.5, 10.0)


def read_tum(path):
    lines = [line.split() for line in pathlib.Path(path).read_text().splitlines() if line and line[0] != "#"]
    return [tuple(map(float, line)) for line in lines]


def yaw(qx, qy, qz, qw):
    return math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))


def between(way, time):
    """x, y, z, yaw between two poses of the map's way; none outside of it."""
    after = next((i for i, pose in enumerate(way) if pose[0] >= time), None)
    if after is None or after == 0:
        return None
    a, b = way[after - 1], way[after]
    share = (time - a[0]) / (b[0] - a[0])
    first, turn = yaw(*a[4:]), math.remainder(yaw(*b[4:]) - yaw(*a[4:]), 2 * math.pi)
    return [u + share * (v - u) for u, v in zip(a[1:4], b[1:4])] + [first + share * turn]


def start(program, known, odd, way, skip):
    """Seconds until found and right (none if never), longest stretch that is localised and wrong, errors, CPU seconds."""
    with tempfile.TemporaryDirectory() as results:
        more = ["--skip", f"{skip:.3f}", "--duration", SECONDS, "--threads", "1", "-q"]
        _, _, seconds, _ = run([str(w) for w in [program, "localize", known, odd, "-o", results, *more]])
        table = pathlib.Path(results) / "poses.csv"
        rows = list(csv.DictReader(table.open())) if table.exists() else []
    found, wrong_since, longest, errors = None, None, 0.0, []
    for row in rows:
        time, true = float(row["time"]), between(way, float(row["time"]))
        if row["state"] != "localised" or true is None:
            wrong_since = None
            continue
        error = math.dist(true[:3], [float(row[axis]) for axis in "xyz"])
        turn = abs(math.degrees(math.remainder(float(row["yaw"]) - true[3], 2 * math.pi)))
        if error > WRONG[0] or turn > WRONG[1]:
            wrong_since = time if wrong_since is None else wrong_since
            longest = max(longest, time - wrong_since)
            continue
        wrong_since = None
        found = time - float(rows[0]["time"]) if found is None else found
        errors.append(error)
    return found, longest, errors, seconds


def drive(program, recording, folder, every, workers, details):
    bags = [folder / f"{recording.name}_{name}.bag" for name in ("even", "odd")]
    if not bags[1].exists():
        split(recording.bag(folder), bags)
    results = folder / f"{recording.name}_map"
    if not (results / "map.pbstream").exists():
        field_space.map_recording(program, recording, bags[0], results)
    way = read_tum(results / "trajectory.tum")
    seconds = way[-1][0] - way[0][0]
    starts = [0.2 * i for i in range(0, int((seconds - 2) / 0.2), every)]
    known = results / "map.pbstream"
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        pieces = list(pool.map(lambda skip: start(program, known, bags[1], way, skip), starts))
    for skip, piece in zip(starts, pieces) if details else []:
        print(f"  from {skip:.1f} s: found after {piece[0]}, false {piece[1]:.1f} s, CPU {piece[3]:.1f} s")
    found = [piece[0] for piece in pieces if piece[0] is not None]
    errors = [error for piece in pieces for error in piece[2]]
    median = lambda values: statistics.median(values) if values else math.nan
    print(f"{recording.name:14} {len(found)} of {len(pieces)} starts found, median after {median(found):.1f} s; "
          f"false {sum(piece[1] > 2 for piece in pieces)}; error median {median(errors):.3f} m", flush=True)


def drives(program, names, folder, every, workers, details):
    recordings = [r for r in field_space.RECORDINGS if r.name in (names or DRIVES)]
    for recording in recordings:
        drive(program, recording, pathlib.Path(folder), every, workers, details)
