#!/usr/bin/env python3
"""spoil.py LOG.clf.bz2 OUT.clf HOW : a CARMEN log made worse, as recordings of other people are.

    third   every third scan                          half    every second beam
    near    readings beyond 8 m see nothing           drop    half of the readings, at random, see nothing
    noise   3 cm of noise on every reading            burst   40 of every 160 scans are missing
    noise10, noise20  10 or 20 cm of noise            rel2    noise of 2 % of the range
    salt    every fifth reading ends on the way, anywhere, as in dust and rain
    short   readings beyond 4 m see nothing, noise of 1 % of the range, as of the smallest scanners
    coarse  readings are rounded to 0.1 m             sides   only the third of the beams that look ahead sees anything
    post    a post of the robot itself hides a fifteenth of the beams, to the left of ahead, at 0.4 m
    hull    the robot's own hull hides a twelfth of the beams on either side, at 0.25 to 0.35 m
    leader  a person walks 0.9 to 1.6 m ahead, half a metre wide, and sways by 10 degrees
    full    what sees nothing, or farther than 8 m, reads 8 m
    zero    what sees nothing reads 0
    flipped the scanner is mounted upside down: beams run the other way round, which nothing tells
    stale   every fifth scan has the readings of the one before under its own stamp
    hang    so have all for 1.5 s of 20 s
    camera  only 57 degrees ahead see anything, 0.5 to 5 m, with noise of 0.003 of the squared range, as a depth camera
    fifth   every fifth beam
    right   only the beams to the right see anything
    long5   readings are 5 cm too long
    seconds, tenths   stamps tell whole seconds, or tenths
    untimed all stamps are 0
    floor   the scanner stands 0.3 m high and looks 2.5 degrees down: beams end on the floor 6.9 m ahead at the latest
    nod     the same, nodding by 2.5 degrees either way every 40 scans, as on a soft suspension
    dirt    a third of the beams, in six runs that stay, read 0.2 to 0.5 m
    wide    beams are 3 % farther apart than the log says
    crowd   six persons walk around the robot, 0.8 to 3 m away, each with a time of its own
    blind   for 10 s of every 60 s it sees nothing
    cover   for 10 s of every 60 s it sees a cloth over the scanner, 0.1 to 0.3 m away
    dense   for 10 s of every 60 s a dense crowd is around it, 0.4 to 2 m away, and moves
    metric  readings are in millimetres
    glass   one reading in five goes on through glass: it is 0.5 to 3 m too long, in runs of four beams

Odometry stays as it is. Needs Python 3 alone.
"""
import bz2
import math
import random
import sys

NOTHING = "81.83"
# What stamps are rounded down to, seconds; 0: there are none.
CLOCKS = {"seconds": 1.0, "tenths": 0.1, "untimed": 0.0}
# Standard deviations of noise: metres, and metres for each metre of range.
NOISES = {"noise": (0.03, 0.0), "noise10": (0.1, 0.0), "noise20": (0.2, 0.0), "rel2": (0.0, 0.02)}


def behind_leader(ranges, count):
    """A round body of 0.5 m ahead that comes nearer, goes off and sways, each with a time of its own."""
    n = len(ranges)
    away = 1.25 + 0.35 * math.sin(count / 37.0)
    middle = n / 2 + math.radians(10.0) * math.sin(count / 23.0) / math.pi * n
    half = math.asin(0.25 / away) / math.pi * n
    seen = lambda i: away - 0.25 * math.sqrt(max(0.0, 1.0 - ((i - middle) / half) ** 2))
    return [f"{min(float(r), seen(i)):.3f}" if abs(i - middle) < half else r for i, r in enumerate(ranges)]


def among_people(ranges, count):
    """Six round bodies of 0.5 m go round the robot, nearer and farther, either way."""
    n, nearest = len(ranges), [float(r) for r in ranges]
    for k in range(6):
        away = 1.9 + 1.1 * math.sin(count / (29.0 + 7.0 * k) + k)
        middle = n * (0.5 + 0.6 * math.sin(count / (61.0 + 13.0 * k) + 2.0 * k))
        half = math.asin(0.25 / away) / math.pi * n
        for i in range(max(0, math.ceil(middle - half)), min(n, math.floor(middle + half) + 1)):
            nearest[i] = min(nearest[i], away - 0.25 * math.sqrt(max(0.0, 1.0 - ((i - middle) / half) ** 2)))
    return [f"{r:.3f}" for r in nearest]


def above_floor(ranges, down_degrees):
    """What a scanner 0.3 m above the floor sees that looks down ahead, and up behind."""
    n, sees = len(ranges), []
    for i, r in enumerate(ranges):
        descent = math.sin(math.radians(down_degrees)) * math.cos((i / n - 0.5) * math.pi)
        on_floor = 0.3 / descent if descent > 1e-3 else math.inf
        sees.append(f"{on_floor:.3f}" if on_floor < float(r) else r)
    return sees


def hidden(ranges, how, chance, seconds):
    """What is seen in spite of what is around the scanner for 10 s of every 60 s."""
    if how not in ("blind", "cover", "dense") or seconds % 60.0 < 50.0:
        return ranges
    if how == "dense":
        return in_crowd(ranges, seconds)
    return [NOTHING if how == "blind" else f"{chance.uniform(0.1, 0.3):.3f}" for _ in ranges]


def in_crowd(ranges, seconds):
    """Bodies side by side all around, each nearer and farther with a time of its own."""
    body = lambda i: i * 18 // len(ranges)
    away = lambda i: 1.2 + 0.8 * math.sin(seconds / (0.6 + body(i) * 0.34 % 1.0) + 2.0 * body(i))
    return [f"{min(float(r), away(i)):.3f}" for i, r in enumerate(ranges)]


