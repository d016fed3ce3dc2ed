#!/usr/bin/env python3
"""Are real drives found again in maps of 3D? The way there is the known map, the way back is new.

    known_drives.py PORTOLAN FOLDER DRIVE.bag [DRIVE.bag ...]

Of each drive `there_and_back.py` makes two recordings, one that comes back backwards and one that comes back looking ahead (not of
drives with an IMU, which would be elsewhere on a car that is turned about its lidar). Their first
halves are mapped, and the rest is looked for there with `map --from`, from its beginning and from 30 % and 60 % of it on. Each line:
drive, start, exit code, median and largest distance (metres) of poses from where the way there passed the same place, with the shift
of time (seconds, multiples of 0.01) at which the median is least: clouds without times of points have other stamps on the way back; CPU
seconds; and what the report says of the place. Then each drive is looked for in the maps of all others, where it must not be found.
Needs numpy and rosbags.
"""

import json
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Reader

SCRIPTS = Path(__file__).parent
WAYS = {"backwards": [], "ahead": ["--ahead"]}


def half_of(bag):
    """Seconds from the first message to the turn."""
    with Reader(bag) as reader:
        return (reader.end_time - reader.start_time) / 2e9


def ways_of(bag):
    with Reader(bag) as reader:
        has_imu = any(connection.msgtype == "sensor_msgs/msg/Imu" for connection in reader.connections)
    return ["backwards"] if has_imu else list(WAYS)


def run(portolan, bag, output, *options):
    """Exit code and CPU seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    command = [portolan, "map", bag, "-o", output, "--force", "--no-xray", "--quiet", *options]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    code = subprocess.run([str(word) for word in command], check=False, **quiet).returncode
    return code, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


def trajectory(folder):
    return np.loadtxt(folder / "trajectory.tum", ndmin=2)


def distances(known, new, mirror):
    """Of new poses from where the way there was at the mirrored time."""
    times = mirror - new[:, 0]
    is_met = (times >= known[0, 0]) & (times <= known[-1, 0])
    there = np.array([np.interp(times[is_met], known[:, 0], known[:, k]) for k in (1, 2, 3)]).T
    return np.linalg.norm(new[is_met, 1:4] - there, axis=1)


def judged(known, new, turn):
    shifts = np.arange(-50, 51) / 100
    errors = {shift: distances(known, new, 2 * turn + shift) for shift in shifts}
    best = min(shifts, key=lambda shift: np.median(errors[shift]) if len(errors[shift]) else np.inf)
    error = errors[best]
    return f"{np.median(error):.3f} m, at most {error.max():.3f} m, shifted by {best:.2f} s" if len(error) else "nothing in common"


def main():
    portolan, folder, *drives = sys.argv[1:]
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    drives = {Path(drive).stem: drive for drive in drives}
    for name, drive in drives.items():
        for way in ways_of(drive):
            bag = folder / f"{name}.{way}.bag"
            if not bag.exists():
                subprocess.run([sys.executable, SCRIPTS / "there_and_back.py", drive, bag, *WAYS[way]], check=True)
        half = half_of(folder / f"{name}.backwards.bag")
        run(portolan, folder / f"{name}.backwards.bag", folder / f"{name}.known", "--duration", half - 0.2)
    for name in drives:
        known = folder / f"{name}.known"
        for way in ways_of(drives[name]):
            bag = folder / f"{name}.{way}.bag"
            half = half_of(bag)
            with Reader(bag) as reader:
                turn = reader.start_time / 1e9 + half
            for share in (0.0, 0.3, 0.6):
                output = folder / f"{name}.{way}.{share}"
                start = half * (1 + share) + 0.3
                code, cpu = run(portolan, bag, output, "--skip", start, "--from", known / "map.pbstream", "--frozen")
                error = "no trajectory"
                if (output / "trajectory.tum").exists():
                    error = judged(trajectory(known), trajectory(output), turn)
                place = json.loads((output / "report.json").read_text())["known_map"]
                found = f"{place['place']}, {place['confirmed']} of {place['places']} confirmed"
                print(f"{name} {way} {share:.0%}: exit {code}, {error}, {cpu:.0f} CPU-s; {found}", flush=True)
    for name in drives:
        for other in drives:
            if other != name:
                bag, known = folder / f"{other}.backwards.bag", folder / f"{name}.known" / "map.pbstream"
                half = half_of(bag)
                code, cpu = run(portolan, bag, folder / "other", "--skip", half + 0.3, "--from", known, "--frozen")
                print(f"{other} in the map of {name}: exit {code}, {cpu:.0f} CPU-s", flush=True)


if __name__ == "__main__":
    main()
