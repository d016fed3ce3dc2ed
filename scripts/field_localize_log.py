"""Logs of the data folder, maps of their first halves, the truth in these maps, and pieces localised in them: for `field_localize.py`."""
import bisect
import bz2
import csv
import json
import math
import os
import pathlib
import subprocess
import tempfile

from field_odometry_faults import faulty

REPOSITORY = pathlib.Path(__file__).resolve().parent.parent
LOGS = {
    "aces": "aces/aces.clf.bz2",
    "fr079": "fr079/fr079.bag",
    "intel": "intel/intel.clf.bz2",
    "mit-csail": "mit-csail/mit-csail.clf.bz2",
    # As text, which can be glued.
    "fr079-text": "fr079/fr079.clf.bz2",
    "orebro": "orebro/orebro.clf.bz2",
    "fhw": "fhw/fhw.clf.bz2",
    "killian": "killian/killian.clf.bz2",
    "fr101-rawodo": "fr101-rawodo/fr101-rawodo.clf.bz2",
}
# Logs thinned to a scan every 0.5 to 1 m, whose stamps are made up or minutes apart: there all that is counted in seconds
# elsewhere is counted in scans.
THINNED = ("orebro", "fhw", "fr101-rawodo", "killian")
# A pose is wrong beyond this, metres and degrees, and a wrong one is a false one if it lasts for so many seconds or scans.
WRONG = (0.5, 10.0)
LASTING = 2.0
# A piece is in the map if it comes so near to the map's way, metres.
NEAR = 3.0
# And its place is contained in the map if it stays so near, metres, for so many seconds or scans.
STAYS_NEAR = 2.0
STAYS = 10.0
# Poses this near to a place, metres, tell how the map of the first half is bent there; passes that say so differently, by
# metres, show the place twice.
LOCAL = 6.0
APART = 0.3


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
        truths = truth(shift(time))
        if not row["x"] or not truths:
            rows.append((time, row["state"], None, None, None))
            continue
        x, y, yaw = (float(row[name]) for name in ("x", "y", "yaw"))
        all_errors = [(x - true[0], y - true[1], wrap(yaw - true[2])) for true in truths]
        error = min(all_errors, key=lambda e: math.hypot(*e[:2]))
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


def longest_false(rows, count=lambda since, time: time - since):
    """Seconds, or what `count` counts, of the longest stretch that is localised and wrong."""
    longest, since = 0.0, None
    for row in rows:
        if is_wrong(row):
            since = row[0] if since is None else since
            longest = max(longest, count(since, row[0]))
        else:
            since = None
    return longest


class Truth:
    """The way of the whole log as the map of its first half has it.

    Where a loop is not closed yet, such a map shows a place more than once, each time elsewhere: any of them is right.
    """

    def __init__(self, whole, known):
        self.whole = Way(whole)
        common = [(pose[1:], self.whole.at(pose[0])) for pose in known]
        self.common = [pair for pair in common if pair[1]]
        self.cells = {}

    def at(self, time):
        """Where the scanner was, once for each time that the map shows the place, the nearest to the map's way first."""
        pose = self.whole.at(time)
        return [put(pose) for put in self.put(pose)] if pose else []

    def put(self, pose):
        """The motions that put the surroundings of a pose of the whole where the half has them; of one cell once."""
        cell = (round(pose[0] / 2), round(pose[1] / 2))
        if cell not in self.cells:
            self.cells[cell] = self.motions((2.0 * cell[0], 2.0 * cell[1]))
        return self.cells[cell]

    def motions(self, centre):
        """One for each group of passes that put a place of the whole to about the same place of the half."""
        far = lambda i: math.hypot(self.common[i][1][0] - centre[0], self.common[i][1][1] - centre[1])
        groups = []
        for run in sorted(self.passes(far), key=lambda run: min(map(far, run))):
            place = self.motion(run)((*centre, 0.0))
            same = next((g for g in groups if math.dist(g[0][:2], place[:2]) < APART), None)
            same[1].extend(run) if same else groups.append((place, list(run)))
        return [self.motion(run) for _, run in groups]

    def motion(self, run):
        return align([self.common[i][0] for i in run], [self.common[i][1] for i in run])

    def passes(self, far):
        """Runs of common poses near a place, each of them so long that it tells a heading."""
        last = len(self.common) - 1
        near = [i for i in range(last + 1) if far(i) < LOCAL] or [min(range(last + 1), key=far)]
        starts = [k for k in range(len(near)) if k == 0 or near[k] != near[k - 1] + 1] + [len(near)]
        for a, b in zip(starts, starts[1:]):
            first, end = near[a], near[b - 1]
            while math.dist(self.common[first][1][:2], self.common[end][1][:2]) < LOCAL / 2 and (first, end) != (0, last):
                first, end = max(first - 1, 0), min(end + 1, last)
            yield range(first, end + 1)

    def between(self, first, last):
        return [(p[0], *self.put(p[1:])[0](p[1:])) for p in self.whole.between(first, last)]


