"""What starts in maps in 3D amount to: found or not, after how long, false, errors, and whether covariances say so. Needs numpy."""
import statistics

import numpy as np

from field_localize import first_right, share, spread
from field_localize_log import LASTING, is_wrong, longest_false

# The bounds that 95 % of the NEES of positions and of poses stay below: chi square of three and of six.
BOUNDS = {3: 7.815, 6: 12.592}
# Columns of rows, and degrees of freedom.
COLUMNS = {"positions": (4, 3), "poses": (5, 6), "rotations": (6, 3)}


def right_rows(pieces, rows="rows"):
    return [row for piece in pieces for row in piece[rows] if row[1] == "localised" and row[2] is not None and not is_wrong(row)]


def median(values):
    return statistics.median(values) if values else float("nan")


def nees(rows, of):
    """Mean of the NEES of positions (3), rotations (3) or poses (6), and the share within the 95 % bound."""
    column, degrees = COLUMNS[of]
    values = [row[column] for row in rows]
    mean = np.mean(np.minimum(values, 100)) if values else float("nan")
    return f"{mean:.1f} ({degrees}), within 95 %: {share(sum(value < BOUNDS[degrees] for value in values), len(values))}"


def start_figures(pieces):
    """One line for all starts, those whose place the map does not contain left out of what is found."""
    known = [piece for piece in pieces if piece.get("contained", True)]
    found = [piece for piece in known if first_right(piece)]
    after = [first_right(piece)[0] - piece["rows"][0][0] for piece in found]
    wrong = [round(seconds, 1) for seconds in (longest_false(piece["rows"]) for piece in pieces) if seconds > LASTING]
    rows = right_rows(pieces)
    metres = sorted(row[2] for row in rows) or [float("nan")]
    return (f"found {share(len(found), len(known))}, after {spread(after, 's')}; false > {LASTING:.0f} s: {len(wrong)} {wrong or ''}; "
            f"error {median(metres):.3f} m (90 %: {metres[int(0.9 * len(metres))]:.3f}), {median([row[3] for row in rows]):.2f} deg; "
            f"NEES of positions {nees(rows, 'positions')}; of rotations {nees(rows, 'rotations')}; of poses {nees(rows, 'poses')}; {median([piece['cpu'] for piece in pieces]):.1f} CPU-s")


def one_start(piece):
    first, own = first_right(piece), right_rows([piece])
    found = f"found after {first[0] - piece['rows'][0][0]:.1f} s" if first else "never found"
    last = piece["rows"][-1][1] if piece["rows"] else "without a scan"
    return (f"{found}, ends {last}, error {median([row[2] for row in own]):.3f} m, NEES {nees(own, 'positions')}, of rotations {nees(own, 'rotations')}, "
            f"false {longest_false(piece['rows']):.1f} s, {piece['cpu']:.1f} CPU-s")
