"""How well linked landmarks of two maps fit together, with both covariances whole."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float, Int

from ..core import se2
from ..landmarks.landmark_map import LandmarkMap
from ..solve import gauss_newton, wrapping

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
    fitted = _Linked(source, target, links, noise, scale_sigma)
    solution = gauss_newton(fitted.normal, np.append(T, 1.0), max_iterations=STEPS, retract=wrapping(np.array([2])))
    A, r, J = fitted.linearised(solution.x)
    k, Ar = len(links), A @ r
    Q = A - A @ J @ np.linalg.solve(solution.information, J.T @ A)
    blocks = Q.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)] + 1e-12 * np.eye(2)
    u = Ar.reshape(k, 2)
    single = np.einsum("ki,ki->k", u, np.linalg.solve(blocks, u[:, :, None])[:, :, 0])
    return JointFit(solution.x[:3], float(solution.x[3]), solution.cost, single)


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

    def normal(self, x: Float[np.ndarray, "4"]) -> tuple[np.ndarray, np.ndarray, float]:
        """The normal equations with the prior of the scale."""
        A, r, J = self.linearised(x)
        Ar = A @ r
        H, g = J.T @ A @ J, J.T @ Ar
        H[3, 3] += self.scale_information
        g[3] += (x[3] - 1.0) * self.scale_information
        return H, g, float(r @ Ar) + (x[3] - 1.0) ** 2 * self.scale_information
