"""Grid maps as data: everything a cell holds, for `localize` and for other programs."""

from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..laser.grid import GridMap, IntensityCalibration
from .npz import Spec, read_npz, write_arrays

NAME = "grid.npz"
LARGEST_VALUE = 1e30  # cells are kept as 32-bit numbers
CELLS: dict[str, Spec] = {
    "resolution": ("number", ()),
    "origin": ("number", (2,)),
    "hits": ("whole", ("rows", "cols")),
    "passes": ("whole", ("rows", "cols")),
    "mean": ("number", ("rows", "cols", 2)),
    "feature": ("number", ("rows", "cols")),
    "weight": ("number", ("rows", "cols")),
    "kind": ("text", ()),
}
CALIBRATION: dict[str, Spec] = {
    "knots": ("number", ("knots",)),
    "log_gain": ("number", ("knots",)),
    "gain_figures": ("number", (4,)),
    "residual_by_range": ("maybe", ("bins",)),
}


def read_grid(path: Path) -> tuple[GridMap, IntensityCalibration | None, str]:
    """The map, how its intensity was normalised (None where it was not), and the feature it holds.

    Raises ReaderError for a file that is missing, damaged or something else.
    """
    held = read_npz(path, CELLS, CALIBRATION, "a grid map that `map` wrote")
    resolution = float(held["resolution"])
    if resolution <= 0:
        raise ReaderError(path, f"expected a resolution of more than 0 m, found {resolution:g}")
    if max(np.abs(held[name]).max(initial=0.0) for name in ("mean", "feature", "weight")) > LARGEST_VALUE:
        raise ReaderError(path, f"expected cells with numbers under {LARGEST_VALUE:g}")
    if min(held[name].min(initial=0) for name in ("hits", "passes")) < 0:
        raise ReaderError(path, "expected counts of 0 or more")
    arrays = (held[name] for name in ("origin", "hits", "passes", "mean", "feature", "weight"))
    grid = GridMap(resolution, *arrays)
    calibration = None
    if all(name in held for name in CALIBRATION):
        exponent, scale, residual, samples = held["gain_figures"].tolist()
        calibration = IntensityCalibration(
            held["knots"], held["log_gain"], exponent, scale, residual, int(samples), held["residual_by_range"]
        )
    return grid, calibration, str(held["kind"])


def write_grid(path: Path, grid: GridMap, calibration: IntensityCalibration | None, feature: str) -> None:
    """`path` holds the cells and what is needed to work out the feature of a new scan as it was worked out here.

    Arrays as in `GridMap` and, with a calibration, `knots`, `log_gain`, `gain_figures` = (exponent, scale, residual,
    samples) and `residual_by_range`.
    """
    arrays = {
        "resolution": np.array(grid.resolution),
        "origin": grid.origin,
        "hits": grid.hits,
        "passes": grid.passes,
        "mean": grid.mean,
        "feature": grid.feature,
        "weight": grid.weight,
        "kind": np.array(feature),
    }
    if calibration is not None:
        c = calibration
        arrays |= {
            "knots": c.knots,
            "log_gain": c.log_gain,
            "gain_figures": np.array([c.exponent, c.scale, c.residual, float(c.samples)]),
            "residual_by_range": c.residual_by_range,
        }
    write_arrays(path, arrays, gaps=("residual_by_range",))
