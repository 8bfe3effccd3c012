"""Grid maps that `map` wrote."""

import zipfile
from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..laser.grid import GridMap, IntensityCalibration


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
