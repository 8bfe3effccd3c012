"""Recursive least squares over relative information, dense, as the paper runs it: one map after another.

Everything broadcasts over leading axes, so that many worlds are updated at once; `solve_all` takes all measurements of
each together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...core.se2 import wrap_angle
from ...fusion.relative_measurement import Measurement, RelativeLayout


class Estimate(NamedTuple):
    """Mean x (..., size) and covariance P (..., size, size) of the global state."""

    x: Float[np.ndarray, "*b size"]
    P: Float[np.ndarray, "*b size size"]


def update(layout: RelativeLayout, prior: Estimate, m: Measurement) -> Estimate:
    """`prior` after one measurement, linearised at its mean; the covariance in Joseph form."""
    e, H = m.linearise(layout, prior.x)
    return _correct(layout, prior, e, H, m.R, m.columns(layout))


def repeat(layout: RelativeLayout, prior: Estimate, measurements: Sequence[Measurement], repeats: int = 1) -> Estimate:
    """`prior` after `repeats` rounds over the measurements, relinearised every time.

    More than one round counts the same information again: the paper's way, overconfident by that factor.
    """
    for _ in range(repeats):
        for m in measurements:
            prior = update(layout, prior, m)
    return prior


def _correct(
    layout: RelativeLayout,
    prior: Estimate,
    e: Float[np.ndarray, "*b m"],
    H: Float[np.ndarray, "*b m k"],
    R: Float[np.ndarray, "*b m m"],
    columns: Int[np.ndarray, " k"],
) -> Estimate:
    x, P = prior
    HT = np.swapaxes(H, -1, -2)
    PHT = P[..., columns] @ HT
    S = H @ PHT[..., columns, :] + R
    KT = np.linalg.solve(S, np.swapaxes(PHT, -1, -2))  # [Kojima12] eq. 11
    K = np.swapaxes(KT, -1, -2)
    x = x + (K @ e[..., None])[..., 0]  # [Kojima12] eq. 10
    x[..., layout.angles] = wrap_angle(x[..., layout.angles])
    AP = P - K @ np.swapaxes(PHT, -1, -2)  # [Kojima12] eq. 12, completed to the Joseph form below
    P = AP - AP[..., columns] @ HT @ KT + K @ R @ KT
    return Estimate(x, np.asarray(0.5 * (P + np.swapaxes(P, -1, -2))))


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
