#!/usr/bin/env python3
"""Maps what a planar scanner on a vehicle would see: slices of the real 3D drives of the data folder, with nothing else but,
in kitti_0059, the IMU. Prints for each the error in the plane and the exit code.

    scripts/field_planar.py                         at 0, -1 and 1 degree of elevation, 270 and 180 degrees of view
    scripts/field_planar.py --gaps                  at 0 degrees, without the scans of 0.5 to 3.5 s, at two places each
    scripts/field_planar.py --faults                at 0 degrees, with odometry of the truth that fails
    scripts/field_planar.py --programs old/portolan target/release/portolan      in turns, side by side

The error is the root mean square of positions after alignment, at the offset in time within 0.12 s at which it is least: of
the stamps of slices only the middle of the turn is known. Needs numpy and rosbags, and the tools beside the data folder.
"""
import argparse
import pathlib
import subprocess
import sys
import tempfile

import numpy as np
from bags import add_connections
from field import REPOSITORY
from field_space import RECORDINGS, SPACE, TOOLS, map_recording
from rosbags.rosbag1 import Reader, Writer
from slice_space import FAULTS

SLICES = {
    "0 deg": [],
    "-1 deg": ["--elevation", "-1"],
    "1 deg": ["--elevation", "1"],
    "view 270": ["--view", "270", "--range", "30"],
    "view 180": ["--view", "180"],
}
DRIVES = {r.name: r for r in RECORDINGS if r.truth and r.name != "corridor_imu"}
# The lever arm from the INS of kitti_0001 to its lidar, metres.
LEVERS = {"kitti_0001": (0.81, -0.32)}
# Where gaps begin, seconds.
GAPS = {"kitti_0001": [2.0, 3.2], "kitti_0005": [1.2, 2.3], "kitti_0059": [3.0, 6.0], "street_hdl64": [6.0, 15.0]}
OFFSETS = np.arange(-0.12, 0.121, 0.01)


def poses(path):
    """Times, positions in the plane and headings of a trajectory."""
    rows = np.loadtxt(path, ndmin=2)
    x, y, z, w = rows[:, 4:8].T
    return rows[:, 0], rows[:, 1:3], np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def aligned_error(truth, estimate):
    """Root mean square distance of points after the rotation and shift that make it least."""
    truth, estimate = truth - truth.mean(0), estimate - estimate.mean(0)
    sums = estimate.T @ truth
    angle = np.arctan2(sums[0, 1] - sums[1, 0], sums[0, 0] + sums[1, 1])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.sqrt(((truth - estimate @ turn.T) ** 2).sum(1).mean())


def error(truth, trajectory, lever):
    times, places, headings = poses(truth)
    x, y = lever
    sin, cos = np.sin(headings), np.cos(headings)
    places = places + np.stack([cos * x - sin * y, sin * x + cos * y], 1)
    scan_times, scan_places, _ = poses(trajectory)
    errors = []
    for offset in OFFSETS:
        moved = scan_times + offset
        known = (moved >= times[0]) & (moved <= times[-1])
        if known.sum() > 2:
            at = [np.interp(moved[known], times, places[:, i]) for i in (0, 1)]
            errors.append(aligned_error(np.stack(at, 1), scan_places[known]))
    return min(errors, default=float("nan"))


def without_scans(source, output, begin, seconds):
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        first = reader.start_time + begin * 1e9
        for connection, time, data in reader.messages():
            if "LaserScan" not in connection.msgtype or not first <= time < first + seconds * 1e9:
                writer.write(added[connection.id], time, data)


def report(programs, name, what, bag):
    for program in programs:
        with tempfile.TemporaryDirectory() as results:
            trajectory, cost = map_recording(program, DRIVES[name], bag, results)
            metres = error(DRIVES[name].truth, trajectory, LEVERS.get(name, (0, 0))) if trajectory.exists() else float("nan")
            mark = f" [{program}]" if len(programs) > 1 else ""
            print(f"{name:13} {what:14} {cost}  {metres:7.3f} m{mark}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", nargs="+", default=[str(REPOSITORY / "target/release/portolan")])
    parser.add_argument("--drives", nargs="+", default=list(DRIVES), choices=list(DRIVES))
    parser.add_argument("--gaps", action="store_true")
    parser.add_argument("--faults", action="store_true")
    arguments = parser.parse_args()
    if not SPACE.exists() or not TOOLS.exists():
        sys.exit(f"{SPACE} or {TOOLS} is missing: set PORTOLAN_DATA to the folder of the recordings")
    with tempfile.TemporaryDirectory() as folder:
        bag, cut = pathlib.Path(folder) / "slice.bag", pathlib.Path(folder) / "cut.bag"
        for name in arguments.drives:
            slices = SLICES
            if arguments.faults:
                slices = {fault: ["--odometry", str(DRIVES[name].truth), "--fault", fault] for fault in FAULTS}
            for what, options in list(slices.items())[: 1 if arguments.gaps else None]:
                script = REPOSITORY / "scripts/slice_space.py"
                source = DRIVES[name].bag(folder)
                bag.unlink(missing_ok=True)
                subprocess.run([sys.executable, script, source, bag, *options], check=True, stdout=subprocess.DEVNULL)
                if not arguments.gaps:
                    report(arguments.programs, name, what, bag)
                    continue
                for begin in GAPS[name]:
                    for seconds in [0.5, 1, 1.5, 1.9, 2.5, 3.5]:
                        cut.unlink(missing_ok=True)
                        without_scans(bag, cut, begin, seconds)
                        report(arguments.programs, name, f"{begin} + {seconds} s", cut)


if __name__ == "__main__":
    main()
