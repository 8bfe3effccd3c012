"""How robots are turned: a heading [rad] each in the plane, a rotation vector [rad] each in space.

One array `(n,)` or `(n, 3)`, so that everything above is written once. A small turn is one of the common axes: it
multiplies from the left and adds to a heading.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from . import se2

Headings = Float[np.ndarray, "n *t"]
TURNS = {2: ("heading",), 3: ("rx", "ry", "rz")}  # as columns of a table, by dimension


def matrices(heading: Headings) -> Float[np.ndarray, "n d d"]:
    """R that carries each robot's own axes into the common ones."""
    return np.asarray(se2.rotation(heading) if heading.ndim == 1 else Rotation.from_rotvec(heading).as_matrix())


def headings(R: Float[np.ndarray, "n d d"]) -> Headings:
    """The headings or rotation vectors of R."""
    if R.shape[-1] == 2:
        return np.asarray(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def turned(heading: Headings, by: Headings) -> Headings:
    """`heading` after the turns `by` of the common axes."""
    if heading.ndim == 1:
        return np.asarray(se2.wrap_angle(heading + by))
    return np.asarray((Rotation.from_rotvec(by) * Rotation.from_rotvec(heading)).as_rotvec())


def nearest(M: Float[np.ndarray, "n d d"]) -> Float[np.ndarray, "n d d"]:
    """The rotations of least squared difference from M; any of them where M does not tell."""
    U, _, Vt = np.linalg.svd(M)
    U[..., :, -1] *= np.where(np.linalg.det(U @ Vt) < 0.0, -1.0, 1.0)[..., None]
    return np.asarray(U @ Vt)


def angles(R: Float[np.ndarray, "n d d"], S: Float[np.ndarray, "n d d"]) -> Float[np.ndarray, " n"]:
    """How far [rad] R is turned from S."""
    sine = np.linalg.norm(R - S, axis=(1, 2)) / np.sqrt(8.0)  # of half the angle
    return np.asarray(2.0 * np.arcsin(np.minimum(sine, 1.0)))


def about(M: Float[np.ndarray, "d d"], axes: Float[np.ndarray, "t q"]) -> Float[np.ndarray, "d d"]:
    """The turn about `axes` (one of them, or all) of least squared difference from M."""
    if axes.shape != (3, 1):
        return np.asarray(nearest(M[None])[0])
    a, skew = axes[:, 0], M - M.T
    sine = a @ np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return np.asarray(Rotation.from_rotvec(np.arctan2(sine, np.trace(M) - a @ M @ a) * a).as_matrix())
