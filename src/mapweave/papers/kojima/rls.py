"""Recursive least squares over relative information, dense, as the paper runs it: one map after another.

Everything broadcasts over leading axes, so that many worlds are updated at once.
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
