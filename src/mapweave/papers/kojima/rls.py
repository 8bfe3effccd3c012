"""Recursive least squares over relative information, dense, as the paper runs it: one map after another.

Everything broadcasts over leading axes, so that many worlds are updated at once; `solve_all` takes all measurements of
each together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float, Int

from ...core.gaussian import solve_psd, symmetrise
from ...core.se2 import wrap_angle
from ...fusion.relative_information import Measurement, RelativeLayout


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


Square = Float[np.ndarray, "n n"]


def after(information: Square, H: Float[np.ndarray, "m n"], R: Float[np.ndarray, "m m"], k: float) -> Square:
    """`P_k = (Lambda_0 + k H^T R^-1 H)^-1` after k uses. # [Kojima12] eq. 19, 28"""
    W = H.T @ solve_psd(R, H)  # [Kojima12] eq. 17
    return symmetrise(np.linalg.inv(symmetrise(information + k * W)))


def limit(information: Square, H: Float[np.ndarray, "m n"]) -> Square:
    """`P_inf = Z (Z^T Lambda_0 Z)^-1 Z^T`, Z a basis of the null space of H: what no repetition takes away.

    The corrected form of the paper's eq. 23; `P_k` approaches it as 1/k.
    """
    Z = sla.null_space(H)
    return symmetrise(Z @ solve_psd(symmetrise(Z.T @ information @ Z), Z.T))  # [Kojima12] eq. 23


def printed_limit(
    frames: Float[np.ndarray, "r r"],
    landmarks: Float[np.ndarray, "l l"],
    H_r: Float[np.ndarray, "m r"],
    H_l: Float[np.ndarray, "m l"],
) -> Float[np.ndarray, "n n"]:
    """The paper's closed form of the limit; exact only when the map holds every global landmark (N = n).

    frames, landmarks: the diagonal blocks of the initial information matrix (its eq. 22); H_r, H_l: the columns of
    H that belong to the frame and to the landmarks.
    """
    G = np.linalg.pinv(H_l) @ H_r
    phi11 = np.linalg.inv(frames + G.T @ landmarks @ G)  # [Kojima12] eq. 24
    phi12 = -phi11 @ G.T  # [Kojima12] eq. 25
    phi21 = -G @ phi11  # [Kojima12] eq. 26
    phi22 = G @ phi11 @ G.T  # [Kojima12] eq. 27
    return np.block([[phi11, phi12], [phi21, phi22]])
