#!/usr/bin/env python3
"""Keeps maps of the first part of real planar logs alive with pieces of the middle, and localises pieces of the end in them.

    scripts/field_living.py                      aces, fr079, intel, mit-csail
    scripts/field_living.py --logs aces --rounds 3

The first 40 % of a log are mapped. Pieces of 60 s of the next 30 % are localised in that map one after the other, each in the
map that the one before left: with --save-map (all is added) and with --update (the map is brought up to date), over and over.
Then pieces of 40 s of the last 30 % are localised in the three maps. The truth is the map of the whole log, put over that of
the first part place by place, as in field_localize.py, whose bounds of what is wrong count here, too. Needs Python 3 alone.
"""
import argparse
import concurrent.futures
import json
import pathlib
import shutil
import statistics
import sys
import tempfile

from field_localize_log import LASTING, LOGS, REPOSITORY, Log, data_folder, errors, is_wrong, longest_false, run

# Shares of a log that are mapped, and until where pieces bring the map up to date.
MAPPED, UPDATED = 0.4, 0.7
UPDATE_SECONDS, TEST_SECONDS = 60.0, 40.0


def starts(log, first, last, seconds):
    """Pieces of a part of a log, one after the other, seconds from its start."""
    length = log.end - log.start
    count = int((last - first) * length / seconds)
    return [first * length + i * seconds for i in range(count)]


def grown(log, option, rounds, folder):
    """The map after all pieces of the middle, in so many rounds; its bytes after each piece, and what became of pieces."""
    path = folder / f"{log.name}{option}.pbstream"
    shutil.copy(log.map, path)
    sizes, refused, removed = [], 0, 0
    for _ in range(rounds):
        for skip in starts(log, MAPPED, UPDATED, UPDATE_SECONDS):
            with tempfile.TemporaryDirectory() as results:
                run([log.program, "localize", path, log.recording, "-o", results, "-q", "--threads", 1,
                     "--skip", skip, "--duration", UPDATE_SECONDS, option, path])
                saved = json.loads((pathlib.Path(results) / "report.json").read_text())["saved_map"]
                refused += "refused" in saved
                removed += (saved.get("renewal") or {}).get("removed_submaps", 0)
            sizes.append(path.stat().st_size)
        if option == "--save-map":
            break
    return path, sizes, refused, removed


def judged(log, path, workers):
    """How pieces of the end are found in a map."""

    def piece(skip):
        with tempfile.TemporaryDirectory() as results:
            folder = pathlib.Path(results)
            run([log.program, "localize", path, log.recording, "-o", folder, "-q", "--threads", 1,
                 "--skip", skip, "--duration", TEST_SECONDS])
            if not (folder / "poses.csv").exists():
                return [], 0.0
            changes = json.loads((folder / "changes.geojson").read_text())["features"]
            return errors(folder, log.truth.at), sum(f["properties"]["area_m2"] for f in changes)

    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        pieces = list(pool.map(piece, starts(log, UPDATED, 1.0, TEST_SECONDS)))
    rows = [row for rows, _ in pieces for row in rows]
    localised = [row for row in rows if row[1] == "localised" and row[2] is not None]
    right = [row for row in localised if not is_wrong(row)]
    found = sum(any(r[1] == "localised" and r[2] is not None and not is_wrong(r) for r in rows) for rows, _ in pieces)
    false = sum(longest_false(rows) > LASTING for rows, _ in pieces)
    error = statistics.median(row[2] for row in right) if right else float("nan")
    return (f"found {found}/{len(pieces)}, right {100 * len(right) / max(len(rows), 1):.1f} % of scans, error {error:.3f} m, "
            f"false > {LASTING:.0f} s: {false}, contradicted {sum(area for _, area in pieces):.2f} m²")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(REPOSITORY / "target/release/portolan"))
    parser.add_argument("--logs", nargs="+", default=list(LOGS), choices=list(LOGS))
    parser.add_argument("--rounds", type=int, default=3, help="how often the pieces of the middle update the map")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--maps", help="folder where maps are kept from run to run")
    arguments = parser.parse_args()
    if not data_folder().exists():
        sys.exit(f"{data_folder()} is missing: set PORTOLAN_DATA to the folder of the recordings")
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(arguments.maps or temporary)
        for name in arguments.logs:
            log = Log(arguments.program, name, folder, MAPPED)
            size = lambda path: f"{pathlib.Path(path).stat().st_size / 1e6:.2f} MB"
            print(f"{name:10} first part  {size(log.map)}: {judged(log, log.map, arguments.workers)}", flush=True)
            for option in ("--save-map", "--update"):
                path, sizes, refused, removed = grown(log, option, arguments.rounds, folder)
                per_round = len(starts(log, MAPPED, UPDATED, UPDATE_SECONDS))
                ends = ", ".join(f"{bytes / 1e6:.2f}" for bytes in sizes[per_round - 1 :: per_round])
                print(f"{name:10} {option:11} {size(path)} (MB after each round: {ends}; {refused} pieces refused, "
                      f"{removed} submaps replaced): {judged(log, path, arguments.workers)}", flush=True)


if __name__ == "__main__":
    main()
