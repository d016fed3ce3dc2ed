#!/usr/bin/env python3
"""Makes of a CARMEN log of a fast scanner one of a scanner that takes its time: each beam is cast anew from where the robot was then.

    scripts/slow_scans.py LOG.clf.bz2 TRAJECTORY.tum OUT.clf SECONDS

TRAJECTORY is what `portolan map` made of the log. Each scan begins at its stamp and lasts SECONDS; less than zero if the last beam comes
first. Beams meet the lines between neighbouring points of the scan of the log. Needs Python 3 alone.
"""
import bisect
import bz2
import math
import sys

# Neighbours farther apart are of different surfaces, metres; what is farther than the second is no return.
EDGE, NOTHING = 0.5, 80.0


def is_scan(words):
    return bool(words) and words[0] == "FLASER"


def stamp(words):
    return float(words[2 + int(words[1]) + 6])


class Trajectory:
    """Poses (x, y, heading) by cubic interpolation."""

    def __init__(self, path, first_stamp):
        poses = [list(map(float, line.split())) for line in open(path) if not line.startswith("#")]
        # Stamps that count from the start are moved by 10⁹ s.
        shift = 1e9 if first_stamp < 1e8 else 0.0
        self.times = [pose[0] - shift for pose in poses]
        self.poses = [(pose[1], pose[2], 2 * math.atan2(pose[6], pose[7])) for pose in poses]
        for i in range(1, len(self.poses)):
            (x, y, heading), before = self.poses[i], self.poses[i - 1][2]
            self.poses[i] = (x, y, before + math.remainder(heading - before, math.tau))

    def slope(self, i, k):
        a, b = max(i - 1, 0), min(i + 1, len(self.poses) - 1)
        span = self.times[b] - self.times[a]
        return (self.poses[b][k] - self.poses[a][k]) / span if span > 0 else 0.0

    def at(self, time):
        i = min(max(bisect.bisect(self.times, time), 1), len(self.times) - 1)
        begin, end = self.times[i - 1], self.times[i]
        span = end - begin
        if span <= 0 or span > 1:
            return self.poses[i - 1 if time - begin < end - time else i]
        f = min(max((time - begin) / span, 0.0), 1.0)
        weights = 2 * f**3 - 3 * f**2 + 1, f**3 - 2 * f**2 + f, 3 * f**2 - 2 * f**3, f**3 - f**2
        return tuple(
            weights[0] * self.poses[i - 1][k]
            + weights[1] * span * self.slope(i - 1, k)
            + weights[2] * self.poses[i][k]
            + weights[3] * span * self.slope(i, k)
            for k in range(3)
        )


def cast(points, first, last, pose, angle):
    """The range from a pose to the nearest line between neighbouring points."""
    x, y, heading = pose
    c, s = math.cos(heading + angle), math.sin(heading + angle)
    nearest = NOTHING + 1.83
    for p, q in zip(points[first : last - 1], points[first + 1 : last]):
        if not p or not q or math.dist(p, q) > EDGE:
            continue
        (ux, uy), (vx, vy) = (p[0] - x, p[1] - y), (q[0] - x, q[1] - y)
        of_p, of_q = c * uy - s * ux, c * vy - s * vx
        if of_p * of_q <= 0 and of_p != of_q:
            f = of_p / (of_p - of_q)
            distance = (c * ux + s * uy) * (1 - f) + (c * vx + s * vy) * f
            if 0.05 < distance < nearest:
                nearest = distance
    return nearest


def slowed(words, trajectory, seconds):
    n, time = int(words[1]), stamp(words)
    ranges = list(map(float, words[2 : 2 + n]))
    step = math.pi / (n - 1 if n % 2 else n)
    angles = [i * step - math.pi / 2 for i in range(n)]
    x, y, heading = trajectory.at(time)
    points = [
        None if r > NOTHING else (x + r * math.cos(heading + a), y + r * math.sin(heading + a))
        for r, a in zip(ranges, angles)
    ]
    reach = int(0.2 / step)
    for i, angle in enumerate(angles):
        share = i / n if seconds > 0 else 1 - i / n
        pose = trajectory.at(time + abs(seconds) * share)
        words[2 + i] = f"{cast(points, max(0, i - reach), min(n, i + reach), pose, angle):.3f}"


def main():
    log, path, output, seconds = sys.argv[1:]
    lines = bz2.open(log, "rt", errors="replace").read().split("\n")
    first = next(stamp(words) for words in map(str.split, lines) if is_scan(words))
    trajectory = Trajectory(path, first)
    with open(output, "w") as out:
        for words in map(str.split, lines):
            if is_scan(words):
                slowed(words, trajectory, float(seconds))
            if words:
                out.write(" ".join(words) + "\n")


if __name__ == "__main__":
    main()
