#!/usr/bin/env python3
"""Localises pieces of every real planar log of the data folder in a map of its first half, and prints one table.

    scripts/field_localize.py                          aces, fr079, intel, mit-csail: 40 pieces of 60 s each
    scripts/field_localize.py --logs aces --pieces 8   less
    scripts/field_localize.py --kidnap                 two pieces of the rest glued together, too
    scripts/field_localize.py --space                  odd sweeps of real 3D drives in maps of the even ones

The truth is the map of the whole log. The map of the first half alone is bent against it where loops close later, by more
than a metre in aces: so the whole is put over the half place by place, by the common poses nearest to it. A piece is known
if a pose of the map's part lies within 3 m of its way; many such only begin at the end of the map's way, or touch it. Its
place is contained in the map if it stays within 2 m of the map's way for 10 s. Needs Python 3 alone. The data folder
is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import bisect
import bz2
import concurrent.futures
import csv
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

REPOSITORY = pathlib.Path(__file__).resolve().parent.parent
LOGS = {
    "aces": "aces/aces.clf.bz2",
    "fr079": "fr079/fr079.bag",
    "intel": "intel/intel.clf.bz2",
    "mit-csail": "mit-csail/mit-csail.clf.bz2",
}
# A pose is wrong beyond this, metres and degrees, and a wrong one is a false one if it lasts for so many seconds.
WRONG = (0.5, 10.0)
LASTING = 2.0
# A piece is in the map if it comes so near to the map's way, metres.
NEAR = 3.0
# And its place is contained in the map if it stays so near, metres, for so many seconds.
STAYS_NEAR = 2.0
STAYS = 10.0
# Poses this near to a place, metres, tell how the map of the first half is bent there.
LOCAL = 6.0


def data_folder():
    return pathlib.Path(os.environ.get("PORTOLAN_DATA", REPOSITORY / "../shared/data"))


def wrap(angle):
    return math.remainder(angle, 2 * math.pi)


def read_tum(path):
    """(time, x, y, yaw) in order of time."""
    poses = []
    for line in pathlib.Path(path).read_text().splitlines():
        t, x, y, _, qx, qy, qz, qw = map(float, line.split())
        poses.append((t, x, y, math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))))
    return sorted(poses)


class Way:
    """Poses that can be asked for at any time."""

    def __init__(self, poses):
        self.poses, self.times = poses, [pose[0] for pose in poses]

    def at(self, time):
        i = bisect.bisect_left(self.times, time)
        if not self.poses or i == 0 and time < self.times[0] - 1e-3 or i == len(self.times) and time > self.times[-1] + 1e-3:
            return None
        a, b = self.poses[max(i - 1, 0)], self.poses[min(i, len(self.poses) - 1)]
        share = (time - a[0]) / (b[0] - a[0]) if b[0] > a[0] else 0.0
        return tuple(u + share * (v - u) for u, v in zip(a[1:3], b[1:3])) + (wrap(a[3] + share * wrap(b[3] - a[3])),)

    def between(self, first, last):
        return self.poses[bisect.bisect_left(self.times, first) : bisect.bisect_right(self.times, last)]


def align(poses, others):
    """The rigid motion that puts `others` over `poses`, as a function of a pose (x, y, yaw)."""
    n = len(poses)
    ax, ay = (sum(p[i] for p in poses) / n for i in (0, 1))
    bx, by = (sum(p[i] for p in others) / n for i in (0, 1))
    dot = sum((p[0] - ax) * (q[0] - bx) + (p[1] - ay) * (q[1] - by) for p, q in zip(poses, others))
    cross = sum((p[1] - ay) * (q[0] - bx) - (p[0] - ax) * (q[1] - by) for p, q in zip(poses, others))
    turn = math.atan2(cross, dot)
    c, s = math.cos(turn), math.sin(turn)
    return lambda p: (ax + c * (p[0] - bx) - s * (p[1] - by), ay + s * (p[0] - bx) + c * (p[1] - by), wrap(p[2] + turn))


def run(command):
    """Exit code and CPU seconds."""
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime


def mapped(program, recording, folder, options):
    if not (folder / "map.pbstream").exists():
        run([program, "map", recording, "-o", folder, "-q", *options])
    return folder


def errors(folder, truth, shift=lambda time: time):
    """For each scan: time, state, error in metres and degrees, NEES; errors are None where there is no place or truth."""
    rows = []
    for row in csv.DictReader((folder / "poses.csv").open()):
        time = float(row["time"])
        true = truth(shift(time))
        if not row["x"] or true is None:
            rows.append((time, row["state"], None, None, None))
            continue
        x, y, yaw = (float(row[name]) for name in ("x", "y", "yaw"))
        error = (x - true[0], y - true[1], wrap(yaw - true[2]))
        rows.append((time, row["state"], math.hypot(*error[:2]), math.degrees(abs(error[2])), nees(row, error)))
    return rows


def nees(row, error):
    """eᵀ C⁻¹ e by Cramer's rule."""
    xx, xy, xt, yy, yt, tt = (float(row["cov_" + n]) for n in ("xx", "xy", "x_yaw", "yy", "y_yaw", "yaw_yaw"))
    a = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]

    def det(m):
        return (m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]))

    whole = det(a)
    solved = [det([[error[i] if k == j else a[i][k] for k in range(3)] for i in range(3)]) / whole for j in range(3)]
    return sum(e * s for e, s in zip(error, solved))