def spoilt(ranges, how, chance, count):
    if how == "floor":
        return above_floor(ranges, 2.5)
    if how == "nod":
        return above_floor(ranges, 2.5 * math.sin(count / 40.0 * math.tau))
    if how == "crowd":
        return among_people(ranges, count)
    if how == "dirt":
        on_glass = lambda i: 0.2 + 0.05 * (i * 6 // len(ranges))
        is_dirty = lambda i: i * 18 // len(ranges) % 3 == 1
        return [f"{chance.gauss(on_glass(i), 0.01):.3f}" if is_dirty(i) else r for i, r in enumerate(ranges)]
    if how == "wide":
        middle = (len(ranges) - 1) / 2
        at = lambda i: round(middle + 1.03 * (i - middle))
        return [ranges[at(i)] if 0 <= at(i) < len(ranges) else NOTHING for i in range(len(ranges))]
    if how == "metric":
        return [f"{1000.0 * float(r):.0f}" for r in ranges]
    if how == "hull":
        twelfth = len(ranges) // 12
        own = lambda i: 0.25 + 0.1 * min(i, len(ranges) - 1 - i) / twelfth
        is_own = lambda i: min(i, len(ranges) - 1 - i) < twelfth
        return [f"{chance.gauss(own(i), 0.005):.3f}" if is_own(i) else r for i, r in enumerate(ranges)]
    if how == "leader":
        return behind_leader(ranges, count)
    if how == "full":
        return [r if 0.0 < float(r) < 8.0 else "8.00" for r in ranges]
    if how == "zero":
        return [r if float(r) < 80.0 else "0.00" for r in ranges]
    if how == "flipped":
        return ranges[::-1]
    if how == "half":
        return ranges[::2]
    if how == "fifth":
        return ranges[::5]
    if how == "right":
        return [r if i < len(ranges) // 2 else NOTHING for i, r in enumerate(ranges)]
    if how == "long5":
        return [f"{float(r) + 0.05:.3f}" if float(r) < 60.0 else r for r in ranges]
    if how == "camera":
        each_side = round(len(ranges) * 57 / 180 / 2)
        is_seen = lambda i, r: abs(i - len(ranges) / 2) <= each_side and 0.5 <= r <= 5.0
        noisy = lambda r: f"{max(0.1, chance.gauss(r, 0.003 * r * r)):.3f}"
        return [noisy(float(r)) if is_seen(i, float(r)) else NOTHING for i, r in enumerate(ranges)]
    if how == "near":
        return [r if float(r) < 8.0 else NOTHING for r in ranges]
    if how == "drop":
        return [r if chance.random() > 0.5 else NOTHING for r in ranges]
    if how == "short":
        return [f"{float(r) * chance.gauss(1.0, 0.01):.3f}" if float(r) < 4.0 else NOTHING for r in ranges]
    if how == "coarse":
        return [f"{max(0.1, round(float(r), 1)):.2f}" for r in ranges]
    if how == "sides":
        third = len(ranges) // 3
        return [r if third <= i < len(ranges) - third else NOTHING for i, r in enumerate(ranges)]
    if how == "post":
        first, count = len(ranges) * 11 // 20, len(ranges) // 15
        return [f"{chance.gauss(0.4, 0.005):.3f}" if first <= i < first + count else r for i, r in enumerate(ranges)]
    if how == "glass":
        longer = [chance.uniform(0.5, 3.0) if chance.random() < 0.2 else 0.0 for _ in ranges[::4]]
        return [f"{float(r) + longer[i // 4]:.3f}" if float(r) < 60.0 else r for i, r in enumerate(ranges)]
    if how == "salt":
        way = lambda r: chance.uniform(0.1, min(float(r), 20.0))
        return [f"{way(r):.3f}" if chance.random() < 0.2 else r for r in ranges]
    if how in NOISES:
        of_all, of_metre = NOISES[how]
        noisy = lambda r: max(0.05, float(r) + chance.gauss(0.0, of_all + of_metre * float(r)))
        return [f"{noisy(r):.3f}" if float(r) < 60.0 else r for r in ranges]
    if how in ("third", "burst", "stale", "hang", "blind", "cover", "dense", *CLOCKS):
        return ranges
    sys.exit(f"there is no way to spoil a log that is called {how}")


def is_stale(how, count, seconds):
    """Whether the driver sends the readings before once more."""
    return how == "stale" and count % 5 == 0 or how == "hang" and seconds % 20.0 < 1.5


def with_clock(line, resolution):
    """A line of FLASER or ODOM with the stamps of a coarse clock."""
    words = line.split()
    for field in (-3, -1):
        stamp = math.floor(float(words[field]) / resolution) * resolution if resolution else 0.0
        words[field] = f"{stamp:.6f}"
    return " ".join(words) + "\n"


def main():
    log, output, how = sys.argv[1:]
    chance, count, first, last = random.Random(7), 0, None, None
    with bz2.open(log, "rt", errors="replace") as lines, open(output, "w") as out:
        for line in lines:
            if line.startswith("FLASER"):
                count += 1
                if how == "third" and count % 3 or how == "burst" and count // 40 % 4 == 3:
                    continue
                words = line.split()
                n = int(words[1])
                ranges = spoilt(words[2 : 2 + n], how, chance, count)
                stamp = float(words[-3])
                first = stamp if first is None else first
                ranges = hidden(ranges, how, chance, stamp - first)
                if last and is_stale(how, count, stamp - first):
                    ranges = last
                last = ranges
                line = " ".join(["FLASER", str(len(ranges)), *ranges, *words[2 + n :]]) + "\n"
            if how in CLOCKS and line.startswith(("FLASER", "ODOM")):
                line = with_clock(line, CLOCKS[how])
            out.write(line)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main()
