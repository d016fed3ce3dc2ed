#!/usr/bin/env python3
"""Localises starts of simulated walks in the map of another walk through the same place, and prints one table.

    scripts/starts_3d.py                                   museum, garage, park: 10 starts of each kind
    scripts/starts_3d.py --scenes park --starts 25         one of them
    scripts/starts_3d.py --variants moving moving-no-imu   some kinds of starts

Every start is of a walk of its own, with a seed, a length and therefore a place of turning round of its own. Walks of one
place share their paths to some centimetres; their gait, noise, people, and the direction in which they are walked differ.
Standing: 2 s before it walks on from where it turned, or at the beginning. Moving: in the middle of the way. Nothing says
where they are. The truth is laid over the map around each place (as `field_localize.py` does it), and as a whole. A start's
place is contained in the map if all of its way stays within 2 m of the map's. Needs numpy and scipy.
"""
import argparse
import concurrent.futures
import pathlib
import tempfile

import numpy as np

from field_localize_log import REPOSITORY, STAYS_NEAR, mapped, run
from poses_3d import MapTruth, Way, errors
from start_figures import median, one_start, right_rows, start_figures

SCENES = ("museum", "garage", "park")
VARIANTS = ("standing", "moving", "standing-no-imu", "moving-no-imu")
# Seconds of the shortest walk, and before a walk's end within which nothing starts.
SHORTEST, HOME = 30.0, 3.0
# Who stands is slower than this, m/s, and stands so long before he walks on, seconds.
STILL, STANDS = 0.05, 2.0
# Places in walks are spread by the golden ratio.
GOLDEN = 0.618034


class Walk:
    """A simulated walk through a scene."""

    def __init__(self, options, scene, seed, seconds):
        name = f"{scene}_{options.building_seed}_{seed}_{seconds:.0f}_{options.columns}"
        self.bag, self.seconds = options.folder / f"{name}.bag", seconds
        if not self.bag.exists():
            where = ["--building-seed", options.building_seed, "--seed", seed, "--seconds", f"{seconds:.0f}"]
            code, _ = run([options.program, "simulate", scene, *where, "--beams", options.columns, "--no-gnss", "-o", self.bag, "-q"])
            assert code == 0, f"simulate {scene}: exit code {code}"
        self.truth = Way(self.bag.with_suffix(".truth.tum"))
        self.start = self.truth.times[0]

    def turns_round(self):
        """Seconds until it walks on after having stood for the last time before it is home; at the beginning if it never did."""
        step = 20
        times, places = self.truth.times[::step] - self.start, self.truth.positions[::step]
        still = np.linalg.norm(np.diff(places, axis=0), axis=1) < STILL * np.diff(times)
        goes_on = np.flatnonzero(still[:-1] & ~still[1:]) + 1
        return next((times[i] for i in reversed(goes_on) if times[i] < self.seconds - HOME - STANDS), STANDS)


def start(options, known, truth, walk, skip, more):
    """One start, with errors in the map as it is bent there, and in the map as a whole."""
    with tempfile.TemporaryDirectory() as results:
        folder = pathlib.Path(results)
        span = ["--skip", f"{skip:.3f}", "--duration", options.seconds, "--threads", 1, "-q"]
        _, cpu = run([options.program, "localize", known, walk.bag, "-o", folder, *span, *more])
        here = lambda motion: lambda time: (true := walk.truth.at(time)) and motion(true) * true
        rows, of_whole = errors(folder, here(truth.at_place)), errors(folder, here(lambda _: truth.whole))
    way = [pose for pose in (walk.truth.at(walk.start + skip + t) for t in np.arange(0.0, options.seconds, 0.5)) if pose]
    contained = all(truth.distance(pose) < STAYS_NEAR for pose in way)
    return {"skip": skip, "bag": walk.bag.stem, "rows": rows, "of_whole": of_whole, "cpu": cpu, "contained": contained}


def scene(options, name):
    first = Walk(options, name, 1, options.map_seconds)
    folder = mapped(options.program, first.bag, options.folder / f"{first.bag.stem}_map", ["--no-xray"])
    truth = MapTruth(Way(folder / "trajectory.tum"), first.truth)
    print(f"{name}: map of {options.map_seconds:.0f} s, ATE {truth.ate:.3f} m", flush=True)
    count = options.starts
    lengths = [options.map_seconds - (options.map_seconds - SHORTEST) * i / max(count - 1, 1) for i in range(count)]
    walks = [Walk(options, name, 2 + i, length) for i, length in enumerate(lengths)]
    moving = [2 * STANDS + (walk.seconds - options.seconds - HOME - 2 * STANDS) * (GOLDEN * (i + 1) % 1.0) for i, walk in enumerate(walks)]
    standing = [0.0] + [max(walk.turns_round() - STANDS, 0.0) for walk in walks[1:]]
    for variant in options.variants:
        more = ["--no-imu"] if variant.endswith("no-imu") else []
        skips = standing if variant.startswith("standing") else moving
        with concurrent.futures.ThreadPoolExecutor(options.workers) as pool:
            pieces = list(pool.map(lambda pair: start(options, folder / "map.pbstream", truth, *pair, more), zip(walks, skips)))
        as_a_whole = median([row[2] for row in right_rows(pieces, "of_whole")])
        print(f"{name} {variant}: {start_figures(pieces)} for {options.seconds:.0f} s each; in the map as a whole {as_a_whole:.3f} m", flush=True)
        for piece in pieces if options.details else []:
            print(f"  {piece['bag']} from {piece['skip']:.1f} s: {one_start(piece)}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(REPOSITORY / "target/release/portolan"))
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES)
    parser.add_argument("--variants", nargs="+", default=VARIANTS, choices=VARIANTS)
    parser.add_argument("--starts", type=int, default=10, help="of each kind in each scene")
    parser.add_argument("--seconds", type=float, default=8.0, help="of recording that is looked at from each start")
    parser.add_argument("--map-seconds", type=float, default=90.0, help="of the walk that is mapped")
    parser.add_argument("--building-seed", type=int, default=1)
    parser.add_argument("--columns", type=int, default=450, help="firings of a revolution")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=pathlib.Path, help="where recordings and maps are kept from run to run")
    parser.add_argument("--details", action="store_true", help="one line for each start")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        options.folder = options.folder or pathlib.Path(temporary)
        options.folder.mkdir(parents=True, exist_ok=True)
        for name in options.scenes:
            scene(options, name)


if __name__ == "__main__":
    main()