def is_wrong(row):
    return row[1] == "localised" and row[2] is not None and (row[2] > WRONG[0] or row[3] > WRONG[1])


def longest_false(rows):
    """Seconds of the longest stretch that is localised and wrong."""
    longest, since = 0.0, None
    for row in rows:
        if is_wrong(row):
            since = row[0] if since is None else since
            longest = max(longest, row[0] - since)
        else:
            since = None
    return longest


class Truth:
    """The way of the whole log as the map of its first half has it."""

    def __init__(self, whole, known):
        self.whole = Way(whole)
        common = [(pose[1:], self.whole.at(pose[0])) for pose in known]
        self.common = [pair for pair in common if pair[1]][::2]
        self.cells = {}

    def at(self, time):
        pose = self.whole.at(time)
        return pose and self.put(pose)(pose)

    def put(self, pose):
        """The motion that puts the surroundings of a pose of the whole where the half has them; one for each cell."""
        cell = (round(pose[0] / 2), round(pose[1] / 2))
        if cell not in self.cells:
            centre = (2 * cell[0], 2 * cell[1])
            far = lambda pair: math.hypot(pair[1][0] - centre[0], pair[1][1] - centre[1])
            nearest = sorted(self.common, key=far)[: max(30, sum(far(pair) < LOCAL for pair in self.common))]
            self.cells[cell] = align([pair[0] for pair in nearest], [pair[1] for pair in nearest])
        return self.cells[cell]

    def between(self, first, last):
        return [(p[0], *self.put(p[1:])(p[1:])) for p in self.whole.between(first, last)]


class Log:
    """A log, the map of its first half, or another share of it, and its truth."""

    def __init__(self, program, name, cache, share=0.5):
        self.program, self.name = program, name
        self.recording = data_folder() / "lidar2d" / LOGS[name]
        whole = read_tum(mapped(program, self.recording, cache / f"{name}_whole", []) / "trajectory.tum")
        self.start, self.end = whole[0][0], whole[-1][0]
        self.half = share * (self.end - self.start)
        of_share = f"{name}_half" if share == 0.5 else f"{name}_{share}"
        folder = mapped(program, self.recording, cache / of_share, ["--duration", self.half])
        self.map = folder / "map.pbstream"
        self.known = read_tum(folder / "trajectory.tum")
        self.truth = Truth(whole, self.known)

    def reached(self, first, last):
        """When the way first comes near that of the map; None if it never does."""
        near = lambda p: any(math.hypot(p[1] - q[1], p[2] - q[2]) < NEAR for q in self.known[::5])
        return next((p[0] for p in self.truth.between(first, last)[::5] if near(p)), None)

    def contains(self, first, last):
        return self.reached(first, last) is not None

    def contained_since(self, first, last):
        """From when on the way stays near that of the map; None if it never does for long enough."""
        since = None
        for p in self.truth.between(first, last)[::5]:
            if not any(math.hypot(p[1] - q[1], p[2] - q[2]) < STAYS_NEAR for q in self.known[::5]):
                since = None
                continue
            since = p[0] if since is None else since
            if p[0] - since >= STAYS:
                return since
        return None

    def localize(self, recording, folder, options):
        code, cpu = run([self.program, "localize", self.map, recording, "-o", folder, "-q", "--threads", 1, *options])
        return code, cpu

    def piece(self, skip, seconds):
        """Figures of one piece."""
        first = self.start + skip
        with tempfile.TemporaryDirectory() as results:
            folder = pathlib.Path(results)
            code, cpu = self.localize(self.recording, folder, ["--skip", skip, "--duration", seconds])
            reached = self.reached(first, first + seconds)
            figures = {"skip": skip, "code": code, "cpu": cpu, "known": reached is not None, "reached": reached}
            figures["contained"] = self.contained_since(first, first + seconds)
            if not (folder / "poses.csv").exists():
                return figures | {"rows": [], "changes": []}
            report = json.loads((folder / "report.json").read_text())
            return figures | {"rows": errors(folder, self.truth.at), "changes": report["changes"]}


