"""Poses in space for the scripts that judge localisation in 3D: ways, how they lie over each other, errors. Needs numpy and scipy."""
import bisect
import csv
import pathlib

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

AXES = ("x", "y", "z", "roll", "pitch", "yaw")


class Pose:
    """Position and rotation; `a * b` as for transforms."""

    def __init__(self, position, rotation):
        self.position, self.rotation = np.asarray(position, float), rotation

    def __mul__(self, other):
        return Pose(self.position + self.rotation.apply(other.position), self.rotation * other.rotation)

    def inverse(self):
        back = self.rotation.inv()
        return Pose(-back.apply(self.position), back)


class Way:
    """Poses of a file in TUM format, in order of time, that can be asked for at any time between them."""

    def __init__(self, path):
        table = np.loadtxt(path, ndmin=2)
        table = table[np.argsort(table[:, 0], kind="stable")]
        self.times, self.positions = table[:, 0], table[:, 1:4]
        self.rotations = Rotation.from_quat(table[:, 4:8])

    @classmethod
    def of(cls, times, poses):
        """Of poses at times that ascend."""
        way = cls.__new__(cls)
        way.times, way.positions = np.array(times), np.array([pose.position for pose in poses])
        way.rotations = Rotation.concatenate([pose.rotation for pose in poses])
        return way

    def at(self, time):
        """None outside of the way."""
        after = bisect.bisect_left(self.times, time)
        if after == len(self.times) or (after == 0 and time < self.times[0]):
            return None
        before = max(after - 1, 0)
        if self.times[after] == self.times[before]:
            return Pose(self.positions[after], self.rotations[after])
        share = (time - self.times[before]) / (self.times[after] - self.times[before])
        position = self.positions[before] + share * (self.positions[after] - self.positions[before])
        return Pose(position, Slerp([0, 1], self.rotations[[before, after]])(share))


class WayBetween:
    """A way of every other sweep, with the motion between its poses that the whole way has: a car rolls and pitches faster than
    every other sweep tells."""

    def __init__(self, way, whole):
        self.whole = whole
        pairs = [(time, Pose(way.positions[i], way.rotations[i]), whole.at(time)) for i, time in enumerate(way.times)]
        pairs = [(time, here * there.inverse()) for time, here, there in pairs if there]
        self.motions = Way.of([time for time, _ in pairs], [motion for _, motion in pairs])
        self.scatter = self.scatter_of_sweeps()

    def scatter_of_sweeps(self):
        """Covariance, 6 x 6 in the axes of the car, of how the two ways' poses of one sweep scatter from sweep to sweep: a
        second difference of independent errors has one and a half times their variance."""
        offsets = []
        for before, time, after in zip(self.motions.times, self.motions.times[1:], self.motions.times[2:]):
            there = self.whole.at(time)
            here = self.motions.at(time) * there
            share = (time - before) / (after - before)
            smooth = Way.of([0.0, 1.0], [self.motions.at(before) * there, self.motions.at(after) * there]).at(share)
            turn = (here.rotation * smooth.rotation.inv()).as_rotvec()
            offsets.append(here.rotation.inv().apply([here.position - smooth.position, turn]).ravel())
        return np.diag(np.mean(np.square(offsets), axis=0) / 1.5)

    def at(self, time):
        """None outside of either way."""
        there, motion = self.whole.at(time), self.motions.at(time)
        return motion * there if there and motion else None


def laid_over(positions, others):
    """The rigid motion that puts `others` over `positions` (n x 3 each) with the least squares (Kabsch 1976)."""
    middle, other_middle = positions.mean(axis=0), others.mean(axis=0)
    rotation, _ = Rotation.align_vectors(positions - middle, others - other_middle)
    return Pose(middle - rotation.apply(other_middle), rotation)


def covariance(row):
    """6 x 6, of the position and of a small rotation about the axes of the map."""
    matrix = np.empty((6, 6))
    for i, a in enumerate(AXES):
        for j in range(i, 6):
            b = AXES[j]
            name = f"cov_{a}{b}" if (a in "xyz" and b in "xyz") else f"cov_{a}_{b}"
            matrix[i, j] = matrix[j, i] = float(row[name])
    return matrix


def normalised(error, matrix):
    """eᵀ C⁻¹ e, which is in the mean the length of e if C is the covariance of e (NEES)."""
    return float(error @ np.linalg.solve(matrix, error))


def errors(folder, truth, scatter=None):
    """For each scan of `localize`'s results: time, state, error in metres and degrees, NEES of the position (3), of the
    pose (6), and of the rotation (3). Errors are None where there is no place or no truth. The truth may scatter, too: a
    covariance in the axes of the car."""
    rows = []
    table = pathlib.Path(folder) / "poses.csv"
    for row in csv.DictReader(table.open()) if table.exists() else []:
        time = float(row["time"])
        true = truth(time)
        if not row["x"] or true is None:
            rows.append((time, row["state"], None, None, None, None, None))
            continue
        shift = np.array([float(row[axis]) for axis in "xyz"]) - true.position
        found = Rotation.from_euler("xyz", [float(row[angle]) for angle in AXES[3:]])
        turn = (found * true.rotation.inv()).as_rotvec()
        matrix = covariance(row)
        if scatter is not None:
            to_map = np.kron(np.eye(2), true.rotation.as_matrix())
            matrix = matrix + to_map @ scatter @ to_map.T
        of_pose = normalised(np.concatenate([shift, turn]), matrix)
        metres, degrees = float(np.linalg.norm(shift)), float(np.degrees(np.linalg.norm(turn)))
        of_parts = normalised(shift, matrix[:3, :3]), of_pose, normalised(turn, matrix[3:, 3:])
        rows.append((time, row["state"], metres, degrees, *of_parts))
    return rows


class MapTruth:
    """Where a map has what was truly elsewhere: the true way of the walk of which it was made, laid over that in the map.

    Maps are bent. `whole` lays all of it over at once, `at_place` what lies around a place, as a map is judged by who is
    found there.
    """

    LOCAL = 6.0

    def __init__(self, mapped, true):
        pairs = [(Pose(mapped.positions[i], mapped.rotations[i]), true.at(time)) for i, time in enumerate(mapped.times)]
        self.pairs = [pair for pair in pairs if pair[1] is not None]
        self.true_places = np.array([pair[1].position for pair in self.pairs])
        places = np.array([pair[0].position for pair in self.pairs])
        self.whole = laid_over(places, self.true_places)
        off = places - (self.whole.rotation.apply(self.true_places) + self.whole.position)
        self.ate = float(np.sqrt((off**2).sum(axis=1).mean()))
        self.of_cells = {}

    def distance(self, pose):
        """Metres from a true pose to the true way of the map."""
        return float(np.linalg.norm(self.true_places - pose.position, axis=1).min())

    def at_place(self, pose):
        """The motion that lays the surroundings of a true pose over the map's, by the poses on the way there."""
        cell = tuple(np.round(pose.position).astype(int))
        if cell not in self.of_cells:
            near = np.flatnonzero(np.linalg.norm(self.true_places - np.array(cell), axis=1) < self.LOCAL)
            pairs = [self.pairs[i] for i in near] or self.pairs
            turn = Rotation.concatenate([a.rotation * b.rotation.inv() for a, b in pairs]).mean()
            shift = np.mean([a.position - turn.apply(b.position) for a, b in pairs], axis=0)
            self.of_cells[cell] = Pose(shift, turn)
        return self.of_cells[cell]
