#!/usr/bin/env python3
"""campus.py OUT.clf TRUTH.relations [--seed N] [--metres M] [--spacing M] [--uneven DEG] [--slip P] [--truth OUT.tum]: a robot with a planar lidar out of doors.

A SICK LMS (180 degrees, readings up to 80 m, 1 cm of noise) on a robot with wheels, in a made campus that is known exactly:
houses with niches and windows that mirror away or let through, rows of trees, bushes whose leaves are never hit twice alike,
parked cars, people who walk, and uneven ground: where the robot pitches or rolls, the lidar sees the ground as a wall that moves along.
The way follows the streets and comes back to places; odometry has noise, an error of its scale and one of its heading.
What real logs of that kind lack is an exact truth; what this one lacks is everything that is not listed here.

--spacing: metres between scans (default 0.5; 0 gives one each 0.2 s). --uneven: standard deviation of pitch and roll in degrees.
--slip: error of the odometry as a share of the way (default 0.03). Relations: 2,000, of neighbours and of places that are met again.
Needs numpy and numba.
"""
import argparse
import heapq

import numba
import numpy as np

BEAMS = np.radians(np.arange(181) - 90.0)
FARTHEST, NO_RETURN = 80.0, 81.91
HEIGHT = 0.55
SPEED, PERIOD = 0.7, 0.2
BLOCK = 62.0
START = 1_100_000_000.0


def house(random, middle, size, heading):
    """Walls of a house with niches: rows of x0, y0, x1, y1, and a share of glass by wall."""
    half = size / 2
    corners = np.array([[-half[0], -half[1]], [half[0], -half[1]], [half[0], half[1]], [-half[0], half[1]]])
    if random.random() < 0.5:
        cut = half * random.uniform(0.3, 0.7, 2)
        corners = np.array([[-half[0], -half[1]], [half[0], -half[1]], [half[0], half[1] - cut[1]],
                            [half[0] - cut[0], half[1] - cut[1]], [half[0] - cut[0], half[1]], [-half[0], half[1]]])
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    walls, glass = [], []
    pitch, depth = random.uniform(2.5, 6.0), random.choice([0.0, 0.15, 0.4])
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        length = np.linalg.norm(b - a)
        along, inward = (b - a) / length, np.array([-(b - a)[1], (b - a)[0]]) / length
        points, panes = [a], []
        at = random.uniform(0.5, pitch)
        while depth > 0 and at + 1.5 < length:
            niche = [a + along * at, a + along * at + inward * depth, a + along * (at + 1.2) + inward * depth, a + along * (at + 1.2)]
            points += niche
            panes += [0.0, 0.0, 0.6, 0.0]
            at += pitch
        points.append(b)
        panes.append(0.0)
        for p, q, pane in zip(points[:-1], points[1:], panes):
            walls.append([*(turn @ p + middle), *(turn @ q + middle)])
            glass.append(pane)
    return walls, glass


def rectangle(middle, size, heading):
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    corners = (turn @ (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2).T).T + middle
    return [[*a, *b] for a, b in zip(corners, np.roll(corners, -1, axis=0))]


