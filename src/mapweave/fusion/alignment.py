"""How two maps lie on each other: rigid alignment that survives wrong points, and the joint fit of linked landmarks.

And how much better "these landmarks are the same ones" explains where they lie than chance does. Same: up to one rigid
transform and a scale near 1 they lie where the covariances say. Chance: the second map's lie anywhere in its area. The
logarithm of the ratio of the probability densities of what was measured (the Bayes factor) grows with every landmark
that agrees, and the more so the surer both maps are.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from ..solve import gauss_newton, wrapping

Points = Float[np.ndarray, "n 2"]
HYPOTHESES = 600  # pairs tried, spread over all points: bounds the time, ten are enough where most points are right


@dataclass(frozen=True, slots=True)
class RigidFit:
    """`T_target_source` (no scale, no reflection); residual: (n,) left [m]; inliers: (n,) under the gate."""

    T_target_source: Float[np.ndarray, "3"]
    residual: Float[np.ndarray, " n"]
    inliers: Bool[np.ndarray, " n"]

    @property
    def median(self) -> float:
        """The median distance left [m]."""
        return float(np.median(self.residual))


def align_robust(source: Points, target: Points, gate: Float[np.ndarray, " n"]) -> RigidFit:
    """The rigid transform under which most of n >= 2 corresponding points agree within their `gate` (n,) [m].

    Every pair of points (a spread of them when there are many) proposes a transform; the one of least truncated
    squared distance is refitted to its inliers. Exact for clean points, unmoved by a minority of wrong ones.
    """
    i, j = _pairs(len(source))
    s, t = _complex(source), _complex(target)
    turn = _unit((t[j] - t[i]) * np.conj(s[j] - s[i]))
    shift = 0.5 * (t[i] + t[j]) - turn * 0.5 * (s[i] + s[j])
    distance = np.abs(turn[:, None] * s + shift[:, None] - t)
    best = int(np.argmin(np.minimum((distance / gate) ** 2, 1.0).sum(axis=1)))
    residual, T = distance[best], se2.pose(shift[best].real, shift[best].imag, float(np.angle(turn[best])))
    inliers = residual < gate
    for _ in range(10):
        if inliers.sum() < 2:
            break
        T = se2.align(source[inliers], target[inliers])
        residual = np.hypot(*(se2.act(T, source) - target).T)
        before, inliers = inliers, residual < gate
        if np.array_equal(before, inliers):
            break
    return RigidFit(T, residual, inliers)


def _pairs(n: int) -> tuple[Int[np.ndarray, " h"], Int[np.ndarray, " h"]]:
    """All pairs of n things, or about `HYPOTHESES` of them with every thing in as many."""
    if n * (n - 1) // 2 <= HYPOTHESES:
        i, j = np.triu_indices(n, 1)
        return i, j
    steps = np.unique(np.linspace(1, n // 2, max(1, HYPOTHESES // n), dtype=np.intp))
    i = np.repeat(np.arange(n), len(steps))
    return i, (i + np.tile(steps, n)) % n


def _complex(points: Points) -> np.ndarray:
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def _unit(z: np.ndarray) -> np.ndarray:
    size = np.abs(z)
    return np.where(size > 0, z / np.where(size > 0, size, 1.0), 1.0)


STEPS = 4  # of Gauss-Newton from a good start; more change nothing


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
    fitted = _Linked(source, target, links, noise, scale_sigma)
    solution = gauss_newton(fitted.normal, np.append(T, 1.0), max_iterations=STEPS, retract=wrapping(np.array([2])))
    u, r = fitted.left_out(solution.x, solution.information)[:2]
    return JointFit(solution.x[:3], float(solution.x[3]), solution.cost, np.einsum("ki,ki->k", u, r))


def left_out(
    source: LandmarkMap,
    target: LandmarkMap,
    links: Int[np.ndarray, "k 2"],
    fit: JointFit,
    noise: float,
    scale_sigma: float,
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2 2"]]:
    """Each link's residual [m] and its covariance when all other links, and not it, tell how the maps lie."""
    fitted = _Linked(source, target, links, noise, scale_sigma)
    x = np.append(fit.T, fit.scale)
    _, r, blocks = fitted.left_out(x, fitted.normal(x)[0])
    return r, np.linalg.inv(blocks)


class _Linked:
    """The least-squares problem of k linked landmarks over x, y, theta and scale."""

    def __init__(
        self,
        source: LandmarkMap,
        target: LandmarkMap,
        links: Int[np.ndarray, "k 2"],
        noise: float,
        scale_sigma: float,
    ) -> None:
        a, b = ((2 * links[:, [c]] + np.arange(2)).ravel() for c in (0, 1))
        self.Pa, self.Pb = source.cov[np.ix_(a, a)], target.cov[np.ix_(b, b)]
        self.p, self.z = source.mean[links[:, 0]], target.mean[links[:, 1]]
        self.floor, self.scale_information = 2 * noise**2 * np.eye(len(a)), scale_sigma**-2

    def linearised(self, x: Float[np.ndarray, "4"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Information (2k, 2k), residuals (2k,) and their Jacobian (2k, 4) at x, both covariances turned alike."""
        k, R = len(self.p), se2.rotation(float(x[2]))
        turned = self.p @ R.T
        C = np.kron(np.eye(k), R)
        V = self.Pb + C @ self.Pa @ C.T + self.floor
        A = np.asarray(sla.cho_solve(sla.cho_factor(V, lower=True), np.eye(2 * k)))
        J = np.zeros((2 * k, 4))
        J[0::2, 0] = J[1::2, 1] = 1.0
        J[0::2, 2], J[1::2, 2] = -x[3] * turned[:, 1], x[3] * turned[:, 0]
        J[:, 3] = turned.ravel()
        return A, (x[3] * turned + x[:2] - self.z).ravel(), J

    def left_out(
        self, x: Float[np.ndarray, "4"], information: Float[np.ndarray, "4 4"]
    ) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2 2"]]:
        """Of every link left out alone: its part of the gradient, its residual [m], and the information on that."""
        A, r, J = self.linearised(x)
        k = len(self.p)
        Q = A - A @ J @ np.linalg.solve(information, J.T @ A)
        blocks = Q.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)] + 1e-12 * np.eye(2)
        u = (A @ r).reshape(k, 2)
        return u, np.linalg.solve(blocks, u[:, :, None])[:, :, 0], blocks

    def normal(self, x: Float[np.ndarray, "4"]) -> tuple[np.ndarray, np.ndarray, float]:
        """The normal equations with the prior of the scale."""
        A, r, J = self.linearised(x)
        Ar = A @ r
        H, g = J.T @ A @ J, J.T @ Ar
        H[3, 3] += self.scale_information
        g[3] += (x[3] - 1.0) * self.scale_information
        return H, g, float(r @ Ar) + (x[3] - 1.0) ** 2 * self.scale_information


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
