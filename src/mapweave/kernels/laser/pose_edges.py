"""Edges of a planar pose graph: residuals, and the information and gradient they give, an edge at a time.

The residual is `z^-1 (x_i^-1 x_j)` as x, y, theta. Poses are (n, 3), measurements (m, 3), information (m, 3, 3).
"""

import math

import numpy as np

from .._jit import kernel


@kernel
def edge_residuals(pose: np.ndarray, first: np.ndarray, second: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(m, 3) with theta in (-pi, pi]."""
    m = first.shape[0]
    out = np.empty((m, 3))
    for k in range(m):
        i, j = first[k], second[k]
        c, s = math.cos(pose[i, 2]), math.sin(pose[i, 2])
        dx, dy = pose[j, 0] - pose[i, 0], pose[j, 1] - pose[i, 1]
        ex, ey = c * dx + s * dy - measured[k, 0], -s * dx + c * dy - measured[k, 1]
        cz, sz = math.cos(measured[k, 2]), math.sin(measured[k, 2])
        out[k, 0], out[k, 1] = cz * ex + sz * ey, -sz * ex + cz * ey
        out[k, 2] = math.pi - (math.pi - (pose[j, 2] - pose[i, 2] - measured[k, 2])) % (2.0 * math.pi)
    return out


@kernel
def edge_squares(
    pose: np.ndarray, first: np.ndarray, second: np.ndarray, measured: np.ndarray, information: np.ndarray
) -> np.ndarray:
    """(m,) squared whitened residuals."""
    r = edge_residuals(pose, first, second, measured)
    out = np.empty(r.shape[0])
    for k in range(r.shape[0]):
        W = information[k]
        a, b, c = r[k, 0], r[k, 1], r[k, 2]
        out[k] = W[0, 0] * a * a + W[1, 1] * b * b + W[2, 2] * c * c
        out[k] += 2.0 * (W[0, 1] * a * b + W[0, 2] * a * c + W[1, 2] * b * c)
    return out


@kernel
def edge_normal(
    pose: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    measured: np.ndarray,
    information: np.ndarray,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """`J^T W J` (m, 6, 6) and `J^T W r` (m, 6) over the poses first, second; each `weight` (m,) times."""
    m = first.shape[0]
    r = edge_residuals(pose, first, second, measured)
    H, g = np.empty((m, 6, 6)), np.empty((m, 6))
    J, WJ = np.zeros((3, 6)), np.zeros((3, 6))
    J[2, 2], J[2, 5] = -1.0, 1.0
    for k in range(m):
        i, j = first[k], second[k]
        turned = pose[i, 2] + measured[k, 2]
        c, s = math.cos(turned), math.sin(turned)
        dx, dy = pose[j, 0] - pose[i, 0], pose[j, 1] - pose[i, 1]
        J[0, 0], J[0, 1], J[1, 0], J[1, 1] = -c, -s, s, -c
        J[0, 3], J[0, 4], J[1, 3], J[1, 4] = c, s, -s, c
        J[0, 2], J[1, 2] = c * dy - s * dx, -s * dy - c * dx
        for a in range(3):
            u, v, w = (
                weight[k] * information[k, a, 0],
                weight[k] * information[k, a, 1],
                weight[k] * information[k, a, 2],
            )
            for b in range(6):
                WJ[a, b] = u * J[0, b] + v * J[1, b] + w * J[2, b]
        for a in range(6):
            g[k, a] = WJ[0, a] * r[k, 0] + WJ[1, a] * r[k, 1] + WJ[2, a] * r[k, 2]
            for b in range(6):
                H[k, a, b] = J[0, a] * WJ[0, b] + J[1, a] * WJ[1, b] + J[2, a] * WJ[2, b]
    return H, g
