#!/usr/bin/env python3
"""reverse.py LOG.clf.bz2 IN.relations OUT.clf OUT.relations [--there-first] : a CARMEN log driven backwards.

Scans and odometry come in the opposite order, as of a robot that reverses along its whole way: places are met for the
first time where they were left for the last. Stamps are mirrored, so that pauses, stalls and bursts stay what they are.
With --there-first the log as it was stands before it: the robot drives its whole way and all of it back. Relations then
also say that every scan of the way back was taken where its twin was. Needs Python 3 alone.
"""
import bz2
import sys


def stamp_field(words):
    """Where the line has its time; none in lines that are not data."""
    if words and words[0] == "FLASER":
        return 2 + int(words[1]) + 6
    return 7 if words and words[0] == "ODOM" else None


def reversed_line(words, mirror):
    at = stamp_field(words)
    changed = list(words)
    # Time of the sender and, behind the name of the host, of the logger.
    for field in (at, at + 2):
        if field < len(words):
            changed[field] = f"{mirror - float(words[field]):.6f}"
    if words[0] == "ODOM":
        changed[4:6] = [str(-float(velocity)) for velocity in words[4:6]]
    return " ".join(changed) + "\n"


def mirrored(relation, mirror):
    first, second, *rest = relation.split()
    return " ".join([f"{mirror - float(first):.6f}", f"{mirror - float(second):.6f}", *rest]) + "\n"


def twins(data, mirror):
    """Relations of no motion between every tenth scan and its twin on the way back."""
    times = [float(words[stamp_field(words)]) for words in data if words[0] == "FLASER"]
    return [f"{time:.6f} {mirror - time:.6f} 0 0 0 0 0 0\n" for time in times[::10]]


def main():
    log, source, output, relations = sys.argv[1:5]
    there_first = sys.argv[5:] == ["--there-first"]
    with bz2.open(log, "rt", errors="replace") as lines:
        data = [words for words in map(str.split, lines) if stamp_field(words)]
    times = [float(words[stamp_field(words)]) for words in data]
    # On the way back the first scan comes a tenth of a second after the last one of the way there.
    mirror = 2.0 * max(times) + 0.1 if there_first else min(times) + max(times)
    with open(output, "w") as out:
        if there_first:
            out.writelines(" ".join(words) + "\n" for words in data)
        out.writelines(reversed_line(words, mirror) for words in reversed(data))
    with open(source) as lines, open(relations, "w") as out:
        known = list(lines)
        if there_first:
            out.writelines(known + twins(data, mirror))
        out.writelines(mirrored(relation, mirror) for relation in known)


if __name__ == "__main__":
    if len(sys.argv) not in (5, 6):
        sys.exit(__doc__)
    main()
