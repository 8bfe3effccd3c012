"""A satellite receiver on a simulated robot: fixes once a second, white noise, and now and then one far off."""

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.fixes import Fixes, place_of
from ..core.records import Track

DATUM = np.array([35.7, 139.75, 40.0])
"""Latitude [deg], longitude [deg], height [m] of the point from which simulated worlds measure east and north."""
EVERY = 1.0  # [s] from fix to fix
JUMPS, JUMP = 0.03, 60.0  # share of fixes that lie elsewhere, and sd of how far [m] on either axis
APART = 150.0  # [m] sd of where a drive begins, on either axis


def placed(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Where a simulated world lies east and north of `DATUM`, and how it is turned."""
    return np.array([*(APART * rng.standard_normal(2)), rng.uniform(-np.pi, np.pi)])


def simulated_fixes(truth: Track, sd: float, rng: np.random.Generator) -> Fixes:
    """The fixes of a robot that drives along `truth` (east and north of `DATUM`), with `sd` [m] on either axis."""
    t = np.arange(truth.t[0] + rng.uniform(0.0, EVERY), truth.t[-1], EVERY)
    xy = se2.interpolate(t, truth.t, truth.pose)[:, :2] + sd * rng.standard_normal((len(t), 2))
    xy = xy + (rng.random(len(t)) < JUMPS)[:, None] * JUMP * rng.standard_normal((len(t), 2))
    place = place_of(np.column_stack([xy, np.zeros(len(t))]), DATUM)
    return Fixes(t, place, np.tile(sd**2 * np.eye(2), (len(t), 1, 1)), topic="/fix")
