"""A local map as one term of a least-squares problem over frames, scales and landmarks."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, slots=True)
class MapTerm:
    """One local map as a measurement of its frame (x, y, theta), its scale and its n landmarks, in that order.

    z: (2n,) [m]; information: (2n, 2n), the inverse of V_k. Its normal equations cost n^2, not n^3: the information
    is turned, not multiplied.
    """

    where: Int[np.ndarray, " d"]
    z: Float[np.ndarray, " m"]
    information: Float[np.ndarray, "m m"]

    @property
    def columns(self) -> Int[np.ndarray, "1 d"]:
        return self.where[None]

    @property
    def size(self) -> int:
        return len(self.z)

    def residual(self, x: np.ndarray) -> Float[np.ndarray, " m"]:
        frame, scale, points = x[self.where[:3]], x[self.where[3]], x[self.where[4:]].reshape(-1, 2)
        c, s = np.cos(frame[2]), np.sin(frame[2])
        d = points - frame[:2]
        r = -self.z
        r[0::2] += scale * (c * d[:, 0] + s * d[:, 1])
        r[1::2] += scale * (c * d[:, 1] - s * d[:, 0])
        return r

    def squares(self, x: np.ndarray) -> Float[np.ndarray, "1"]:
        r = self.residual(x)
        return np.array([r @ self.information @ r])

    def costs(self, x: np.ndarray) -> Float[np.ndarray, "1"]:
        return self.squares(x)

    def design(self, x: np.ndarray) -> Float[np.ndarray, "m 4"]:
        """Derivatives of the residual by frame and scale."""
        frame, scale, points = x[self.where[:3]], x[self.where[3]], x[self.where[4:]].reshape(-1, 2)
        c, s = np.cos(frame[2]), np.sin(frame[2])
        d = points - frame[:2]
        u, v = c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]
        D = np.empty((len(d), 2, 4))
        D[:, 0, 0], D[:, 0, 1], D[:, 1, 0], D[:, 1, 1] = -scale * c, -scale * s, scale * s, -scale * c
        D[:, 0, 2], D[:, 1, 2] = scale * v, -scale * u
        D[:, 0, 3], D[:, 1, 3] = u, v
        return D.reshape(-1, 4)

    def jacobian(self, x: np.ndarray) -> Float[np.ndarray, "m d"]:
        """Derivatives of the residual by everything it touches, in the order of `where`."""
        c, s, k = np.cos(x[self.where[2]]), np.sin(x[self.where[2]]), x[self.where[3]]
        turn = np.kron(np.eye(self.size // 2), k * np.array([[c, s], [-s, c]]))
        return np.concatenate([self.design(x), turn], axis=1)

    def normal(self, x: np.ndarray) -> tuple[Float[np.ndarray, "1 d d"], Float[np.ndarray, "1 d"]]:
        A, D, r = self.information, self.design(x), self.residual(x)
        c, s, k = np.cos(x[self.where[2]]), np.sin(x[self.where[2]]), x[self.where[3]]
        AD, Ar = A @ D, A @ r
        H = np.empty((len(self.where), len(self.where)))
        H[:4, :4] = D.T @ AD
        H[4:, :4] = k * _turn_rows(AD, c, s)
        H[:4, 4:] = H[4:, :4].T
        H[4:, 4:] = k * k * _turn_rows(_turn_rows(A, c, s).T, c, s).T
        g = np.concatenate([D.T @ Ar, k * _turn_rows(Ar[:, None], c, s)[:, 0]])
        return H[None], g[None]


def _turn_rows(A: Float[np.ndarray, "m k"], c: float, s: float) -> Float[np.ndarray, "m k"]:
    """Every pair of rows turned by the rotation [[c, -s], [s, c]]."""
    out = np.empty_like(A)
    out[0::2] = c * A[0::2] - s * A[1::2]
    out[1::2] = s * A[0::2] + c * A[1::2]
    return out
