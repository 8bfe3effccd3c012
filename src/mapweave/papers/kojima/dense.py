"""The information form, dense, for many small worlds at once: Monte Carlo over thousands of draws."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...core.se2 import wrap_angle
from ...fusion.relative_measurement import Measurement, RelativeLayout
from .rls import Estimate


def solve_all(
    layout: RelativeLayout,
    x0: Float[np.ndarray, "*b size"],
    measurements: Sequence[Measurement],
    *,
    repeats: int = 1,
    iterations: int = 12,
) -> Estimate:
    """Every world's least-squares estimate from its start, without any prior, and its covariance.

    x0: (..., size); the measurements carry the same leading axes. Plain Gauss-Newton: the start must be good.
    """
    x = np.array(x0)
    R_inv = [repeats * np.linalg.inv(m.R) for m in measurements]
    size = layout.size
    for _ in range(iterations):
        Lambda, eta = np.zeros((*x.shape, size)), np.zeros_like(x)
        for m, weight in zip(measurements, R_inv, strict=True):
            e, H = m.linearise(layout, x)
            columns = m.columns(layout)
            HTW = np.swapaxes(H, -1, -2) @ weight
            Lambda[..., columns[:, None], columns] += HTW @ H
            eta[..., columns] += (HTW @ e[..., None])[..., 0]
        step = np.linalg.solve(Lambda, eta[..., None])[..., 0]
        x = x + step
        x[..., layout.angles] = wrap_angle(x[..., layout.angles])
        if np.abs(step).max() < 1e-11:
            break
    return Estimate(x, np.linalg.inv(Lambda))
