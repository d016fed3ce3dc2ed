#!/usr/bin/env python3
"""Maps and refines every real 3D recording of the data folder and prints one table: errors, CPU, memory.

    scripts/field_space.py                          map
    scripts/field_space.py --starts                 the first ten steps, begun at 0, 0.2, ... 2 s
    scripts/field_space.py --spoilt lines lines+front ...   made worse by spoil_space.py
    scripts/field_space.py --refine                 refinement of own trajectories and of those in the data folder
    scripts/field_space.py --programs old/portolan target/release/portolan      in turns, side by side

The errors are judged by the tools beside the data folder (../tools), which need numpy and scipy; those that make bags
of other formats need rosbags and pillow. The data folder is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import json
import pathlib
import re
import subprocess
import sys
import tempfile

from field import REPOSITORY, data_folder, run

SPACE = data_folder() / "lidar3d"
TOOLS = data_folder().parent / "tools"
LEVER = "--lever=0.81,-0.32,0.80"


class Recording:
    """A recording, what makes a bag of it, and what is known of its truth."""

    def __init__(self, name, source, converter=None, truth=None, lever=None, given=None, judge="position"):
        self.name, self.source, self.converter, self.judge = name, SPACE / source, converter, judge
        self.truth = truth and SPACE / truth
        self.given = given and SPACE / given
        self.lever = [lever] if lever else []

    def bag(self, folder):
        if not self.converter:
            return self.source
        bag = pathlib.Path(folder) / f"{self.name}.bag"
        if not bag.exists():
            python(self.converter, self.source, bag)
        return bag


RECORDINGS = [
    Recording("kitti_0001", "kitti_0001.bag", truth="kitti_0001.truth.tum", lever=LEVER, given="kitti_0001.kiss_icp.tum"),
    Recording("kitti_0005", "kitti_0005.bag", truth="kitti_0005.truth.tum", given="kitti_0005.kiss_icp.tum"),
    Recording("kitti_0059", "kitti_0059", "kitti_imu_to_bag.py", truth="kitti_0059/truth.tum", judge="level"),
    Recording(
        "street_hdl64",
        "street_hdl64",
        "street_to_bag.py",
        truth="street_hdl64/kiss_icp.tum",
        given="street_hdl64/kiss_icp.tum",
        judge="height",
    ),
    Recording("keyframes_os0", "keyframes_os0.bag", given="keyframes_os0.input.tum", judge="planes"),
    Recording("corridor_imu", "corridor_imu.bag", truth="corridor_imu.truth.tum"),
]


def python(tool, *arguments):
    """What a judge prints."""
    command = [sys.executable, TOOLS / tool, *arguments]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()


def judged(recording, trajectory):
    """The errors of a trajectory in words."""
    if not trajectory.exists():
        return "no trajectory"
    if recording.judge == "planes":
        return python("plane_deviation.py", recording.source, f"x={trajectory}").splitlines()[-1]
    if recording.judge == "height":
        poses = [line.split() for line in trajectory.read_text().splitlines() if line and line[0] != "#"]
        return f"end {float(poses[-1][3]) - float(poses[0][3]):.2f} m above the start"
    position = json.loads(python("ate.py", recording.truth, trajectory, "--se3", "--interp", *recording.lever))
    words = [f"{position['ate_rmse']:.4f} m"]
    heading = re.search(r"heading rms ([\d.]+)", python("steps.py", recording.truth, trajectory, *recording.lever))
    words += [f"heading {heading[1]} deg"] if heading else []
    if recording.judge == "level":
        words += [line for line in python("level.py", recording.truth, trajectory).splitlines() if "rms" in line]
    return ", ".join(words)


def map_recording(program, recording, bag, results, more=()):
    code, _, seconds, megabytes = run([program, "map", bag, "-o", results, "-q", "--no-xray", *more])
    return pathlib.Path(results) / "trajectory.tum", f"{seconds:7.1f} CPU-s {megabytes:6.0f} MB  exit {code}"


def table(programs, bags):
    for recording in RECORDINGS:
        for program in programs:
            with tempfile.TemporaryDirectory() as results:
                trajectory, cost = map_recording(program, recording, recording.bag(bags), results)
                name = recording.name + (f" [{program}]" if len(programs) > 1 else "")
                print(f"{name:16} {cost}  {judged(recording, trajectory)}", flush=True)


def starts(program, bags):
    """The first ten steps from several starts: the ratio of their sum to the truth's, and the worst of them. Of corridor_imu,
    which begins at rest, a ratio would say nothing."""
    for recording in [r for r in RECORDINGS if r.truth and r.name != "corridor_imu"]:
        for start in [0.2 * i for i in range(11)]:
            with tempfile.TemporaryDirectory() as results:
                more = ["--skip", f"{start:.1f}", "--duration", "2.5"]
                trajectory, _ = map_recording(program, recording, recording.bag(bags), results, more)
                steps = python("steps.py", recording.truth, trajectory, *recording.lever).splitlines()
                print(f"{recording.name:14} from {start:.1f} s  {steps[-1] if steps else 'no steps'}", flush=True)


def spoilt(programs, hows, bags):
    """Drives made worse, as recordings of other sensors are; of the street against KISS-ICP's trajectory."""
    for recording in [r for r in RECORDINGS if r.truth and r.name != "corridor_imu"]:
        for how in hows:
            worse = pathlib.Path(bags) / f"{recording.name}.{how}.bag"
            script = REPOSITORY / "scripts/spoil_space.py"
            subprocess.run([sys.executable, script, recording.bag(bags), worse, how], check=True)
            for program in programs:
                with tempfile.TemporaryDirectory() as results:
                    trajectory, cost = map_recording(program, recording, worse, results)
                    position = json.loads(python("ate.py", recording.truth, trajectory, "--se3", "--interp", *recording.lever))
                    print(f"{recording.name:14} {how:14} {cost}  {position['ate_rmse']:.4f} m  [{program}]", flush=True)
            worse.unlink()


def refine(program, bags):
    for recording in [r for r in RECORDINGS if r.given]:
        bag = recording.bag(bags)
        with tempfile.TemporaryDirectory() as results:
            own, _ = map_recording(program, recording, bag, results)
            for name, given in [("own", own), ("given", recording.given)]:
                folder = pathlib.Path(results) / name
                command = [program, "refine", "--recording", bag, "--trajectory", given, "-o", folder, "-q", "--no-cloud"]
                code, _, seconds, megabytes = run(command)
                after = judged(recording, folder / "refined.tum")
                cost = f"{seconds:7.1f} CPU-s {megabytes:6.0f} MB  exit {code}"
                print(f"{recording.name:14} {name:6} {cost}  {judged(recording, given)} -> {after}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", nargs="+", default=[str(REPOSITORY / "target/release/portolan")])
    parser.add_argument("--starts", action="store_true")
    parser.add_argument("--refine", action="store_true")
    parser.add_argument("--spoilt", nargs="+", metavar="HOW")
    arguments = parser.parse_args()
    if not SPACE.exists() or not TOOLS.exists():
        sys.exit(f"{SPACE} or {TOOLS} is missing: set PORTOLAN_DATA to the folder of the recordings")
    with tempfile.TemporaryDirectory() as bags:
        if arguments.starts:
            starts(arguments.programs[0], bags)
        elif arguments.spoilt:
            spoilt(arguments.programs, arguments.spoilt, bags)
        elif arguments.refine:
            refine(arguments.programs[0], bags)
        else:
            table(arguments.programs, bags)


if __name__ == "__main__":
    main()
