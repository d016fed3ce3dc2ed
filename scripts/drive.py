#!/usr/bin/env python3
"""drive.py OUT.bag TRUTH.tum WORLD [--seed N] [--seconds S] [--speed MIN MAX] [--columns N] [--still] [--times]: a drive through made country.

Sweeps of a lidar with the beams of an HDL-64E on a car, in a world that is known exactly: a road with ditches and shoulders, fields
and their grass, trees and hedges whose leaves are never hit twice alike, posts, guard rails, houses, and cars that drive, too. What
real drives of that kind lack is a truth better than 0.1 m; what this one lacks is everything that is not listed here.

WORLD: fields (posts of the road and hardly anything else), hedges, avenue (trees on both sides), forest, village (houses and walls),
motorway (guard rails, signs, cars). Speeds in m/s, between which the car changes; it is at speed when
the recording begins, with --still it stands for two seconds first. --times adds a field with the time of each point after the stamp. --columns: firings a turn (2,000 of the
real sensor; default 1,000). Needs numpy, scipy, numba and rosbags.
"""
import argparse

import numba
import numpy as np
from handheld import STORE, cloud_message, header, make
from rosbags.rosbag1 import Writer
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

SWEEP = 0.1
FARTHEST = 80.0
LIDAR_HEIGHT = 1.73
LANE = -1.75
ELEVATIONS = np.radians(np.r_[2 - np.arange(32) / 3, -8.83 - np.arange(32) / 2])
CELL = 0.5
CYLINDER, LEAVES, BOX = 0.0, 1.0, 2.0
START = 1_600_000_000.0


def smooth_noise(random, length, step, sigma, correlation):
    """Values every `step` metres or seconds of a smooth random function."""
    count = int(length / correlation) + 8
    knots = CubicSpline(np.arange(count) * correlation, random.normal(0, sigma, count))
    return knots(np.arange(int(length / step) + 1) * step + 3 * correlation)


class Road:
    """The middle of a road: place, heading and height by its length, every 0.5 m."""

    def __init__(self, random, length, curvature, hills):
        step = 0.5
        bend = smooth_noise(random, length, step, curvature, 60)
        heading = np.cumsum(bend) * step
        heading -= heading[0]
        self.at = np.arange(len(bend)) * step
        xyz = np.column_stack([np.cumsum(np.cos(heading)) * step, np.cumsum(np.sin(heading)) * step,
                               smooth_noise(random, length, step, hills, 80)])
        self.xyz, self.heading = xyz, heading
        self.place, self.turn = CubicSpline(self.at, xyz), CubicSpline(self.at, heading)

    def beside(self, along, left):
        """Places `left` metres beside the middle, on the height of the road."""
        heading = self.turn(along)
        return self.place(along) + np.stack([-np.sin(heading) * left, np.cos(heading) * left, np.zeros_like(heading)], -1)


