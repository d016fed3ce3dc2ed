#!/usr/bin/env python3
"""jitter_log.py LOG.clf.bz2 IN.relations OUT.clf OUT.relations SECONDS [gauss|late] : a planar log whose stamps are off.

Each stamp of FLASER and ODOM lines, one kind after the other, is off by a random time with that standard deviation
(gauss), or late by a random time with that mean (late, exponential); stamps keep their order. Relations get the new stamps.
Needs Python 3 alone.
"""
import bisect
import bz2
import random
import sys

NEAR = 0.02


def jittered(log, output, seconds, how):
    """Writes the log and returns the new stamps of scans by their old ones."""
    chance, last, stamps = random.Random(5), {}, {}
    with bz2.open(log, "rt", errors="replace") as lines, open(output, "w") as out:
        for line in lines:
            words = line.split()
            if len(words) > 8 and words[0] in ("FLASER", "ODOM"):
                stamp = float(words[-3])
                off = chance.gauss(0.0, seconds) if how == "gauss" else chance.expovariate(1.0 / seconds)
                new = max(stamp + off, last.get(words[0], -1e18) + 0.001)
                last[words[0]] = new
                if words[0] == "FLASER":
                    stamps[stamp] = new
                words[-3], words[-1] = f"{new:.6f}", f"{float(words[-1]) + new - stamp:.6f}"
                line = " ".join(words) + "\n"
            out.write(line)
    return stamps


def main():
    log, source, output, relations = sys.argv[1:5]
    stamps = jittered(log, output, float(sys.argv[5]), (sys.argv[6:] or ["gauss"])[0])
    old = sorted(stamps)

    def new(time):
        at = bisect.bisect_left(old, time)
        nearest = min(old[max(at - 1, 0) : at + 1], key=lambda stamp: abs(stamp - time))
        return stamps[nearest] if abs(nearest - time) < NEAR else None

    with open(source) as lines, open(relations, "w") as out:
        for words in map(str.split, lines):
            ends = [new(float(word)) for word in words[:2]]
            if None not in ends:
                out.write(" ".join([*(f"{end:.6f}" for end in ends), *words[2:]]) + "\n")


if __name__ == "__main__":
    if len(sys.argv) not in (6, 7):
        sys.exit(__doc__)
    main()
