"""Localises the odd sweeps of every real 3D drive of the data folder in a map of its even ones: `field_localize.py --space`.

Every n-th odd sweep is a start without a start pose. The truth is the way of the map itself, and between its sweeps the motion
of a map of all sweeps: both scatter from sweep to sweep, by 0.01 to 0.06 degrees about each axis and by up to 0.03 m along the
street (kitti_0001), which is added to the covariances that are judged. Needs rosbags, numpy, scipy, and what the tools that make bags need.
"""
import concurrent.futures
import pathlib
import tempfile

import field_space
from field import run
from poses_3d import Way, WayBetween, errors
from split_sweeps import split
from start_figures import one_start, start_figures

DRIVES = ["kitti_0001", "kitti_0005", "kitti_0059", "street_hdl64"]
# Seconds that are looked at from each start.
SECONDS = 8.0


def start(program, known, odd, way, skip):
    """What `poses_3d.errors` gives for one start, and CPU seconds."""
    with tempfile.TemporaryDirectory() as results:
        more = ["--skip", f"{skip:.3f}", "--duration", SECONDS, "--threads", "1", "-q"]
        _, _, seconds, _ = run([str(w) for w in [program, "localize", known, odd, "-o", results, *more]])
        return {"rows": errors(results, way.at, way.scatter), "cpu": seconds}


def drive(program, recording, folder, every, workers, details):
    bags = [folder / f"{recording.name}_{name}.bag" for name in ("even", "odd")]
    if not bags[1].exists():
        split(recording.bag(folder), bags)
    results = folder / f"{recording.name}_map"
    if not (results / "map.pbstream").exists():
        field_space.map_recording(program, recording, bags[0], results)
    whole = folder / f"{recording.name}_whole"
    if not (whole / "map.pbstream").exists():
        field_space.map_recording(program, recording, recording.bag(folder), whole)
    way = Way(results / "trajectory.tum")
    truth = WayBetween(way, Way(whole / "trajectory.tum"))
    seconds = way.times[-1] - way.times[0]
    starts = [0.2 * i for i in range(0, int((seconds - 2) / 0.2), every)]
    known = results / "map.pbstream"
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        pieces = list(pool.map(lambda skip: start(program, known, bags[1], truth, skip), starts))
    for skip, piece in zip(starts, pieces) if details else []:
        print(f"  from {skip:.1f} s: {one_start(piece)}")
    print(f"{recording.name:14} {start_figures(pieces)}", flush=True)


def drives(program, names, folder, every, workers, details):
    recordings = [r for r in field_space.RECORDINGS if r.name in (names or DRIVES)]
    for recording in recordings:
        drive(program, recording, pathlib.Path(folder), every, workers, details)