class Terrain:
    """Heights every 0.5 m, and how rough the ground is there."""

    def __init__(self, random, road, ditch, undulation):
        low, high = road.xyz[:, :2].min(0) - FARTHEST - 10, road.xyz[:, :2].max(0) + FARTHEST + 10
        size = ((high - low) / CELL).astype(int) + 2
        x, y = np.meshgrid(low[0] + np.arange(size[0]) * CELL, low[1] + np.arange(size[1]) * CELL, indexing="ij")
        away, nearest = cKDTree(road.xyz[:, :2]).query(np.column_stack([x.ravel(), y.ravel()]), workers=2)
        away, height = away.reshape(x.shape), road.xyz[nearest, 2].reshape(x.shape)
        coarse = random.normal(0, 1, (size[0] // 40 + 6, size[1] // 40 + 6))
        u, v = np.arange(size[0]) / 40, np.arange(size[1]) / 40
        hills = CubicSpline(np.arange(coarse.shape[0]), coarse, axis=0)(u)
        hills = CubicSpline(np.arange(coarse.shape[1]), hills, axis=1)(v) * undulation
        outside = np.clip((away - 7) / 30, 0, 1)
        profile = -0.02 * np.minimum(away, 3.5) - 0.06 * np.clip(away - 3.5, 0, 1.5)
        profile -= ditch * np.exp(-(((away - 6.5) / 0.8) ** 2))
        rough = np.where(away < 3.6, 0.004, np.where(away < 5, 0.015, 0.05))
        self.low, self.away = low, away
        self.height = height + profile + hills * outside + random.normal(0, 1, x.shape) * rough * 0.5
        self.rough = rough

    def at(self, xy):
        i, j = ((xy - self.low) / CELL).astype(int).T
        return self.height[i, j]


class Things:
    """Rows of: kind, centre (3), half sizes (3), yaw, velocity (2), mean free path in leaves."""

    def __init__(self, random, road, terrain):
        self.random, self.road, self.terrain, self.rows = random, road, terrain, []

    def add(self, kind, centre, half, yaw=0.0, velocity=(0.0, 0.0), path=0.0):
        self.rows.append([kind, *centre, *half, yaw, *velocity, path])

    def standing(self, along, left, height):
        place = self.road.beside(along, left)
        place[2] = self.terrain.at(place[None, :2])[0]
        return place + [0, 0, height / 2]

    def post(self, along, left, radius, height):
        self.add(CYLINDER, self.standing(along, left, height), [radius, radius, height / 2])

    def tree(self, along, left):
        height, crown = self.random.uniform(6, 16), self.random.uniform(1.5, 3.5)
        foot = self.standing(along, left, 0)
        self.add(CYLINDER, foot + [0, 0, height / 4], [self.random.uniform(0.08, 0.3)] * 2 + [height / 4])
        self.add(LEAVES, foot + [0, 0, height * 0.65], [crown, crown, height * 0.35], path=self.random.uniform(0.8, 3))

    def bush(self, along, left, size):
        foot = self.standing(along, left, 0)
        self.add(LEAVES, foot + [0, 0, size * 0.7], [size, size, size * 0.8], path=0.4)

    def box(self, along, left, half, velocity=0.0, turned=0.0):
        yaw = float(self.road.turn(along)) + turned
        self.add(BOX, self.standing(along, left, 2 * half[2]), half, yaw, (np.cos(yaw) * velocity, np.sin(yaw) * velocity))


def furnish(name, random, road, terrain):
    things, end = Things(random, road, terrain), road.at[-1] - 5
    for along in np.arange(10, end, 50):
        for side in (-4.2, 4.2):
            things.post(along + random.uniform(-1, 1), side, 0.06, 1.0)
    some = {"fields": 0.15, "hedges": 1, "avenue": 1, "forest": 12, "village": 0.6, "motorway": 0.5}[name]
    for along in random.uniform(5, end, int(end * 0.05 * some)):
        things.tree(along, random.choice([-1, 1]) * random.uniform(8, 60))
    if name in ("hedges", "forest", "village"):
        for along in random.uniform(5, end, int(end * 0.15)):
            side = random.choice([-1, 1]) * random.uniform(8, 14)
            for k in range(random.integers(1, 8)):
                things.bush(min(along + k * 1.5, end), side, random.uniform(0.6, 1.5))
    if name == "avenue":
        for along in np.arange(8, end, 12):
            for side in (-8, 8):
                things.tree(along + random.uniform(-2, 2), side + random.uniform(-0.7, 0.7))
    if name == "village":
        for along in np.arange(10, end, 18):
            for side in (-1, 1):
                if random.random() < 0.7:
                    half = [random.uniform(4, 7), random.uniform(3, 6), random.uniform(2.5, 5)]
                    things.box(along + random.uniform(-3, 3), side * (random.uniform(8, 16) + half[1]), half,
                               turned=random.normal(0, 0.05))
        for along in random.uniform(5, end, int(end * 0.04)):
            things.box(along, random.choice([-1, 1]) * 5, [2.1, 0.9, 0.75])
    if name == "motorway":
        for along in np.arange(4, end, 4):
            for side in (-5.5, 5.5):
                place = road.beside(along, side)
                place[2] = terrain.at(place[None, :2])[0] + 0.6
                things.add(BOX, place, [2.0, 0.03, 0.16], float(road.turn(along)))
                things.post(along, side + 0.1 * np.sign(side), 0.05, 0.7)
        for along in np.arange(100, end, 180):
            things.box(along, -7.5, [0.05, 1.2, 2.5])
    count = {"fields": 1, "hedges": 2, "avenue": 2, "forest": 1, "village": 3, "motorway": 10}[name]
    for along in random.uniform(60, end, count):
        things.box(along, 1.75, [2.2, 0.9, 0.75], velocity=-random.uniform(12, 20))
    return things


@numba.njit
def hit_thing(o, d, time, row, chance):
    """Range at which a ray meets a thing, or a very large number."""
    kind = row[0]
    p0 = o[0] - row[1] - row[8] * time
    p1 = o[1] - row[2] - row[9] * time
    p2 = o[2] - row[3]
    c, s = np.cos(row[7]), np.sin(row[7])
    px, py, dx, dy = c * p0 + s * p1, -s * p0 + c * p1, c * d[0] + s * d[1], -s * d[0] + c * d[1]
    if kind == BOX:
        begin, end = -1e9, 1e9
        for p, v, h in ((px, dx, row[4]), (py, dy, row[5]), (p2, d[2], row[6])):
            if abs(v) < 1e-12:
                if abs(p) > h:
                    return 1e9
                continue
            a, b = (-h - p) / v, (h - p) / v
            begin, end = max(begin, min(a, b)), min(end, max(a, b))
        return begin if 0.5 < begin < end else 1e9
    if kind == CYLINDER:
        a, b, q = dx * dx + dy * dy, px * dx + py * dy, px * px + py * py - row[4] ** 2
        inside = b * b - a * q
        if inside < 0 or a < 1e-12:
            return 1e9
        t = (-b - np.sqrt(inside)) / a
        return t if t > 0.5 and abs(p2 + d[2] * t) < row[6] else 1e9
    px, py, pz, dx, dy, dz = px / row[4], py / row[5], p2 / row[6], dx / row[4], dy / row[5], d[2] / row[6]
    a, b, q = dx * dx + dy * dy + dz * dz, px * dx + py * dy + pz * dz, px * px + py * py + pz * pz - 1
    inside = b * b - a * q
    if inside < 0:
        return 1e9
    begin, end = max((-b - np.sqrt(inside)) / a, 0.5), (-b + np.sqrt(inside)) / a
    t = begin - np.log(chance) * row[10]
    return t if t < end else 1e9


@numba.njit
def cast(origins, directions, times, order, bins, things, height, rough, low, chances, normals):
    """Ranges of rays, 0 where nothing comes back; `order`, `bins`: things by the direction in which they stand."""
    ranges = np.zeros(len(origins))
    slices = len(bins) - 1
    for k in range(len(origins)):
        o, d = origins[k], directions[k]
        level = np.sqrt(d[0] ** 2 + d[1] ** 2)
        t, ground = 1.0, 1e9
        while t < FARTHEST:
            u, v = (o[0] + d[0] * t - low[0]) / CELL, (o[1] + d[1] * t - low[1]) / CELL
            i, j = int(u), int(v)
            u, v = u - i, v - j
            h = (height[i, j] * (1 - u) * (1 - v) + height[i + 1, j] * u * (1 - v) + height[i, j + 1] * (1 - u) * v
                 + height[i + 1, j + 1] * u * v)
            clearance = o[2] + d[2] * t - h
            if clearance < 0.01:
                # Grass is hit above the ground, and flat rays hardly come back from the ground.
                slant = max(-d[2] + 0.02, 0.02)
                ground = t + min(max(normals[k, 0] * rough[i, j] / slant, -1.0), 0.5)
                if chances[k, 0] > min(1.0, slant * 12 * (20 / max(t, 20.0))):
                    ground = FARTHEST
                break
            t += max(0.02, clearance / (max(-d[2], 0.0) + level * 0.7))
        nearest = ground
        piece = int((np.arctan2(d[1], d[0]) + np.pi) / (2 * np.pi) * slices) % slices
        for m in range(bins[piece], bins[piece + 1]):
            n = order[m]
            nearest = min(nearest, hit_thing(o, d, times[k], things[n], chances[k, 1 + n % 4]))
        if nearest < FARTHEST:
            ranges[k] = nearest
    return ranges


def by_direction(things, middle, time, slices=720):
    """Things near a place, listed by slices of a full turn in which they may be seen."""
    at = things[:, 1:3] + things[:, 8:10] * time - middle[:2]
    away, size = np.hypot(*at.T), np.hypot(things[:, 4], things[:, 5]) + 1.5
    listed = [[] for _ in range(slices)]
    for n in np.nonzero(away - size < FARTHEST)[0]:
        half = np.pi if away[n] <= size[n] * 1.2 else np.arcsin(size[n] / away[n]) + 0.02
        first, last = (np.array([-half, half]) + np.arctan2(at[n, 1], at[n, 0]) + np.pi) / (2 * np.pi) * slices
        for piece in range(int(np.floor(first)), int(np.floor(last)) + 1)[:slices]:
            listed[piece % slices].append(n)
    bins = np.cumsum([0, *map(len, listed)])
    return np.array([n for piece in listed for n in piece], np.int64), bins


class Car:
    """Poses of the lidar by time."""

    def __init__(self, random, road, terrain, seconds, speeds, is_still):
        step = 0.005
        times = np.arange(int((seconds + 1) / step)) * step
        speed = np.mean(speeds) + smooth_noise(random, seconds + 2, step, (speeds[1] - speeds[0]) / 3, 4)[: len(times)]
        speed = np.clip(speed, *speeds)
        if is_still:
            speed = speed * np.clip((times - 2) / 6, 0, 1)
        along = 5 + np.cumsum(speed) * step
        lane = LANE + smooth_noise(random, seconds + 2, step, 0.12, 3)[: len(times)]
        if is_still:
            # A car leaves its lane as it drives, not as time passes.
            lane = np.interp((along - 5) / np.mean(speeds), times, lane)
        heave = smooth_noise(random, seconds + 2, step, 0.012, 0.5)[: len(times)]
        shake = [smooth_noise(random, seconds + 2, step, np.radians(d), c)[: len(times)] for d, c in ((0.35, 0.6), (0.25, 0.5))]
        place = road.beside(along, lane) + np.outer(heave + LIDAR_HEIGHT - 0.035, [0, 0, 1])
        ahead = np.gradient(place, axis=0)
        still = np.hypot(ahead[:, 0], ahead[:, 1]) < 1e-6
        heading = np.where(still, road.turn(along), np.arctan2(ahead[:, 1], ahead[:, 0]))
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = np.gradient(road.place(along)[:, 2], along)
        slope = np.where(np.isfinite(slope), slope, road.place(along, 1)[:, 2])
        angles = np.column_stack([np.unwrap(heading), -np.arctan(slope) + shake[1], shake[0]])
        self.times, self.length = times, along[-1]
        self.place, self.angles = CubicSpline(times, place), CubicSpline(times, angles)

    def rotation(self, time):
        return Rotation.from_euler("ZYX", self.angles(time))


def length_of(seconds, speeds):
    return 5 + (seconds + 1) * speeds[1] + FARTHEST + 20


def sweep(begin, car, world, columns, beams, random):
    """Points and their times after the stamp; a turn begins behind, clockwise as seen from above."""
    terrain, things = world
    late = np.arange(columns) * SWEEP / columns
    # Firings are not in step with turns.
    azimuths = np.pi - 2 * np.pi * (np.arange(columns) + random.random()) / columns
    up, offsets = beams
    rays = np.stack([np.outer(np.cos(azimuths), np.cos(up)), np.outer(np.sin(azimuths), np.cos(up)),
                     np.tile(np.sin(up), (columns, 1))], -1).reshape(-1, 3)
    # As the sensor believes that its beams point.
    said = np.stack([np.outer(np.cos(azimuths), np.cos(ELEVATIONS)), np.outer(np.sin(azimuths), np.cos(ELEVATIONS)),
                     np.tile(np.sin(ELEVATIONS), (columns, 1))], -1).reshape(-1, 3)
    turns = car.rotation(begin + late).as_matrix()
    origins = np.repeat(car.place(begin + late), len(up), 0)
    directions = np.einsum("nij,nj->ni", np.repeat(turns, len(up), 0), rays)
    times = np.repeat(late, len(up))
    order, bins = by_direction(things, car.place(begin + SWEEP / 2), begin + SWEEP / 2)
    ranges = cast(origins, directions, times + begin, order, bins, things, terrain.height, terrain.rough, terrain.low,
                  random.random((len(rays), 5)), random.normal(0, 1, (len(rays), 1)))
    seen = (ranges > 2) & (ranges < FARTHEST)
    ranges = ranges + random.normal(0, 0.015, len(ranges)) + np.tile(offsets, columns)
    return (said * ranges[:, None])[seen], times[seen]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out")
    parser.add_argument("truth")
    parser.add_argument("world", choices=["fields", "hedges", "avenue", "forest", "village", "motorway"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=25)
    parser.add_argument("--speed", type=float, nargs=2, default=[12, 18])
    parser.add_argument("--columns", type=int, default=1000)
    parser.add_argument("--still", action="store_true")
    parser.add_argument("--times", action="store_true")
    return parser.parse_args()


def main():
    options = arguments()
    random = np.random.default_rng(options.seed)
    curvature = 0.0004 if options.world == "motorway" else 0.003
    road = Road(random, length_of(options.seconds, options.speed), curvature, 1.0)
    terrain = Terrain(random, road, random.uniform(0.2, 0.7), 0.8)
    things = np.array(furnish(options.world, random, road, terrain).rows)
    car = Car(random, road, terrain, options.seconds, options.speed, options.still)
    beams = ELEVATIONS + random.normal(0, np.radians(0.03), 64), random.normal(0, 0.012, 64)
    with Writer(options.out) as writer:
        to = writer.add_connection("/points", "sensor_msgs/msg/PointCloud2", typestore=STORE)
        for begin in np.arange(0, options.seconds - SWEEP, SWEEP):
            points, late = sweep(begin, car, (terrain, things), options.columns, beams, random)
            message = cloud_message(START + begin, points, late if options.times else None)
            writer.write(to, int((START + begin + SWEEP) * 1e9), STORE.serialize_ros1(message, message.__msgtype__))
    with open(options.truth, "w") as file:
        for time in np.arange(0, options.seconds, 0.01):
            values = [START + time, *car.place(time), *car.rotation(time).as_quat()]
            file.write(" ".join(f"{value:.8f}" for value in values) + "\n")


if __name__ == "__main__":
    main()
