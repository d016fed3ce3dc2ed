#!/usr/bin/env python3
"""Maps real planar logs as nobody recorded them and prints one table: driven backwards, begun later, spoilt.

    scripts/field_variants.py [--programs target/release/portolan ...] [--logs aces,fhw] [--variants backwards,from-40]

Variants: backwards (reverse.py), return (there and all the way back), mirrored (left is right), slow-0.1 and slow--0.1
(slow_scans.py: scans take 0.1 s and do not say so, the last beam first), jitter-0.03, late-0.06 (jitter_log.py: stamps are
off by so many seconds), inline (odometry in the lines of scans alone), from-20, from-40, from-60 (the first so many per cent of the scans are missing), those of
spoil.py, and several of them joined by +, as in backwards+half. Judged by the relations between scans that are left.
Needs Python 3 alone. The data folder is $PORTOLAN_DATA, or ../shared/data.
"""
import argparse
import bz2
import pathlib
import subprocess
import sys
import tempfile

from field import LOGS, REPOSITORY, data_folder, map_log, row

SCRIPTS = pathlib.Path(__file__).resolve().parent
VARIANTS = "backwards,from-20,from-40,from-60,third,half,near,drop,noise,burst"


def script(name, *arguments):
    subprocess.run([sys.executable, SCRIPTS / name, *arguments], check=True, stdout=subprocess.DEVNULL)


def begun_later(log, output, percent):
    lines = bz2.open(log, "rt", errors="replace").readlines()
    is_scan = [line.startswith("FLASER") for line in lines]
    left_out = sum(is_scan) * percent // 100
    with open(output, "w") as out:
        for line, scan in zip(lines, is_scan):
            left_out -= scan
            if left_out < 0 or line.startswith("PARAM"):
                out.write(line)


def negated(word):
    return word.removeprefix("-") if word.startswith("-") else "-" + word


def mirrored(log, source, output, relations):
    """Left and right change places: beams, lateral motion and turns."""
    with bz2.open(log, "rt", errors="replace") as lines, open(output, "w") as out:
        for words in map(str.split, lines):
            if words and words[0] == "FLASER":
                n = int(words[1])
                words[2 : 2 + n] = words[2 : 2 + n][::-1]
                for at in (n + 3, n + 4, n + 6, n + 7):
                    words[at] = negated(words[at])
            elif words and words[0] == "ODOM":
                for at in (2, 3, 5):
                    words[at] = negated(words[at])
            out.write(" ".join(words) + "\n")
    with open(source) as lines, open(relations, "w") as out:
        for words in map(str.split, lines):
            for at in (3, 5, 7):
                words[at] = negated(words[at])
            out.write(" ".join(words) + "\n")


def slowed(program, log, output, seconds, more):
    mapped = output.with_suffix("")
    command = [program, "map", log, "-o", mapped, "--no-xray", "-q", *more]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
    script("slow_scans.py", log, mapped / "trajectory.tum", output, seconds)


def changed(log, relations, variant, folder, program, more):
    """Log and relations after the changes that a variant names; a program maps it where a trajectory is needed."""
    for number, change in enumerate(variant.split("+")):
        plain = folder / f"{number}.clf"
        if change.startswith(("jitter-", "late-")):
            of_change = folder / f"{number}.relations"
            how, seconds = change.split("-")
            script("jitter_log.py", log, relations, plain, of_change, seconds, "late" if how == "late" else "gauss")
            relations = of_change
        elif change in ("backwards", "return", "mirrored"):
            of_change = folder / f"{number}.relations"
            if change == "mirrored":
                mirrored(log, relations, plain, of_change)
            else:
                more = ["--there-first"] if change == "return" else []
                script("reverse.py", log, relations, plain, of_change, *more)
            relations = of_change
        elif change.startswith("from-"):
            begun_later(log, plain, int(change.removeprefix("from-")))
        elif change == "inline":
            lines = bz2.open(log, "rt", errors="replace")
            plain.write_text("".join(line for line in lines if not line.startswith("ODOM")))
        elif change.startswith("slow-"):
            slowed(program.resolve(), log, plain, change.removeprefix("slow-"), more)
        else:
            script("spoil.py", log, plain, change)
        log = plain.with_suffix(".clf.bz2")
        log.write_bytes(bz2.compress(plain.read_bytes(), 1))
    left = folder / "left.relations"
    script("relations_of_scans.py", plain, relations, left)
    return plain, left


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    arguments.add_argument("--programs", nargs="+", default=[REPOSITORY / "target/release/portolan"], type=pathlib.Path)
    arguments.add_argument("--logs", default="aces,fr079,mit-csail,fr101-rawodo,orebro,fhw,intel")
    arguments.add_argument("--variants", default=VARIANTS)
    options = arguments.parse_args()
    for name, log, relations, _, more in [log for log in LOGS if log[0] in options.logs.split(",")]:
        paths = [data_folder() / "lidar2d" / path for path in (log, relations)]
        for variant in options.variants.split(","):
            with tempfile.TemporaryDirectory() as folder:
                recording, left = changed(*paths, variant, pathlib.Path(folder), options.programs[0], more)
                for program in options.programs:
                    figures = map_log(program.resolve(), (name, recording, left, True, more), [])
                    print(row(f"{name} {variant}", figures), flush=True)


if __name__ == "__main__":
    main()
