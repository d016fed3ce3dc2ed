#!/usr/bin/env python3
"""Localises pieces of every real planar log of the data folder in a map of its first half, and prints one table.

    scripts/field_localize.py                          aces, fr079, intel, mit-csail: 40 pieces of 60 s each
    scripts/field_localize.py --logs aces --pieces 8   less
    scripts/field_localize.py --logs orebro fhw fr101-rawodo    thinned logs: 60 scans each
    scripts/field_localize.py --logs intel --map-of aces        in another building's map, where nothing may be localised
    scripts/field_localize.py --kidnap --logs intel             two pieces of the rest glued together
    scripts/field_localize.py --logs aces --odometry "jump 3 m"  pieces with wrong odometry: field_odometry_faults.py names the faults
    scripts/field_localize.py --space                  odd sweeps of real 3D drives in maps of the even ones

The truth is the map of the whole log. The map of the first half alone is bent against it where loops close later, by more
than a metre in aces: so the whole is put over the half place by place, by the common poses nearest to it. A piece is known
if a pose of the map's part lies within 3 m of its way; many such only begin at the end of the map's way, or touch it. Its
place is contained in the map if it stays within 2 m of the map's way for 10 s. Needs Python 3 alone. The data folder
is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import concurrent.futures
import pathlib
import statistics
import sys
import tempfile

from field_localize_kidnap import kidnaps
from field_odometry_faults import FAULTS
from field_localize_log import LASTING, LOGS, REPOSITORY, Log, data_folder, is_wrong, longest_false


def share(part, whole):
    return f"{part}/{whole} ({100 * part / whole:.0f} %)" if whole else "0/0"


def spread(values, unit):
    """Median and what nine in ten do not exceed."""
    if not values:
        return "never"
    return f"{statistics.median(values):.1f} {unit} (90 %: {sorted(values)[int(0.9 * len(values))]:.1f})"


def first_right(piece):
    """The first scan that is localised and right."""
    return next((row for row in piece["rows"] if row[1] == "localised" and not is_wrong(row)), None)


def wrong_ones(log, pieces):
    lasting = [(round(p["skip"]), longest_false(p["rows"], log.count)) for p in pieces]
    return [(skip, round(false, 1)) for skip, false in lasting if false > LASTING]


def found_after(log, pieces, since):
    """For each piece that is found: seconds or scans from a moment of it."""
    found = [(first_right(piece), since(piece)) for piece in pieces if first_right(piece)]
    return [max(log.count(time, row[0]), 0.0) for row, time in found]


def quality(pieces):
    """Errors while it is localised and right, and whether the covariance says so."""
    rows = [row for piece in pieces for row in piece["rows"] if row[1] == "localised" and row[2] is not None]
    good = [row for row in rows if not is_wrong(row)]
    if not good:
        return "nothing localised"
    metres, degrees = (statistics.median(row[i] for row in good) for i in (2, 3))
    normal = statistics.fmean(min(row[4], 100) for row in good)
    return (f"error {metres:.3f} m {degrees:.2f} deg, NEES {normal:.1f} (3), "
            f"95 % within: {share(sum(row[4] < 7.815 for row in good), len(good))}")


def summary(log, pieces):
    known = [p for p in pieces if p["known"]]
    contained = [p for p in pieces if p["contained"] is not None]
    outside = [p for p in pieces if not p["known"]]
    rows = [row for piece in known for row in piece["rows"]]
    in_contained = found_after(log, contained, lambda p: p["contained"])
    of_all = found_after(log, known, lambda p: p["rows"][0][0])
    near = found_after(log, known, lambda p: p["reached"])
    wrong = wrong_ones(log, pieces)
    print(f"{log.name:10} contained: found {share(len(in_contained), len(contained))}, after {spread(in_contained, log.unit)} since near")
    print(f"{'':10} known: found {share(len(of_all), len(known))}, after {spread(of_all, log.unit)}, {spread(near, log.unit)} since near, "
          f"localised {share(sum(row[1] == 'localised' for row in rows), len(rows))} of scans")
    print(f"{'':10} false > {LASTING:.0f} {log.unit}: {len(wrong)}; {quality(pieces)}")
    print(f"{'':10} outside {len(outside)}, localised there: {sum(any(r[1] == 'localised' for r in p['rows']) for p in outside)} "
          f"(wrongly {sum(any(is_wrong(r) for r in p['rows']) for p in outside)}); "
          f"{statistics.median(p['cpu'] for p in pieces):.1f} CPU-s a piece", flush=True)
    missed = [f"{p['skip']:.0f}{' contained' if p['contained'] is not None else ''}" for p in known if not first_right(p)]
    if missed or wrong:
        print(f"{'':10} never found: {', '.join(missed)}; false (skip, {log.unit}): {wrong}", flush=True)


def foreign(log, pieces, other):
    """What of a log is localised in the map of another building: nothing is right."""
    localised = [p for p in pieces if any(r[1] == "localised" for r in p["rows"])]
    print(f"{log.name:10} in the map of {other}: {len(localised)} of {len(pieces)} localised {[round(p['skip']) for p in localised]}; "
          f"{statistics.median(p['cpu'] for p in pieces):.1f} CPU-s a piece", flush=True)


def show(log, piece):
    begin = piece["rows"][0][0] if piece["rows"] else 0.0
    changes = [f"{log.count(begin, c['time']):.1f} {c['state']} {c['reason']}" for c in piece["changes"]]
    since = None if piece["contained"] is None or not piece["rows"] else round(log.count(begin, piece["contained"]), 1)
    print(f"  {piece['skip']:.0f} known {piece['known']} contained {since} exit {piece['code']} {'; '.join(changes)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(REPOSITORY / "target/release/portolan"))
    parser.add_argument("--logs", nargs="+", default=["aces", "fr079", "intel", "mit-csail"], choices=list(LOGS))
    parser.add_argument("--map-of", choices=list(LOGS), help="in the map of this log instead: nothing may be localised")
    parser.add_argument("--space", nargs="*", metavar="DRIVE", help="3D drives instead; all of them where none is named")
    parser.add_argument("--every", type=int, default=5, help="with --space: every so manieth odd sweep is a start")
    parser.add_argument("--pieces", type=int, default=40)
    parser.add_argument("--length", type=float, default=60.0, help="of a piece, in seconds; in thinned logs in scans")
    parser.add_argument("--skip", type=float, nargs="+", help="pieces that begin here, in the same unit")
    parser.add_argument("--kidnap", action="store_true", help="two pieces glued together instead")
    parser.add_argument("--pairs", type=int, default=20, help="with --kidnap: so many, those that the map does not know left out")
    parser.add_argument("--carried", choices=["odometry-jumps", "odometry-stands"], default="odometry-jumps",
                        help="with --kidnap: what the odometry says meanwhile")
    parser.add_argument("--odometry", choices=list(FAULTS), help="pieces are of the log with this fault; the map is not")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--maps", help="folder where maps are kept from run to run")
    parser.add_argument("--details", action="store_true", help="one line for each piece")
    arguments = parser.parse_args()
    if not data_folder().exists():
        sys.exit(f"{data_folder()} is missing: set PORTOLAN_DATA to the folder of the recordings")
    with tempfile.TemporaryDirectory() as temporary:
        cache = pathlib.Path(arguments.maps or temporary)
        cache.mkdir(parents=True, exist_ok=True)
        if arguments.space is not None:
            # What makes bags of other formats needs more than Python.
            from field_localize_space import drives

            drives(arguments.program, arguments.space, cache, arguments.every, arguments.workers, arguments.details)
            return
        other = arguments.map_of and Log(arguments.program, arguments.map_of, cache).map
        for name in arguments.logs:
            log = Log(arguments.program, name, cache)
            if arguments.odometry:
                log.spoil(FAULTS[arguments.odometry], cache)
            if arguments.kidnap:
                kidnaps(log, arguments.pairs, arguments.carried, arguments.workers, arguments.details)
                continue
            length = min(arguments.length, 0.2 * log.length)
            # In another building's map nothing is known: pieces of the whole log.
            begin = 0.0 if other else log.half
            room = log.length - begin - length
            starts = arguments.skip or [begin + room * i / max(arguments.pieces - 1, 1) for i in range(arguments.pieces)]
            with concurrent.futures.ThreadPoolExecutor(arguments.workers) as pool:
                pieces = list(pool.map(lambda s: log.piece(s, length, other), starts))
            for piece in pieces if arguments.details else []:
                show(log, piece)
            foreign(log, pieces, arguments.map_of) if other else summary(log, pieces)


if __name__ == "__main__":
    main()