class Log:
    """A log, the map of its first half, or another share of it, and its truth. Shares and spans are counted in seconds, in
    thinned logs in scans."""

    def __init__(self, program, name, cache, share=0.5):
        self.program, self.name = program, name
        self.recording = data_folder() / "lidar2d" / LOGS[name]
        whole = read_tum(mapped(program, self.recording, cache / f"{name}_whole", []) / "trajectory.tum")
        self.start, self.end = whole[0][0], whole[-1][0]
        self.scans = [pose[0] for pose in whole] if name in THINNED else None
        self.unit = "scans" if self.scans else "s"
        self.length = len(self.scans) - 1 if self.scans else self.end - self.start
        self.half = share * self.length
        of_share = f"{name}_half" if share == 0.5 else f"{name}_{share}"
        folder = mapped(program, self.recording, cache / of_share, ["--duration", self.seconds(self.half)])
        self.map = folder / "map.pbstream"
        self.known = read_tum(folder / "trajectory.tum")
        self.truth = Truth(whole, self.known)

    def spoil(self, fault, folder):
        """From now on pieces are those of the log with a fault of its odometry. For logs in text."""
        text = bz2.open(self.recording, "rt", errors="replace").read()
        self.recording = folder / f"{self.name}_spoilt.clf"
        self.recording.write_text(faulty(text, fault))

    def seconds(self, count):
        """Seconds from the start of the log to a place in it, which is so many seconds or scans from the start."""
        if not self.scans:
            return count
        # Between two scans, so that no rounding of stamps leaves one out.
        i = min(int(count), len(self.scans) - 2)
        return 0.5 * (self.scans[i] + self.scans[i + 1]) - self.start

    def count(self, since, time):
        """Seconds or scans from one time to another one."""
        if not self.scans:
            return time - since
        return bisect.bisect_left(self.scans, time - 1e-3) - bisect.bisect_left(self.scans, since - 1e-3)

    def near(self, first, last):
        """Poses of a way, not nearer to each other than a second or a scan, and how far that of the map is."""
        step = 1 if self.scans else 5
        known = self.known[::step]
        for p in self.truth.between(first, last)[::step]:
            yield p[0], min(math.hypot(p[1] - q[1], p[2] - q[2]) for q in known)

    def reached(self, first, last):
        """When the way first comes near that of the map; None if it never does."""
        return next((time for time, metres in self.near(first, last) if metres < NEAR), None)

    def contains(self, first, last):
        return self.reached(first, last) is not None

    def contained_since(self, first, last):
        """From when on the way stays near that of the map; None if it never does for long enough."""
        since = None
        for time, metres in self.near(first, last):
            if metres >= STAYS_NEAR:
                since = None
                continue
            since = time if since is None else since
            if self.count(since, time) >= STAYS:
                return since
        return None

    def localize(self, recording, folder, options, known=None):
        words = [self.program, "localize", known or self.map, recording, "-o", folder, "-q", "--threads", 1, *options]
        return run(words)

    def piece(self, begin, length, known=None):
        """Figures of one piece, in the log's own map or in one that knows nothing of it."""
        skip, end = self.seconds(begin), self.seconds(begin + length)
        first, last = self.start + skip, self.start + end
        with tempfile.TemporaryDirectory() as results:
            folder = pathlib.Path(results)
            options = ["--skip", f"{skip:.4f}", "--duration", f"{end - skip:.4f}"]
            code, cpu = self.localize(self.recording, folder, options, known)
            reached = None if known else self.reached(first, last)
            figures = {"skip": skip, "code": code, "cpu": cpu, "known": reached is not None, "reached": reached}
            figures["contained"] = None if known else self.contained_since(first, last)
            if not (folder / "poses.csv").exists():
                return figures | {"rows": [], "changes": []}
            report = json.loads((folder / "report.json").read_text())
            truth = (lambda time: []) if known else self.truth.at
            return figures | {"rows": errors(folder, truth), "changes": report["changes"]}