def summary(log, pieces):
    known = [p for p in pieces if p["known"]]
    outside = [p for p in pieces if not p["known"]]
    right, times, inside, wrong, contained = 0, [], [], [], []
    for piece in pieces:
        localised = [row for row in piece["rows"] if row[1] == "localised"]
        false = longest_false(piece["rows"])
        if false > LASTING:
            wrong.append((round(piece["skip"]), round(false, 1)))
        first = next((row for row in localised if not is_wrong(row)), None)
        if piece["known"] and first:
            right += 1
            times.append(first[0] - piece["rows"][0][0])
            inside.append(max(first[0] - piece["reached"], 0.0))
            if piece["contained"]:
                contained.append(max(first[0] - piece["contained"], 0.0))
    late = [p for p in known if p["rows"] and p["reached"] - p["rows"][0][0] > 30]
    rows = [row for piece in pieces for row in piece["rows"] if row[1] == "localised" and row[2] is not None]
    good = [row for row in rows if not is_wrong(row)]
    middle = lambda values: statistics.median(values) if values else float("nan")
    share = lambda part, whole: 100 * part / whole if whole else float("nan")
    all_rows = [row for piece in known for row in piece["rows"]]
    of = sum(piece["contained"] is not None for piece in pieces)
    print(f"{log.name:10} contained: found {len(contained)}/{of} ({share(len(contained), of):.0f} %), "
          f"{middle(contained):.1f} s after it was near (90 %: {sorted(contained)[int(0.9 * len(contained))] if contained else float('nan'):.1f} s)")
    print(f"{log.name:10} found {right}/{len(known)} ({share(right, len(known)):.0f} %), after {middle(times):.1f} s "
          f"(90 %: {sorted(times)[int(0.9 * len(times))] if times else float('nan'):.1f} s), "
          f"{middle(inside):.1f} s after it came near the map's way, "
          f"false > {LASTING:.0f} s: {len(wrong)}, error {middle([row[2] for row in good]):.3f} m {middle([row[3] for row in good]):.2f} deg, "
          f"localised {share(sum(row[1] == 'localised' for row in all_rows), len(all_rows)):.0f} % of scans, "
          f"NEES {statistics.fmean(min(row[4], 100) for row in good) if good else float('nan'):.1f} (3), "
          f"95 % within: {share(sum(row[4] < 7.815 for row in good), len(good)):.0f} %; "
          f"outside {len(outside)}, localised there: {sum(any(r[1] == 'localised' for r in p['rows']) for p in outside)} "
          f"(wrongly {sum(any(is_wrong(r) for r in p['rows']) for p in outside)}); {len(late)} come near only after 30 s; "
          f"{middle([p['cpu'] for p in pieces]):.1f} CPU-s a piece", flush=True)
    missed = [round(p["skip"]) for p in known if not any(r[1] == "localised" and not is_wrong(r) for r in p["rows"])]
    if missed or wrong:
        print(f"{'':10} never found: {missed}; false (skip, seconds): {wrong}", flush=True)


