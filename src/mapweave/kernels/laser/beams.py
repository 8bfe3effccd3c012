"""Returns of a scan as points, and lines through neighbouring ones: normals and incidence, by total least squares."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel


@kernel
def beam_lines(
    x: np.ndarray, y: np.ndarray, r: np.ndarray, hit: np.ndarray, half: int, near: float, near_share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit normals (n, 2) towards the sensor, cosines of incidence (n,), and points (n,) each line was fitted to.

    x, y: (n,) [m], r: (n,) [m] in the sensor frame, in beam order. A neighbour within `half` beams takes part when
    its range differs by less than `near + near_share r` [m]. Under three points: the normal is the beam's own
    direction back, and the cosine is 1.
    """
    n = x.shape[0]
    normal = np.zeros((n, 2))
    cosine = np.ones(n)
    count = np.zeros(n, dtype=np.int64)
    for i in range(n):
        if not hit[i]:
            continue
        limit = near + near_share * r[i]
        m = 0
        sx = sy = sxx = sxy = syy = 0.0
        for k in range(max(0, i - half), min(n, i + half + 1)):
            if not hit[k] or abs(r[k] - r[i]) > limit:
                continue
            dx, dy = x[k] - x[i], y[k] - y[i]
            m += 1
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
        away = r[i] if r[i] != 0.0 else 1.0  # a return at the sensor has no direction
        bx, by = -x[i] / away, -y[i] / away
        count[i] = m
        if m < 3:
            normal[i, 0], normal[i, 1] = bx, by
            continue
        cxx = sxx - sx * sx / m
        cxy = sxy - sx * sy / m
        cyy = syy - sy * sy / m
        along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        nx, ny = -math.sin(along), math.cos(along)
        c = nx * bx + ny * by
        if c < 0.0:
            nx, ny, c = -nx, -ny, -c
        normal[i, 0], normal[i, 1] = nx, ny
        cosine[i] = c
    return normal, cosine, count


class ScanReturns(NamedTuple):
    """n returns in beam order, in the robot frame: points and normals (n, 2) [m], range (n,) [m], cosine of incidence
    (n,), points (n,) that each line was fitted to, number (n,) of the beam.
    """

    s: np.ndarray
    normal: np.ndarray
    r: np.ndarray
    c: np.ndarray
    support: np.ndarray
    beam: np.ndarray


@kernel
def scan_returns(
    ranges: np.ndarray,
    hit: np.ndarray,
    within: tuple[float, float],
    angles: tuple[float, float],
    mount: np.ndarray,
    half: int,
    near: float,
    near_share: float,
) -> ScanReturns:
    """The returns of a scan whose ranges (m,) [m] lie `within` two, and of which `hit` says that they are any.

    angles: of the first beam, and from each to the next [rad]; mount: (3,) pose of the sensor on the robot; half, near,
    near_share: as `beam_lines` takes them.
    """
    m = ranges.shape[0]
    x, y, r, there = np.zeros(m), np.zeros(m), np.ones(m), np.zeros(m, np.bool_)
    n = 0
    for k in range(m):
        if hit[k] and within[0] < ranges[k] < within[1]:  # neither is so of what is no number
            angle = angles[0] + angles[1] * k
            r[k], there[k] = ranges[k], True
            x[k], y[k] = r[k] * math.cos(angle), r[k] * math.sin(angle)
            n += 1
    lines, cosine, count = beam_lines(x, y, r, there, half, near, near_share)
    s, normal, far, c = np.empty((n, 2)), np.empty((n, 2)), np.empty(n), np.empty(n)
    support, beam = np.empty(n, np.int64), np.empty(n, np.int64)
    cos, sin = math.cos(mount[2]), math.sin(mount[2])
    i = 0
    for k in range(m):
        if not there[k]:
            continue
        s[i, 0], s[i, 1] = mount[0] + cos * x[k] - sin * y[k], mount[1] + sin * x[k] + cos * y[k]
        normal[i, 0] = cos * lines[k, 0] - sin * lines[k, 1]
        normal[i, 1] = sin * lines[k, 0] + cos * lines[k, 1]
        far[i], c[i], support[i], beam[i] = r[k], cosine[k], count[k], k
        i += 1
    return ScanReturns(s, normal, far, c, support, beam)


@kernel
def spacing(points: np.ndarray) -> np.ndarray:
    """(n,) [m] from each of the points (n, 2) to the nearer of those beside it in their order; 0 of one alone."""
    n = points.shape[0]
    out = np.zeros(n)
    last = math.inf
    for i in range(n):
        after = math.inf
        if i + 1 < n:
            after = math.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        out[i] = min(last, after) if n > 1 else 0.0
        last = after
    return out
