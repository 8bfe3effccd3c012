"""`calibration.json`: what is known of every robot's wheels and camera, as found or as given."""

from collections.abc import Mapping
from pathlib import Path
from typing import TypeGuard

import numpy as np

from ..core.errors import ReaderError
from ..core.names import robot_key, robot_name
from ..team.robot_part import PARAMETERS
from ..team.smooth import Calibration, is_observed
from .directory import read_json, write_json

SCALES = ("speed_scale", "turn_scale", "range_scale")


def write_calibration(path: Path, robots: Mapping[str, Calibration], prior: Calibration) -> None:
    """`{robot: {parameter: {value, sd, observed}}}`; observed: whether the data told more than was known before."""
    write_json(
        path,
        {
            robot_key(robot): {
                name: {"value": value, "sd": sd, "observed": is_observed(name, sd, prior)}
                for name, (value, sd) in found.items()
            }
            for robot, found in robots.items()
        },
    )


def read_calibration(path: Path) -> dict[str, dict[str, tuple[float, float]]]:
    """Robot name -> parameter -> (value, sd), as `map` writes it or by hand; no sd, or 0, holds a value.

    Raises ReaderError naming the robot and the parameter for anything else than `{robot: {parameter: {value, sd}}}`
    with finite numbers, scales above 0 and standard deviations of 0 or more.
    """
    out: dict[str, dict[str, tuple[float, float]]] = {}
    for key, given in read_json(path).items():
        if not isinstance(given, dict):
            raise ReaderError(path, f"robot {key}: expected parameters, found {str(given)[:40]!r}")
        known: dict[str, tuple[float, float]] = {}
        for name, entry in given.items():
            if name not in PARAMETERS:
                raise ReaderError(path, f"robot {key}: expected {', '.join(PARAMETERS)}, found {name[:40]!r}")
            known[name] = _entry(path, f"robot {key}, {name}", name, entry)
        out[robot_name(key)] = known
    return out


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _entry(path: Path, where: str, name: str, entry: object) -> tuple[float, float]:
    given = entry if isinstance(entry, dict) else {"value": entry}
    value, sd = given.get("value"), given.get("sd", 0.0)
    if not _is_number(value) or not _is_number(sd):
        raise ReaderError(path, f"{where}: expected a value and its sd as finite numbers")
    if name in SCALES and not value > 0:
        raise ReaderError(path, f"{where}: expected a scale above 0, found {value}")
    if sd < 0:
        raise ReaderError(path, f"{where}: expected an sd of 0 or more, found {sd}")
    return float(value), float(sd)
