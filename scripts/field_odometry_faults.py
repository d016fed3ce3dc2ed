#!/usr/bin/env python3
"""Maps real planar logs whose odometry was made wrong, and prints one table: errors beside those of the log itself and
those without odometry.

    scripts/field_odometry_faults.py [--program target/release/portolan] [--logs aces,intel] [--faults missed-turn]

Faults: wheels of a wrong size, a track that is too wide, a gyroscope or wheels that drift, a turn of 80 degrees that is
missed, wheels that stand or run on for 20 s, a jump of 3 m, a heading with the wrong sign. Scans and relations are
those of the log. Needs Python 3 alone. The data folder is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import bz2
import math
import pathlib
import tempfile

from field import LOGS, REPOSITORY, data_folder, map_log

# CARMEN: the fields behind the ranges of FLASER are x y theta odom_x odom_y odom_theta.
AT_PERCENT = 40


def compose(a, b):
    sine, cosine = math.sin(a[2]), math.cos(a[2])
    return (a[0] + cosine * b[0] - sine * b[1], a[1] + sine * b[0] + cosine * b[1], a[2] + b[2])


def inverse(a):
    sine, cosine = math.sin(a[2]), math.cos(a[2])
    return (-cosine * a[0] - sine * a[1], sine * a[0] - cosine * a[1], -a[2])


def between(a, b):
    x, y, turn = compose(inverse(a), b)
    return (x, y, math.remainder(turn, math.tau))


def turns_missed(steps, _times):
    """The sharpest turn within ten seconds after the given share of the log is not seen by the odometry."""
    first = len(steps) * AT_PERCENT // 100
    begin, turned = None, 0.0
    for i in range(first, len(steps)):
        if begin is None and abs(steps[i][2]) > 0.02:
            begin, turned = i, 0.0
        if begin is not None:
            turned += steps[i][2]
            if abs(turned) > math.radians(80):
                return [(x, y, 0.0) if begin <= k <= i else (x, y, t) for k, (x, y, t) in enumerate(steps)]
            if i - begin > 80:
                begin = None
    return steps


def during(seconds, change):
    def fault(steps, times):
        begin = times[len(steps) * AT_PERCENT // 100]
        return [change(s) if begin <= t < begin + seconds else s for s, t in zip(steps, times)]

    return fault


def every(change):
    return lambda steps, _times: [change(step) for step in steps]


def jump(steps, _times):
    at = len(steps) * AT_PERCENT // 100
    return [(x + 3.0, y, t) if k == at else (x, y, t) for k, (x, y, t) in enumerate(steps)]


def held_back(every_seconds, seconds):
    """Now and then motions are told later, all at once."""

    def fault(steps, times):
        told, behind = [], (0.0, 0.0, 0.0)
        for step, time in zip(steps, times[1:]):
            behind = compose(behind, step)
            is_held = (time - times[0]) % every_seconds < seconds
            told.append((0.0, 0.0, 0.0) if is_held else behind)
            behind = behind if is_held else (0.0, 0.0, 0.0)
        return told

    return fault


FAULTS = {
    "none": every(lambda s: s),
    "wheels 20 % small": every(lambda s: (1.2 * s[0], 1.2 * s[1], s[2])),
    "wheels 20 % large": every(lambda s: (0.8 * s[0], 0.8 * s[1], s[2])),
    "turns 20 % small": every(lambda s: (s[0], s[1], 0.8 * s[2])),
    "drift 1 deg/m": every(lambda s: (s[0], s[1], s[2] + math.radians(1.0) * math.hypot(s[0], s[1]))),
    "drift -1 deg/m": every(lambda s: (s[0], s[1], s[2] - math.radians(1.0) * math.hypot(s[0], s[1]))),
    "drift 0.3 deg/m": every(lambda s: (s[0], s[1], s[2] + math.radians(0.3) * math.hypot(s[0], s[1]))),
    "wheels 10 % small": every(lambda s: (1.1 * s[0], 1.1 * s[1], s[2])),
    "missed-turn": turns_missed,
    "stands 20 s": during(20.0, lambda s: (0.0, 0.0, 0.0)),
    "never moves": every(lambda s: (0.0, 0.0, 0.0)),
    "turns alone": every(lambda s: (0.0, 0.0, s[2])),
    "goes straight": every(lambda s: (s[0], s[1], 0.0)),
    "runs on 20 s": during(20.0, lambda s: (0.1, 0.0, 0.0)),
    "jump 3 m": jump,
    "held back 1.5 s": held_back(20.0, 1.5),
    "once a second": held_back(1.0, 0.8),
    "turned 180 deg": every(lambda s: (-s[0], -s[1], s[2])),
    "turned 90 deg": every(lambda s: (-s[1], s[0], s[2])),
    "turned 10 deg": every(lambda s: (0.985 * s[0] - 0.174 * s[1], 0.174 * s[0] + 0.985 * s[1], s[2])),
    "0.5 m behind": every(lambda s: compose(compose((0.5, 0.0, 0.0), s), (-0.5, 0.0, 0.0))),
    "in centimetres": every(lambda s: (100.0 * s[0], 100.0 * s[1], s[2])),
    "turns in degrees": every(lambda s: (s[0], s[1], math.degrees(s[2]))),
    "wrong sign of turns": every(lambda s: (s[0], -s[1], -s[2])),
}


def faulty(text, fault):
    """The log with the odometry changed."""
    lines = text.splitlines()
    words = [line.split() for line in lines]
    scans = [i for i, w in enumerate(words) if w and w[0] == "FLASER"]
    poses, times = [], []
    for i in scans:
        end = 2 + int(words[i][1])
        poses.append(tuple(float(v) for v in words[i][end + 3 : end + 6]))
        times.append(float(words[i][end + 6]))
    steps = fault([between(a, b) for a, b in zip(poses, poses[1:])], times)
    stands = [step[:2] == (0.0, 0.0) for step in steps]
    changed = [poses[0]]
    for step in steps:
        changed.append(compose(changed[-1], step))
    written, latest = [], (0.0, 0.0, 0.0)
    number = 0
    for i, line in enumerate(lines):
        w = words[i]
        if w and w[0] == "FLASER":
            end = 2 + int(w[1])
            latest = compose(changed[number], inverse(poses[number]))
            number += 1
            for at in (end, end + 3):
                pose = compose(latest, tuple(float(v) for v in w[at : at + 3]))
                w[at : at + 3] = [f"{v:.6f}" for v in pose]
            line = " ".join(w)
        elif w and w[0] == "ODOM":
            # What is held back until a scan is not told before it either.
            is_held = 0 < number and any(stands[max(number - 2, 0) : number])
            pose = changed[number - 1] if is_held else compose(latest, tuple(float(v) for v in w[1:4]))
            w[1:4] = [f"{v:.6f}" for v in pose]
            line = " ".join(w)
        written.append(line)
    return "\n".join(written) + "\n"


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    arguments.add_argument("--program", default=REPOSITORY / "target/release/portolan", type=pathlib.Path)
    arguments.add_argument("--logs", default="aces,fr079,intel,fr101-rawodo")
    arguments.add_argument("--faults", default=",".join(FAULTS))
    options = arguments.parse_args()
    if unknown := set(options.faults.split(",")) - set(FAULTS):
        arguments.error(f"no such fault: {', '.join(sorted(unknown))}; there are {', '.join(FAULTS)}")
    print("| log | odometry | translation, m | rotation, deg | CPU, s | exit code |\n|---|---|---|---|---|---|")
    for log in LOGS:
        if log[0] not in options.logs.split(","):
            continue
        text = bz2.open(data_folder() / "lidar2d" / log[1], "rt", errors="replace").read()
        cases = [(name, faulty(text, FAULTS[name]), []) for name in options.faults.split(",")]
        cases.append(("not used", text, ["--no-odometry"]))
        for name, changed, more in cases:
            with tempfile.TemporaryDirectory() as folder:
                recording = pathlib.Path(folder) / f"{log[0]}.clf"
                recording.write_text(changed)
                figures = map_log(options.program.resolve(), (log[0], recording, *log[2:]), more)
            print(
                f"| {log[0]} | {name} | {figures.get('translation', float('nan')):.4f} | "
                f"{figures.get('rotation', float('nan')):.2f} | {figures['cpu']:.1f} | {figures['code']} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
