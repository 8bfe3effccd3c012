"""Roh's angulation data: real bearings to four beacons from nine places, as sightings of a swarm."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.bearings import BearingTable, unit
from ..core.errors import ReaderError

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
        beacons = np.loadtxt(folder / "landmark.csv", delimiter=",", ndmin=2)
        bearings = np.radians(np.stack([np.loadtxt(p, delimiter=",", ndmin=2) for p in files]))
    except (OSError, ValueError) as error:
        raise ReaderError(folder, f"expected tables of equal shape: {error}") from None
    if bearings.shape[2] != len(beacons):
        raise ReaderError(folder, f"expected {len(beacons)} bearings a row, found {bearings.shape[2]}")
    places = [[float(v) for v in found.groups()] for p in files if (found := NAME.search(p.name))]
    return bearings, np.array(places), beacons[:, :2]


def as_sightings(bearings: Float[np.ndarray, "p r b"], sigma: float, heading: float | None) -> BearingTable:
    """Places `p1`.. that see beacons `b1`..; `heading` [rad] of all places, or None where it is not known."""
    p, r, b = bearings.shape
    ids = (*(f"b{k + 1}" for k in range(b)), *(f"p{k + 1}" for k in range(p)))
    observer = np.repeat(np.arange(p) + b, r * b)
    target = np.tile(np.arange(b), p * r)
    angle = bearings.ravel() + (heading or 0.0)
    return BearingTable(ids, observer, target, unit(angle), np.full(len(angle), sigma), None, heading is not None)
