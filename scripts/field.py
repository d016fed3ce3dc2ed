#!/usr/bin/env python3
"""Maps every real planar log of the data folder and prints one table: errors against known relations, CPU, memory.

    scripts/field.py                                 all logs, with odometry and where scans suffice without it
    scripts/field.py --programs old/portolan target/release/portolan      in turns, side by side
    scripts/field.py --leave-one-out drift.txt       settings tuned on all logs but one, judged on that one

A file for --leave-one-out has one candidate a line: settings as `map --set` takes them, separated by blanks; an empty
line stands for the defaults. Needs Python 3 alone. The data folder is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import os
import pathlib
import subprocess
import sys
import tempfile

REPOSITORY = pathlib.Path(__file__).resolve().parent.parent
# Name, recording, relations, whether scans suffice without odometry, further options.
LOGS = [
    ("aces", "aces/aces.clf.bz2", "aces/aces.relations", True, []),
    ("aces.bag", "aces/aces.bag", "aces/aces.relations", False, []),
    ("fr079.bag", "fr079/fr079.bag", "fr079/fr079.relations", True, []),
    ("fr079", "fr079/fr079.clf.bz2", "fr079/fr079.relations", False, ["--tracking-frame", "laser"]),
    ("intel", "intel/intel.clf.bz2", "intel/intel.relations", True, []),
    ("mit-csail", "mit-csail/mit-csail.clf.bz2", "mit-csail/mit-csail.relations", True, []),
    ("fr101-rawodo", "fr101-rawodo/fr101-rawodo.clf.bz2", "fr101-rawodo/fr101-rawodo.relations", False, []),
    ("orebro", "orebro/orebro.clf.bz2", "orebro/orebro.relations", False, []),
    ("fhw", "fhw/fhw.clf.bz2", "fhw/fhw.relations", False, []),
    # Made by g2o_to_log.py; not in the data folder.
    ("killian", "killian/killian.clf.bz2", "killian/killian.relations", False, []),
]


def data_folder():
    return pathlib.Path(os.environ.get("PORTOLAN_DATA", REPOSITORY / "../shared/data"))


def run(command):
    """Exit code, standard output, CPU seconds and peak memory in MB of a program."""
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        output.seek(0)
        seconds = usage.ru_utime + usage.ru_stime
        return os.waitstatus_to_exitcode(status), output.read(), seconds, usage.ru_maxrss / 1024


def map_log(program, log, more):
    """Figures of one log: translation (m), rotation (deg), median (m), CPU (s), memory (MB), exit code."""
    _, recording, relations, _, options = log
    folder = data_folder() / "lidar2d"
    with tempfile.TemporaryDirectory() as results:
        command = [program, "map", folder / recording, "-o", results, "-q", "--no-xray", *options, *more]
        code, _, seconds, megabytes = run(command)
        figures = {"code": code, "cpu": seconds, "memory": megabytes}
        trajectory = pathlib.Path(results) / "trajectory.tum"
        if not trajectory.exists():
            return figures
        judged = run([program, "evaluate", "relations", trajectory, folder / relations])[1]
        errors = [line.split() for line in judged.splitlines() if line.startswith("Abs")]
        figures["translation"], figures["rotation"] = float(errors[0][3]), float(errors[1][3])
        return figures


def row(name, figures):
    error = f"{figures['translation']:.4f} m  {figures['rotation']:.3f} deg" if "translation" in figures else "no map"
    return f"{name:24} {error:24} {figures['cpu']:7.1f} CPU-s {figures['memory']:6.0f} MB  exit {figures['code']}"


def table(programs, more):
    for log in [log for log in LOGS if (data_folder() / "lidar2d" / log[1]).exists()]:
        variants = [("", [])] + ([(" without odometry", ["--no-odometry"])] if log[3] else [])
        for suffix, options in variants:
            for program in programs:
                name = log[0] + suffix + (f" [{program}]" if len(programs) > 1 else "")
                print(row(name, map_log(program, log, options + more)), flush=True)


def leave_one_out(program, file):
    """For each log: the candidate that is best on all others (mean of errors relative to the best), and its error here."""
    candidates = [line.split() for line in pathlib.Path(file).read_text().splitlines()]
    logs = [log for log in LOGS if (data_folder() / "lidar2d" / log[1]).exists()]
    errors = {}
    for log in logs:
        for index, settings in enumerate(candidates):
            figures = map_log(program, log, [word for setting in settings for word in ("--set", setting)])
            errors[log[0], index] = figures.get("translation", float("inf"))
            print(f"{log[0]:14} {errors[log[0], index]:.4f} m  {' '.join(settings) or 'defaults'}", file=sys.stderr)
    best = {log[0]: min(errors[log[0], i] for i in range(len(candidates))) for log in logs}
    for left_out in logs:
        others = [log[0] for log in logs if log is not left_out]
        cost = lambda i: sum(errors[name, i] / best[name] for name in others)
        chosen = min(range(len(candidates)), key=cost)
        error = errors[left_out[0], chosen]
        print(f"{left_out[0]:14} {error:.4f} m (best {best[left_out[0]]:.4f} m) with {' '.join(candidates[chosen]) or 'defaults'}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--programs", nargs="+", default=[str(REPOSITORY / "target/release/portolan")])
    parser.add_argument("--leave-one-out", metavar="FILE")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE")
    arguments = parser.parse_args()
    if not data_folder().exists():
        sys.exit(f"{data_folder()} is missing: set PORTOLAN_DATA to the folder of the recordings")
    if arguments.leave_one_out:
        leave_one_out(arguments.programs[0], arguments.leave_one_out)
    else:
        table(arguments.programs, [word for setting in arguments.set for word in ("--set", setting)])


if __name__ == "__main__":
    main()