def glued(recording, first, second, seconds, path):
    """A CARMEN log of two pieces, the second right after the first; the time by which the second was moved."""
    lines = bz2.open(recording, "rt", errors="replace").read().splitlines()
    stamped = [(float(l.split()[-3]), l) for l in lines if l.split() and l.split()[0] in ("FLASER", "ODOM", "RLASER")]
    moved = second - (first + seconds) - 0.2
    text = [l for l in lines if l.startswith(("PARAM", "#"))]
    for time, line in stamped:
        if first <= time < first + seconds:
            text.append(line)
    for time, line in stamped:
        if second <= time < second + seconds:
            words = line.split()
            text.append(" ".join([*words[:-3], f"{time - moved:.6f}", words[-2], f"{float(words[-1]) - moved:.6f}"]))
    pathlib.Path(path).write_text("\n".join(text) + "\n")
    return moved


def kidnap(log, first, second, seconds):
    """Seconds from the kidnapping until it is not localised wrongly any more, and until it is right again."""
    with tempfile.TemporaryDirectory() as results:
        folder = pathlib.Path(results)
        recording = folder / "glued.clf"
        moved = glued(log.recording, log.start + first, log.start + second, seconds, recording)
        log.localize(recording, folder, [])
        if not (folder / "poses.csv").exists():
            return None
        cut = log.start + first + seconds
        shift = lambda time: time + moved if time > cut else time
        rows = errors(folder, log.truth.at, shift)
        before = [r for r in rows if r[0] <= cut][-5:]
        if not any(r[1] == "localised" and not is_wrong(r) for r in before):
            return None
        after = [r for r in rows if r[0] > cut]
        left = next((r[0] - cut for r in after if not is_wrong(r)), float("inf"))
        right = next((r[0] - cut for r in after if r[1] == "localised" and r[2] is not None and not is_wrong(r)), float("inf"))
        return left, right


def kidnaps(log, count, workers):
    if log.recording.suffix != ".bz2":
        return
    room = log.end - log.start - log.half - 80
    jobs = [(log.half + room * i / count, log.half + room * ((i + count // 2) % count) / count) for i in range(count)]
    known = [j for j in jobs if all(log.contains(log.start + s, log.start + s + 10) for s in j)]
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        found = [f for f in pool.map(lambda j: kidnap(log, *j, 30), known) if f]
    left, right = sorted(f[0] for f in found), sorted(f[1] for f in found)
    print(f"{log.name:10} kidnapped {len(found)} times where it was known: not localised any more within 3 s "
          f"{sum(t <= 3 for t in left)}, right again within 10 s {sum(t <= 10 for t in right)}, "
          f"medians {statistics.median(left) if left else float('nan'):.1f} s and {statistics.median(right) if right else float('nan'):.1f} s", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(REPOSITORY / "target/release/portolan"))
    parser.add_argument("--logs", nargs="+", default=list(LOGS), choices=list(LOGS))
    parser.add_argument("--space", nargs="*", metavar="DRIVE", help="3D drives instead; all of them where none is named")
    parser.add_argument("--every", type=int, default=5, help="with --space: every so manieth odd sweep is a start")
    parser.add_argument("--pieces", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--kidnap", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--maps", help="folder where maps are kept from run to run")
    parser.add_argument("--details", action="store_true", help="one line for each piece")
    arguments = parser.parse_args()
    if not data_folder().exists():
        sys.exit(f"{data_folder()} is missing: set PORTOLAN_DATA to the folder of the recordings")
    with tempfile.TemporaryDirectory() as temporary:
        cache = pathlib.Path(arguments.maps or temporary)
        if arguments.space is not None:
            # What makes bags of other formats needs more than Python.
            from field_localize_space import drives

            drives(arguments.program, arguments.space, cache, arguments.every, arguments.workers, arguments.details)
            return
        for name in arguments.logs:
            log = Log(arguments.program, name, cache)
            room = log.end - log.start - log.half - arguments.seconds
            starts = [log.half + room * i / max(arguments.pieces - 1, 1) for i in range(arguments.pieces)]
            with concurrent.futures.ThreadPoolExecutor(arguments.workers) as pool:
                pieces = list(pool.map(lambda s: log.piece(s, arguments.seconds), starts))
            for piece in pieces if arguments.details else []:
                changes = [f"{c['time'] - piece['rows'][0][0]:.1f} {c['state']} {c['reason']}" for c in piece["changes"]]
                print(f"  {piece['skip']:.0f} known {piece['known']} contained {piece['contained'] is not None} exit {piece['code']} {'; '.join(changes)}")
            summary(log, pieces)
            if arguments.kidnap:
                kidnaps(log, 20, arguments.workers)


if __name__ == "__main__":
    main()
