"""Roh's angulation data: real bearings to four beacons from nine places, as sightings of a swarm."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mapweave.core.bearings import BearingTable, unit
from mapweave.core.errors import ReaderError
from mapweave.io.table import lines, numbers

NAME = re.compile(r"\(X([0-9.]+),Y([0-9.]+)\)\.csv$")


def read_angulation(
    folder: Path,
) -> tuple[Float[np.ndarray, "p r b"], Float[np.ndarray, "p 2"], Float[np.ndarray, "b 2"]]:
    """Bearings [rad] in the detector's own frame (places, readings, beacons), the places [m] and the beacons [m].

    Raises ReaderError where a file is missing or has another shape.
    """
    files = sorted(p for p in folder.glob("*.csv") if NAME.search(p.name))
    if not files:
        raise ReaderError(folder, "expected files named (Xx.x,Yy.y).csv, found none")
    try:
        beacons = _table(folder / "landmark.csv")
        bearings = np.radians(np.stack([_table(p) for p in files]))
    except (OSError, ValueError) as error:
        raise ReaderError(folder, f"expected tables of equal shape: {error}") from None
    if beacons.shape[1] < 2:
        raise ReaderError(folder / "landmark.csv", "expected x and y of every beacon")
    if bearings.shape[2] != len(beacons):
        raise ReaderError(folder, f"expected {len(beacons)} bearings a row, found {bearings.shape[2]}")
    places = [[float(v) for v in match.groups()] for p in files if (match := NAME.search(p.name))]
    return bearings, np.array(places), beacons[:, :2]


def _table(path: Path) -> Float[np.ndarray, "n k"]:
    """The finite numbers in `path`, commas between them; raises ReaderError naming a line that has none."""
    text = lines(path.read_bytes(), str(path))
    width = len(next((line for line in text if line.strip()), "").split(","))
    rows = numbers("\n".join(text).encode(), str(path), tuple(f"column {k + 1}" for k in range(width)), separator=",")
    if not len(rows) or not np.isfinite(rows).all():
        raise ReaderError(path, "expected rows of finite numbers")
    return rows


def as_sightings(bearings: Float[np.ndarray, "p r b"], sigma: float, heading: float | None) -> BearingTable:
    """Places `p1`.. that see beacons `b1`..; `heading` [rad] of all places, or None where it is not known."""
    p, r, b = bearings.shape
    ids = (*(f"b{k + 1}" for k in range(b)), *(f"p{k + 1}" for k in range(p)))
    observer = np.repeat(np.arange(p) + b, r * b)
    target = np.tile(np.arange(b), p * r)
    angle = bearings.ravel() + (heading or 0.0)
    return BearingTable(ids, observer, target, unit(angle), np.full(len(angle), sigma), None, heading is not None)
