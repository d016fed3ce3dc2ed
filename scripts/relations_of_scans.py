#!/usr/bin/env python3
"""relations_of_scans.py LOG.clf IN.relations OUT.relations : the relations both of whose ends are scans of a CARMEN log.

Where scans were left out of a log, poses between the others are interpolated, and relations between them tell nothing of
the map. Needs Python 3 alone.
"""
import bisect
import sys

NEAR = 0.02


def main():
    log, source, output = sys.argv[1:]
    with open(log, errors="replace") as lines:
        times = sorted(float(line.split()[-3]) for line in lines if line.startswith("FLASER"))

    def is_scan(time):
        i = bisect.bisect_left(times, time)
        return any(abs(t - time) < NEAR for t in times[max(i - 1, 0) : i + 1])

    with open(source) as relations, open(output, "w") as out:
        for line in relations:
            words = line.split()
            if words and not line.startswith("#") and is_scan(float(words[0])) and is_scan(float(words[1])):
                out.write(line)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main()
