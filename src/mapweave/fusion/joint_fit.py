"""How well linked landmarks of two maps fit together, with both covariances whole."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float, Int

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap

STEPS = 4


@dataclass(frozen=True, slots=True)
class JointFit:
    """T = `T_target_source` and scale of least chi-square; single: (k,) what chi-square loses without each link."""

    T: Float[np.ndarray, "3"]
    scale: float
    chi2: float
    single: Float[np.ndarray, " k"]


def joint_fit(
    source: LandmarkMap,
    target: LandmarkMap,
    links: Int[np.ndarray, "k 2"],
    T: Float[np.ndarray, "3"],
    noise: float,
    scale_sigma: float,
) -> JointFit:
    """The alignment, begun at T, that makes k links fit best: `z_target = t + s R z_source`, s near 1.

    noise [m]: added to every landmark of both maps; scale_sigma: prior deviation of s from 1.
    """
    a, b = ((2 * links[:, [c]] + np.arange(2)).ravel() for c in (0, 1))
    Pa, Pb = source.cov[np.ix_(a, a)], target.cov[np.ix_(b, b)]
    p, z = source.mean[links[:, 0]], target.mean[links[:, 1]]
    k = len(links)
    T, scale, A = np.array(T), 1.0, np.zeros((0, 0))
    r = J = np.zeros(0)
    for _ in range(STEPS):
        R = se2.rotation(float(T[2]))
        turned = p @ R.T
        C = np.kron(np.eye(k), R)
        V = Pb + C @ Pa @ C.T + 2 * noise**2 * np.eye(2 * k)
        A = np.asarray(sla.cho_solve(sla.cho_factor(V, lower=True), np.eye(2 * k)))
        r = (scale * turned + T[:2] - z).ravel()
        J = np.zeros((2 * k, 4))
        J[0::2, 0] = J[1::2, 1] = 1.0
        J[0::2, 2], J[1::2, 2] = -scale * turned[:, 1], scale * turned[:, 0]
        J[:, 3] = turned.ravel()
        N = J.T @ A @ J
        N[3, 3] += scale_sigma**-2
        g = J.T @ A @ r
        g[3] += (scale - 1.0) * scale_sigma**-2
        step = np.linalg.solve(N, g)
        r = r - J @ step
        T, scale = se2.pose(*(T - step[:3])), scale - float(step[3])
    N = J.T @ A @ J
    N[3, 3] += scale_sigma**-2
    Ar = A @ r
    Q = A - A @ J @ np.linalg.solve(N, J.T @ A)
    blocks = Q.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)] + 1e-12 * np.eye(2)
    u = Ar.reshape(k, 2)
    single = np.einsum("ki,ki->k", u, np.linalg.solve(blocks, u[:, :, None])[:, :, 0])
    chi2 = float(r @ Ar) + (scale - 1.0) ** 2 * scale_sigma**-2
    return JointFit(T, scale, chi2, single)
