#!/usr/bin/env python3
"""reverse.py LOG.clf.bz2 IN.relations OUT.clf OUT.relations : a CARMEN log driven backwards, with its relations.

Scans and odometry come in the opposite order, as of a robot that reverses along its whole way: places are met for the
first time where they were left for the last. Stamps are mirrored, so that pauses, stalls and bursts stay what they are.
Needs Python 3 alone.
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


def main():
    log, source, output, relations = sys.argv[1:]
    with bz2.open(log, "rt", errors="replace") as lines:
        data = [words for words in map(str.split, lines) if stamp_field(words)]
    times = [float(words[stamp_field(words)]) for words in data]
    mirror = min(times) + max(times)
    with open(output, "w") as out:
        out.writelines(reversed_line(words, mirror) for words in reversed(data))
    with open(source) as lines, open(relations, "w") as out:
        for line in lines:
            first, second, *rest = line.split()
            out.write(" ".join([f"{mirror - float(first):.6f}", f"{mirror - float(second):.6f}", *rest]) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main()
