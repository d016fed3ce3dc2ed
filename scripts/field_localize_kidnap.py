"""Recordings of somebody who is carried elsewhere while nothing is recorded: for `field_localize.py --kidnap`."""
import bz2
import concurrent.futures
import json
import math
import pathlib
import statistics
import tempfile

from field_localize_log import LASTING, NEAR, errors, is_wrong, longest_false, wrap

# Poses in the lines of a CARMEN log: where their x stands, from the end.
POSES = {"FLASER": (-9, -6), "RLASER": (-9, -6), "ODOM": (-9,)}
LENGTH = 30.0


def moved_by(a_from_b, words, at):
    """The pose that begins at a word, moved."""
    x, y, yaw = map(float, words[at : at + 3])
    c, s = math.cos(a_from_b[2]), math.sin(a_from_b[2])
    moved = (a_from_b[0] + c * x - s * y, a_from_b[1] + s * x + c * y, wrap(yaw + a_from_b[2]))
    words[at : at + 3] = [f"{v:.6f}" for v in moved]


def over(first, second):
    """The motion that puts the second pose over the first."""
    turn = first[2] - second[2]
    c, s = math.cos(turn), math.sin(turn)
    return first[0] - c * second[0] + s * second[1], first[1] - s * second[0] - c * second[1], turn


def glued(log, first, second, carried, path):
    """A CARMEN log of two pieces, the second right after the first; the time by which the second was moved."""
    lines = bz2.open(log.recording, "rt", errors="replace").read().splitlines()
    stamped = [l.split() for l in lines if l.split() and l.split()[0] in POSES]
    # Logs whose stamps begin near 0 are mapped with stamps of the year 2001.
    start = log.start - 1e9 * round((log.start - float(stamped[0][-3])) / 1e9)
    cut, again = start + first + LENGTH, start + second
    before = [w for w in stamped if start + first <= float(w[-3]) < cut]
    after = [w for w in stamped if again <= float(w[-3]) < again + LENGTH]
    later = again - cut - 0.2
    text = [l for l in lines if l.startswith(("PARAM", "#"))] + [" ".join(w) for w in before]
    # What the wheels say in the last line that has it, and in the first.
    pose = lambda words: tuple(map(float, words[POSES[words[0]][-1] :][:3]))
    same = after[0][0]
    last = next(w for w in reversed(before) if w[0] == same)
    motion = over(pose(last), pose(after[0]))
    for words in after:
        for at in POSES[words[0]] if carried == "odometry-stands" else ():
            # Indices are from the end: three words stay three.
            moved_by(motion, words, len(words) + at)
        text.append(" ".join([*words[:-3], f"{float(words[-3]) - later:.6f}", words[-2], f"{float(words[-1]) - later:.6f}"]))
    pathlib.Path(path).write_text("\n".join(text) + "\n")
    return later


def kidnap(log, first, second, carried):
    """Seconds from the kidnapping until it is not localised wrongly any more, and until it is right again; the longest
    stretch that it is wrong after that; None if it was not localised before."""
    with tempfile.TemporaryDirectory() as results:
        folder = pathlib.Path(results)
        recording = folder / "glued.clf"
        later = glued(log, first, second, carried, recording)
        log.localize(recording, folder, [])
        if not (folder / "poses.csv").exists():
            return None
        cut = log.start + first + LENGTH
        rows = errors(folder, log.truth.at, lambda time: time + later if time > cut else time)
        changes = json.loads((folder / "report.json").read_text())["changes"]
    if not any(r[1] == "localised" and not is_wrong(r) for r in [r for r in rows if r[0] <= cut][-5:]):
        return None
    after = [r for r in rows if r[0] > cut]
    left = next((r[0] - cut for r in after if not is_wrong(r)), math.inf)
    right = next((r[0] - cut for r in after if r[1] == "localised" and r[2] is not None and not is_wrong(r)), math.inf)
    changes = [f"{c['time'] - cut:.1f} {c['state']} {c['reason']}" for c in changes if c["time"] > cut]
    since = log.contained_since(log.start + second, log.start + second + LENGTH)
    return {"pair": (first, second), "left": left, "right": right, "changes": changes,
            "false": longest_false([r for r in after if r[0] >= cut + left]),
            "contained": None if since is None else since - log.start - second}


def carried_way(log, first, second):
    """Metres from the end of the first piece to the beginning of the second."""
    poses = [log.truth.whole.at(log.start + time) for time in (first + LENGTH, second)]
    return math.dist(poses[0][:2], poses[1][:2])


def kidnaps(log, count, carried, workers, details):
    if log.recording.suffix != ".bz2" or log.scans:
        print(f"{log.name:10} cannot be glued: only CARMEN logs with real stamps can")
        return
    room = log.end - log.start - log.half - 80
    starts = [log.half + room * i / count for i in range(count)]
    known = [s for s in starts if log.contains(log.start + s, log.start + s + 10)]
    jobs = [(s, known[(i + len(known) // 2) % len(known)]) for i, s in enumerate(known)]
    jobs = [job for job in jobs if carried_way(log, *job) > NEAR]
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        found = [f for f in pool.map(lambda j: kidnap(log, *j, carried), jobs) if f]
    for f in found if details else []:
        print(f"  {f['pair'][0]:.0f} {f['pair'][1]:.0f} left {f['left']:.1f} right {f['right']:.1f} false {f['false']:.1f} "
              f"contained since {f['contained']}: {'; '.join(f['changes'])}")
    at_once = [f for f in found if f["contained"] is not None and f["contained"] < 1.0]
    middle = lambda values: statistics.median(values) if values else math.nan
    print(f"{log.name:10} {carried}: {len(jobs)} pairs that the map knows, kidnapped {len(found)} times while localised: "
          f"not wrong any more within 3 s {sum(f['left'] <= 3 for f in found)} (median {middle([f['left'] for f in found]):.1f} s), "
          f"right again within 10 s {sum(f['right'] <= 10 for f in found)} (median {middle([f['right'] for f in found]):.1f} s), "
          f"of {len(at_once)} whose new place the map contains from the beginning {sum(f['right'] <= 10 for f in at_once)}; "
          f"false again > {LASTING:.0f} s: {sum(f['false'] > LASTING for f in found)}", flush=True)
