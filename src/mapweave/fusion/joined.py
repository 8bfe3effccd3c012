"""What every way of joining one cluster of maps ends with, before it is named and explained."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True)
class Joined:
    """One cluster of k maps as one map of n landmarks, in the frame of its first member (the gauge).

    ids, mean: (n, 2) [m], cov: (2n, 2n); frames: (k, 3) `T_ref_local`, frame_cov: (k, 3, 3) over x, y, theta, zero
    for the first; scales: (k,) how many times too large each map was (1 where scale is not estimated);
    variance_factors: (k,); chi2 and dof of the residuals.
    """

    ids: tuple[str, ...]
    mean: Float[np.ndarray, "n 2"]
    cov: Float[np.ndarray, "m m"]
    frames: Float[np.ndarray, "k 3"]
    frame_cov: Float[np.ndarray, "k 3 3"]
    scales: Float[np.ndarray, " k"]
    variance_factors: Float[np.ndarray, " k"]
    chi2: float
    dof: int
