#!/usr/bin/env python3
"""field_pauses.py PORTOLAN RECORDING.bag TRUTH.tum [--lever x,y,z] [--gaps 1 2 3] [--places 6] [--programs OTHER ...]

Maps a ROS 1 bag of a 3D lidar with its sweeps left out for some seconds, at places spread over the recording, with the IMU
going on and with everything paused. Prints for each the error of the trajectory (ate.py --se3 --interp) and whether the
exit code is 3 (!), as where the pose was lost. Needs rosbags, and the judge `ate.py` (../shared/tools, or PORTOLAN_TOOLS).
"""
import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile

from bags import add_connections
from rosbags.rosbag1 import Reader, Writer

TOOLS = pathlib.Path(os.environ.get("PORTOLAN_TOOLS", pathlib.Path(__file__).parent / "../../shared/tools"))
LIDAR = "sensor_msgs/msg/PointCloud2"


def pause(source, output, begin_seconds, gap, is_lidar_only):
    """Writes a bag without what came in the gap, or without the sweeps in it."""
    with Reader(source) as reader, Writer(output) as writer:
        added = add_connections(reader, writer)
        begin = reader.start_time + int(begin_seconds * 1e9)
        for c, time, data in reader.messages():
            is_paused = begin <= time < begin + int(gap * 1e9) and "tf_static" not in c.topic
            if not (is_paused and (c.msgtype == LIDAR or not is_lidar_only)):
                writer.write(added[c.id], time, data)


def about(source):
    """Whether it has an IMU, and its seconds."""
    with Reader(source) as reader:
        return any(c.msgtype == "sensor_msgs/msg/Imu" for c in reader.connections), reader.duration / 1e9


def error(program, bag, truth, lever, folder, options):
    run = [program, "map", bag, "-o", folder, "-q", "--no-xray", "--force", *options]
    code = subprocess.run(run, capture_output=True).returncode
    judge = [sys.executable, TOOLS / "ate.py", "--se3", "--interp", *lever, truth, folder / "trajectory.tum"]
    found = json.loads(subprocess.run(judge, capture_output=True, text=True).stdout)
    return f"{found['ate_rmse']:8.3f}{'!' if code == 3 else ' '}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("recording")
    parser.add_argument("truth")
    parser.add_argument("--lever")
    parser.add_argument("--gaps", nargs="+", type=float, default=[1.0, 2.0, 3.0])
    parser.add_argument("--places", type=int, default=6)
    parser.add_argument("--programs", nargs="*", default=[])
    a = parser.parse_args()
    lever = [f"--lever={a.lever}"] if a.lever else []
    imu, duration = about(a.recording)
    kinds = [("all", False, []), ("all, --no-imu", False, ["--no-imu"]), ("lidar", True, [])] if imu else [("all", False, [])]
    for i in range(a.places):
        at = duration * (i + 1) / (a.places + 1)
        for gap in a.gaps:
            for kind, is_lidar_only, options in kinds:
                with tempfile.TemporaryDirectory() as folder:
                    bag = pathlib.Path(folder) / "paused.bag"
                    pause(a.recording, bag, at, gap, is_lidar_only)
                    errors = [
                        error(program, bag, a.truth, lever, pathlib.Path(folder) / f"out{n}", options)
                        for n, program in enumerate([a.program, *a.programs])
                    ]
                    print(f"at {at:5.1f} s, {gap:3.1f} s, {kind:14}: {' '.join(errors)}", flush=True)


if __name__ == "__main__":
    main()
