"""How much better "these landmarks are the same ones" explains where they lie than chance does.

Same: up to one rigid transform and a scale near 1 they lie where the covariances say. Chance: the second map's lie
anywhere in its area. The logarithm of the ratio of the probability densities of what was measured (the Bayes factor)
grows with every landmark that agrees, and the more so the surer both maps are.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaln

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from .alignment import JointFit


def spread_area(m: LandmarkMap) -> float:
    """The area [m^2] of the disc over which landmarks would be spread as widely as those of `m` are."""
    return 2 * np.pi * float(np.mean(np.sum((m.mean - m.mean.mean(axis=0)) ** 2, axis=1)))


def log_evidence(
    source: LandmarkMap,
    target: LandmarkMap,
    links: Int[np.ndarray, "k 2"],
    fit: JointFit,
    area: float,
    noise: float,
    scale_sigma: float,
) -> float:
    """The log Bayes factor of the k links, fitted with `noise` and `scale_sigma`, which links are right being known.

    The transform, uniform over the area and all headings, and the scale are integrated over (Laplace's method).
    """
    V, N = _precision(source, target, links, fit.T, noise, scale_sigma)
    fitted = -0.5 * (fit.chi2 + np.linalg.slogdet(2 * np.pi * V)[1])
    prior = -np.log(2 * np.pi * area) - 0.5 * np.log(2 * np.pi * scale_sigma**2)
    volume = -0.5 * float(np.linalg.slogdet(N / (2 * np.pi))[1])
    return float(fitted + prior + volume + len(links) * np.log(area))


def log_correspondences(k: int, n: int, m: int) -> float:
    """Logarithm of in how many ways k of n landmarks can be k of m others."""
    return float(gammaln(n + 1) - gammaln(n - k + 1) + gammaln(m + 1) - gammaln(m - k + 1) - gammaln(k + 1))


def _precision(
    a: LandmarkMap,
    b: LandmarkMap,
    links: Int[np.ndarray, "k 2"],
    T: Float[np.ndarray, "3"],
    noise: float,
    scale_sigma: float,
) -> tuple[Float[np.ndarray, "m m"], Float[np.ndarray, "4 4"]]:
    """The covariance of what lies between linked landmarks, and the information on transform and scale."""
    k = len(links)
    at_a, at_b = ((2 * links[:, [c]] + np.arange(2)).ravel() for c in (0, 1))
    R = se2.rotation(float(T[2]))
    C = np.kron(np.eye(k), R)
    V = b.cov[np.ix_(at_b, at_b)] + C @ a.cov[np.ix_(at_a, at_a)] @ C.T + 2 * noise**2 * np.eye(2 * k)
    turned = a.mean[links[:, 0]] @ R.T
    J = np.zeros((2 * k, 4))
    J[0::2, 0] = J[1::2, 1] = 1.0
    J[0::2, 2], J[1::2, 2] = -turned[:, 1], turned[:, 0]
    J[:, 3] = turned.ravel()
    N = J.T @ np.linalg.solve(V, J)
    N[3, 3] += scale_sigma**-2
    return V, N
