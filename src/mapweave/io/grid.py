"""Grid maps as data: everything a cell holds, for `localize` and for other programs."""

import zipfile
from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..laser.grid import GridMap, IntensityCalibration
from .npz import write_npz

NAME = "grid.npz"


def read_grid(path: Path) -> tuple[GridMap, IntensityCalibration | None, str]:
    """The map, how its intensity was normalised (None where it was not), and the feature it holds.

    Raises ReaderError for a file that is missing, damaged or something else.
    """
    try:
        with np.load(path) as held:
            grid = GridMap(
                float(held["resolution"]),
                held["origin"],
                held["hits"],
                held["passes"],
                held["mean"],
                held["feature"],
                held["weight"],
            )
            calibration = None
            if "knots" in held:
                exponent, scale, residual, samples = held["gain_figures"].tolist()
                calibration = IntensityCalibration(
                    held["knots"], held["log_gain"], exponent, scale, residual, int(samples), held["residual_by_range"]
                )
            return grid, calibration, str(held["kind"])
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ReaderError(path, f"expected a grid map that `map` wrote: {error}") from None


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
    write_npz(path, **arrays)
