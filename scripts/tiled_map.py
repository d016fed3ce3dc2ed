#!/usr/bin/env python3
"""A large map for timing, of copies of a small one: `tiled_map.py MAP.pbstream COPIES WIDTH,DEPTH OUT.pbstream --program PORTOLAN`.

The copies lie beside each other, WIDTH and DEPTH metres apart but for up to a metre and 3° that are drawn for each (seed 1), and
are joined by `portolan edit --merge --place`. Such a map is ambiguous: only the time of a search in it means something.
"""
import argparse
import pathlib
import random
import subprocess
import tempfile


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map")
    parser.add_argument("copies", type=int)
    parser.add_argument("spacing", help="WIDTH,DEPTH of a copy, metres")
    parser.add_argument("out")
    parser.add_argument("--program", default="portolan")
    args = parser.parse_args()
    width, depth = map(float, args.spacing.split(","))
    draw = random.Random(1)
    with tempfile.TemporaryDirectory(dir=pathlib.Path(args.out).resolve().parent) as folder:
        def merged(first, second, x, y, name):
            place = f"{x + draw.uniform(-1, 1):.3f},{y + draw.uniform(-1, 1):.3f},{draw.uniform(-3, 3):.3f}"
            out = f"{folder}/{name}.pbstream"
            subprocess.run([args.program, "edit", first, "--merge", second, "--place", place, "-o", out, "-q"],
                           check=True)
            return out

        # Blocks of 1, 2, 4, ... copies, doubled to the side and upwards in turns; those that the number needs are put in a row.
        block, size, extent = args.map, 1, [1, 1]
        whole, end = None, 0.0
        while size <= args.copies:
            if args.copies & size:
                whole = block if whole is None else merged(whole, block, end, 0.0, f"row{size}")
                end += extent[0] * width
            if 2 * size <= args.copies:
                axis = 0 if extent[0] <= extent[1] else 1
                shift = [0.0, 0.0]
                shift[axis] = extent[axis] * (width, depth)[axis]
                block = merged(block, block, *shift, f"block{2 * size}")
                extent[axis] *= 2
            size *= 2
        pathlib.Path(args.out).write_bytes(pathlib.Path(whole).read_bytes())


if __name__ == "__main__":
    main()