class Campus:
    """Blocks of 62 m between streets: houses, car parks, meadows. Streets are lines between the corners of blocks."""

    def __init__(self, random, columns=7, rows=4):
        self.walls, self.glass, self.discs = [], [], []
        self.corners = np.array([[[c * BLOCK, r * BLOCK] + random.normal(0, 4, 2) for r in range(rows + 1)] for c in range(columns + 1)])
        self.columns, self.rows = columns, rows
        for c in range(columns):
            for r in range(rows):
                middle = self.corners[c : c + 2, r : r + 2].mean(axis=(0, 1))
                self.block(random, middle)
        self.trees_of_streets(random)

    def block(self, random, middle):
        kind, heading = random.random(), random.choice([0.0, 0.12, -0.3])
        if kind < 0.55:
            walls, glass = house(random, middle + random.normal(0, 2, 2), random.uniform([16, 12], [40, 36]), heading)
            self.walls += walls
            self.glass += glass
        elif kind < 0.75:
            for i in range(int(random.integers(4, 16))):
                place = middle + np.array([(i % 8 - 4) * 2.8, (i // 8 - 0.5) * 14]) + random.normal(0, 0.15, 2)
                self.walls += rectangle(place, np.array([1.7, 4.3]), random.normal(0, 0.03))
                self.glass += [0.2] * 4
        for _ in range(int(random.integers(0, 14 if kind < 0.75 else 40))):
            place = middle + random.uniform(-22, 22, 2)
            self.discs.append([*place, random.uniform(0.08, 0.3), 0.0])
        for _ in range(int(random.integers(0, 4))):
            start, way = middle + random.uniform(-22, 22, 2), random.normal(0, 1, 2)
            for i in range(int(random.integers(3, 14))):
                self.discs.append([*(start + way / np.linalg.norm(way) * i * 0.9), random.uniform(0.4, 0.7), 1.0])

    def trees_of_streets(self, random):
        for a, b in self.streets():
            if random.random() < 0.4:
                along = (b - a) / np.linalg.norm(b - a)
                aside = np.array([-along[1], along[0]]) * random.choice([-5.0, 5.0])
                for at in np.arange(8.0, np.linalg.norm(b - a) - 6, 8.0):
                    self.discs.append([*(a + along * at + aside + random.normal(0, 0.1, 2)), random.uniform(0.1, 0.25), 0.0])

    def streets(self):
        for c in range(self.columns + 1):
            for r in range(self.rows + 1):
                if c < self.columns:
                    yield self.corners[c, r], self.corners[c + 1, r]
                if r < self.rows:
                    yield self.corners[c, r], self.corners[c, r + 1]

    def way(self, random, metres):
        """Corners of streets from one to the next, rarely straight back, preferring what was not seen for long."""
        at, last, points, seen, length = (0, 0), None, [self.corners[0, 0]], {}, 0.0
        while length < metres:
            options = [(at[0] + d, at[1] + e) for d, e in ((1, 0), (-1, 0), (0, 1), (0, -1))
                       if 0 <= at[0] + d <= self.columns and 0 <= at[1] + e <= self.rows and (at[0] + d, at[1] + e) != last]
            weights = np.array([1.0 / (1 + 2 * seen.get(frozenset((at, o)), 0)) for o in options])
            to = options[random.choice(len(options), p=weights / weights.sum())]
            seen[frozenset((at, to))] = seen.get(frozenset((at, to)), 0) + 1
            last, at = at, to
            points.append(self.corners[to])
            length += np.linalg.norm(points[-1] - points[-2])
        return smooth_way(random, np.array(points))


def smooth_way(random, points):
    """Poses every SPEED * PERIOD metres: corners rounded by an average over 4 m, and a robot that keeps aside now and then."""
    step = SPEED * PERIOD
    pieces = [np.linspace(a, b, max(2, int(np.linalg.norm(b - a) / step)), endpoint=False) for a, b in zip(points[:-1], points[1:])]
    line = np.vstack(pieces)
    kernel = np.ones(int(4 / step)) / int(4 / step)
    pad = len(kernel)
    padded = np.vstack([np.repeat(line[:1], pad, 0), line, np.repeat(line[-1:], pad, 0)])
    line = np.column_stack([np.convolve(padded[:, i], kernel, "same") for i in (0, 1)])[pad + pad // 2 : -pad - pad // 2]
    sideways = np.interp(np.arange(len(line)) * step, np.arange(0, len(line) * step + 15, 15),
                         random.normal(0, 1.0, int(len(line) * step / 15) + 2)[: len(np.arange(0, len(line) * step + 15, 15))])
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    line = line + np.column_stack([-ahead[:, 1], ahead[:, 0]]) * sideways[:, None]
    for _ in range(2):
        line = np.column_stack([np.convolve(np.pad(line[:, i], 7, "edge"), np.ones(15) / 15, "valid") for i in (0, 1)])
    ahead = np.gradient(line, axis=0)
    return np.column_stack([line, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))])


@numba.njit(cache=True)
def cast(pose, pitch, roll, beams, walls, glass, discs, chance, depth, ground, height, farthest):
    ranges = np.full(beams.size, 1e9)
    for i in range(beams.size):
        dx, dy = np.cos(pose[2] + beams[i]), np.sin(pose[2] + beams[i])
        best = 1e9
        for w in range(walls.shape[0]):
            ax, ay = walls[w, 0] - pose[0], walls[w, 1] - pose[1]
            ex, ey = walls[w, 2] - walls[w, 0], walls[w, 3] - walls[w, 1]
            across = dx * ey - dy * ex
            if abs(across) < 1e-12:
                continue
            t = (ax * ey - ay * ex) / across
            u = (ax * dy - ay * dx) / across
            if 0 < t < best and 0 <= u <= 1 and chance[i, w % chance.shape[1]] >= glass[w]:
                best = t
        for d in range(discs.shape[0]):
            ox, oy = discs[d, 0] - pose[0], discs[d, 1] - pose[1]
            along = ox * dx + oy * dy
            aside = ox * dy - oy * dx
            inside = discs[d, 2] ** 2 - aside**2
            if along > 0 and inside > 0:
                t = along - np.sqrt(inside)
                if discs[d, 3] > 0.5:
                    t += depth[i, d % depth.shape[1]]
                    if t > along + np.sqrt(inside):
                        continue
                if 0 < t < best:
                    best = t
        down = pitch * np.cos(beams[i]) + roll * np.sin(beams[i])
        # Ground that is met at a grazing angle scatters hardly anything back: nothing below 0.8 degrees, all above 2.8.
        if down > 1e-4 and ground[i] < (np.degrees(down) - 0.8) / 2:
            best = min(best, height / np.sin(down))
        ranges[i] = best if best < farthest else 1e9
    return ranges


def smooth_noise(random, count, step, sigma, correlation):
    knots = random.normal(0, sigma, int(count * step / correlation) + 3)
    return np.interp(np.arange(count) * step, np.arange(len(knots)) * correlation, knots)


def people(random, poses, step):
    """Who walks near the robot at each step: rows of x, y, radius, kind."""
    walkers = []
    for begin in range(0, len(poses), int(6 / step)):
        if random.random() < 0.5:
            heading = random.uniform(-np.pi, np.pi)
            place = poses[begin, :2] + random.uniform(-8, 8, 2)
            velocity = 1.3 * np.array([np.cos(heading), np.sin(heading)])
            walkers.append((begin, begin + int(30 / step), place, velocity))
    return walkers


def odometry(random, poses, slip):
    steps = np.diff(poses, axis=0)
    scale, drift = 1 + random.normal(0, slip / 2), random.normal(0, np.radians(0.03))
    at, out = poses[0].copy(), [poses[0].copy()]
    for (dx, dy, turn), heading in zip(steps, poses[:-1, 2]):
        ahead, aside = dx * np.cos(heading) + dy * np.sin(heading), -dx * np.sin(heading) + dy * np.cos(heading)
        way = np.hypot(ahead, aside)
        ahead = ahead * scale + random.normal(0, slip * np.sqrt(way))
        aside += random.normal(0, slip / 2 * np.sqrt(way))
        turn = turn * (1 + slip / 2) + way * drift + random.normal(0, np.radians(0.6) * np.sqrt(way) + 0.05 * abs(turn))
        at = at + [ahead * np.cos(at[2]) - aside * np.sin(at[2]), ahead * np.sin(at[2]) + aside * np.cos(at[2]), turn]
        out.append(at.copy())
    return np.array(out)


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def relations(random, times, poses, path):
    """1,000 of neighbours within 5 m of way, 1,000 of places within 5 m that are more than 30 m of way apart."""
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))])
    rows = []
    wanted, tried = [1000, 1000], 0
    while sum(wanted) and tried < 2_000_000:
        tried += 1
        i, j = sorted(random.integers(0, len(poses), 2))
        between = way[j] - way[i]
        kind = 0 if 0.5 < between < 5 else 1 if between > 30 and np.hypot(*(poses[i, :2] - poses[j, :2])) < 5 else None
        if kind is None or not wanted[kind]:
            continue
        wanted[kind] -= 1
        (x, y, turn), heading = poses[j] - poses[i], poses[i, 2]
        rows.append(f"{times[i]:.6f} {times[j]:.6f} {x * np.cos(heading) + y * np.sin(heading):.6f} "
                    f"{-x * np.sin(heading) + y * np.cos(heading):.6f} 0 0 0 {wrapped(turn):.6f}\n")
    with open(path, "w") as out:
        out.writelines(rows)
    return len(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("relations")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--metres", type=float, default=1700)
    parser.add_argument("--spacing", type=float, default=0.5)
    parser.add_argument("--uneven", type=float, default=0.7)
    parser.add_argument("--slip", type=float, default=0.03)
    parser.add_argument("--truth")
    arguments = parser.parse_args()
    random = np.random.default_rng(arguments.seed)
    campus = Campus(random)
    poses = campus.way(random, arguments.metres)
    every = max(1, round(arguments.spacing / (SPEED * PERIOD)))
    wheels = odometry(random, poses, arguments.slip)
    tilt = [smooth_noise(random, len(poses), SPEED * PERIOD, np.radians(arguments.uneven), 1.5) for _ in range(2)]
    walkers = people(random, poses, PERIOD)
    walls, glass = np.array(campus.walls), np.array(campus.glass)
    fixed = np.array(campus.discs)
    used = np.arange(0, len(poses), every)
    with open(arguments.log, "w") as out:
        for step in used:
            there = [[*(p + v * (step - b) * PERIOD), 0.2, 0.0] for b, e, p, v in walkers if b <= step < e]
            discs = np.vstack([fixed, np.array(there).reshape(-1, 4)])
            ranges = cast(poses[step], tilt[0][step], tilt[1][step], BEAMS, walls, glass, discs,
                          random.random((len(BEAMS), 64)), random.exponential(0.25, (len(BEAMS), 64)), random.random(len(BEAMS)), HEIGHT, FARTHEST)
            hit = ranges < 1e8
            readings = np.where(hit, np.maximum(0.02, ranges + random.normal(0, 0.01, len(ranges))), NO_RETURN)
            x, y, heading = wheels[step]
            pose = f"{x:.6f} {y:.6f} {wrapped(heading):.6f}"
            time = START + step * PERIOD
            out.write(f"FLASER {len(readings)} {' '.join(f'{r:.2f}' for r in readings)} {pose} {pose} {time:.6f} campus {time - START:.6f}\n")
    if arguments.truth:
        with open(arguments.truth, "w") as out:
            out.writelines(f"{START + s * PERIOD:.6f} {x:.6f} {y:.6f} 0 0 0 {np.sin(h / 2):.9f} {np.cos(h / 2):.9f}\n"
                           for s, (x, y, h) in zip(used, poses[used]))
    count = relations(random, START + used * PERIOD, poses[used], arguments.relations)
    way = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    print(f"{len(used)} scans, {way:.0f} m, {len(walls)} walls, {len(fixed)} trees and bushes; {count} relations; "
          f"odometry ends {np.hypot(*(wheels[-1] - poses[-1])[:2]):.1f} m off")


if __name__ == "__main__":
    main()
