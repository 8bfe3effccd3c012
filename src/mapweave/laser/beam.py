"""Laser beams: valid returns as points with a feature q of the surface, its line and an insertion weight.

A feature is what intensity says of the surface, less how it falls with range and incidence. That is found from the log
itself: `log I = rho[window, cell] + g(r) + p log c`, where what a place reflects is unknown but the same for every beam
that hits it, so that looking at one place from several ranges and angles tells g and p. Odometry is good enough over a
window of a few scans; no map is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.config import config
from ..core.records import Scan, frozen
from ..kernels.laser.beams import beam_lines


@dataclass(frozen=True, slots=True)
class IntensityCalibration:
    """How intensity falls with range and incidence: `log I = log rho + log_gain(r) + exponent log c`.

    knots: (k,) ranges [m]; log_gain: (k,) at the knots, linear between, held outside; exponent: p; scale: the
    intensity of q = 1 at gain 1; residual: robust standard deviation of the fit in log units; samples: returns used.
    residual_by_range: (k,) median absolute residual near each knot.
    """

    knots: Float[np.ndarray, " k"]
    log_gain: Float[np.ndarray, " k"]
    exponent: float
    scale: float
    residual: float
    samples: int
    residual_by_range: Float[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name in ("knots", "log_gain", "residual_by_range"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def gain(self, r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(np.exp(np.interp(r, self.knots, self.log_gain)))


STEERING = ("normalised",)  # features of the surface alone; raw intensity changes with range and would hold the robot
FEATURES = ("normalised", "raw", "none")


@config
class BeamConfig:
    least_range: float = 0.02  # [m], nearer returns are the robot itself
    greatest_range: float = 25.0  # [m], farther returns are left out, whatever the sensor allows
    least_intensity: float = 0.0  # returns at or under this are too weak; asked only where intensities mean something
    line_angle: float = 0.1  # [rad] beams to each side this near may share a line (8 of a URG-04LX, 6 of a SICK)
    near: float = 0.08  # [m] at no range, and
    near_share: float = 0.15  # [m/m]: neighbours differ in range by less than near + near_share r
    least_cosine: float = 0.15  # of incidence that is reckoned with: what grazes a wall more counts as this
    greatest_q: float = 1.2  # normalised intensities are cut off here


class Beams(NamedTuple):
    """The n valid returns of one scan, in the robot frame.

    s: (n, 2) points [m]; q: (n,) feature; w: (n,) insertion weight in (0, 1]; normal: (n, 2) unit, towards the
    sensor; r: (n,) range [m]; c: (n,) cosine of incidence; intensity: (n,) as read (0 without); support: (n,) points
    each line was fitted to; beam: (n,) its number in the scan.
    """

    s: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"]
    w: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 2"]
    r: Float[np.ndarray, " n"]
    c: Float[np.ndarray, " n"]
    intensity: Float[np.ndarray, " n"]
    support: Int[np.ndarray, " n"]
    beam: Int[np.ndarray, " n"]


def beams(scan: Scan, feature: str, calibration: IntensityCalibration | None, cfg: BeamConfig) -> Beams:
    """The valid returns of `scan` with the `feature` asked for.

    `raw`: I / scale; `normalised`: `min(1.2, I / (scale g(r) max(c, 0.15)^p))`; both need `calibration` (for `raw`
    its scale alone is read); `none`: 0.
    """
    n = len(scan.ranges)
    r = np.asarray(scan.ranges, float)
    with np.errstate(invalid="ignore"):
        hit = scan.hit & np.isfinite(r) & (r > cfg.least_range) & (r < min(scan.range_max, cfg.greatest_range))
    intensity = np.zeros(n) if scan.intensities is None else np.nan_to_num(scan.intensities, posinf=0.0, neginf=0.0)
    if feature != "none":
        hit = hit & (intensity > cfg.least_intensity)
    r = np.where(hit, r, 1.0)
    angle = scan.angle_min + scan.angle_increment * np.arange(n)
    x, y = r * np.cos(angle), r * np.sin(angle)
    half = max(2, round(cfg.line_angle / max(abs(scan.angle_increment), 1e-6)))
    normal, c, support = beam_lines(x, y, r, hit, half, cfg.near, cfg.near_share)
    index = np.flatnonzero(hit)
    r, c, intensity = r[index], c[index], intensity[index]
    q = _feature(intensity, r, c, feature, calibration, cfg)
    s = se2.act(scan.T_robot_sensor, np.column_stack([x[index], y[index]]))
    turned = normal[index] @ se2.rotation(float(scan.T_robot_sensor[2])).T
    w = insertion_weight(r)
    return Beams(s, q, w, np.ascontiguousarray(turned), r, c, intensity, support[index], index)


def insertion_weight(r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """`(0.01 / max(0.01, 0.01 r))^2`: what a return counts in its cell; 1 up to a metre, falling with range squared."""
    return np.asarray((0.01 / np.maximum(0.01, 0.01 * r)) ** 2)


def _feature(
    intensity: Float[np.ndarray, " n"],
    r: Float[np.ndarray, " n"],
    c: Float[np.ndarray, " n"],
    feature: str,
    calibration: IntensityCalibration | None,
    cfg: BeamConfig,
) -> Float[np.ndarray, " n"]:
    if feature == "none" or calibration is None:
        return np.zeros(len(r))
    if feature == "raw":
        return np.minimum(cfg.greatest_q, intensity / calibration.scale)
    expected = calibration.scale * calibration.gain(r) * np.maximum(c, cfg.least_cosine) ** calibration.exponent
    return np.asarray(np.minimum(cfg.greatest_q, intensity / expected))


@config
class CalibrationConfig:
    window: int = 12  # scans laid together
    cell: float = 0.1  # [m] in which surfaces are taken for one
    knot: float = 0.4  # [m] between the knots of g
    smooth: float = 10.0  # weight of second differences of g
    cauchy: float = 0.1  # [log units] width of the robust weight
    iterations: int = 12  # of the robust fit, at most
    least_cosine: float = 0.15  # of incidence that is reckoned with: what grazes a wall more counts as this
    most_windows: int = 150  # of scans that are used
    top: float = 0.9  # the q given to the 95th percentile
    least_samples: int = 500  # returns, or there is no calibration
    most_residual: float = 0.35  # [log units] beyond this the intensity does not follow the model


def calibrate(
    scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], cfg: CalibrationConfig
) -> IntensityCalibration | None:
    """The calibration from scans and poses that are right over a window; None when places are not seen twice."""
    cell, r, c, light = _samples(scans, poses, cfg)
    if len(r) < cfg.least_samples:
        return None
    knots = cfg.knot * np.arange(int(np.ceil(r.max() / cfg.knot)) + 1)
    K = len(knots)
    y = np.log(light)
    X = np.column_stack([_hats(r, cfg.knot, K), np.log(c)])
    second = np.diff(np.eye(K), 2, axis=0)
    ridge = np.zeros((K + 1, K + 1))
    ridge[:K, :K] = cfg.smooth * second.T @ second
    ridge += 1e-3 * np.eye(K + 1)
    weight = np.ones(len(y))
    x = np.zeros(K + 1)
    groups = int(cell.max()) + 1
    for _ in range(cfg.iterations):
        Xc, yc = _centred(np.column_stack([X, y]), cell, weight, groups)
        A = (Xc * weight[:, None]).T @ Xc
        x = np.linalg.solve(A + ridge, (Xc * weight[:, None]).T @ yc)
        residual = yc - Xc @ x
        weight = 1.0 / (1.0 + (residual / cfg.cauchy) ** 2)
    size = np.abs(residual)
    gain = x[:K] - np.interp(1.0, knots, x[:K])
    expected = np.exp(np.interp(r, knots, gain)) * c ** x[K]
    scale = float(np.quantile(light / expected, 0.95)) / cfg.top
    at = np.clip(np.rint(r / cfg.knot).astype(int), 0, K - 1)
    by_range = np.array([np.median(size[at == k]) if (at == k).any() else np.nan for k in range(K)])
    return IntensityCalibration(
        knots, gain, float(x[K]), scale, float(1.4826 * np.median(size)), len(y), np.nan_to_num(by_range)
    )


def raw_scale(scans: Sequence[Beams]) -> IntensityCalibration:
    """What `raw` divides by: the greatest intensity but for one in a thousand; no gain, no incidence."""
    light = np.concatenate([b.intensity for b in scans])
    top = float(np.quantile(light, 0.999)) if len(light) else 1.0
    return IntensityCalibration(np.array([0.0, 1.0]), np.zeros(2), 0.0, max(top, 1e-9), 0.0, len(light), np.zeros(2))


def _samples(
    scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], cfg: CalibrationConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(cell number, range, cosine, intensity) of every return in a cell that more than one scan of a window hit."""
    starts = np.arange(0, len(scans), cfg.window)
    if len(starts) > cfg.most_windows:
        starts = starts[np.linspace(0, len(starts) - 1, cfg.most_windows).astype(int)]
    cells: list[np.ndarray] = []
    ranges: list[np.ndarray] = []
    cosines: list[np.ndarray] = []
    lights: list[np.ndarray] = []
    count = 0
    for start in starts.tolist():
        part = range(start, min(start + cfg.window, len(scans)))
        points = np.concatenate([se2.act(poses[k], scans[k].s) for k in part])
        who = np.concatenate([np.full(len(scans[k].r), k) for k in part])
        keep = np.concatenate([(scans[k].support >= 3) & (scans[k].intensity > 0) for k in part])
        if not keep.any():
            continue
        ij = np.floor(points[keep] / cfg.cell).astype(np.int64)
        ij -= ij.min(axis=0)
        _, number = np.unique(ij[:, 0] * (int(ij[:, 1].max()) + 1) + ij[:, 1], return_inverse=True)
        first, last = np.full(number.max() + 1, 1 << 60), np.full(number.max() + 1, -1)
        np.minimum.at(first, number, who[keep])
        np.maximum.at(last, number, who[keep])
        seen_twice = (last > first)[number]
        cells.append(number[seen_twice] + count)
        count += int(number.max()) + 1
        for out, name in ((ranges, "r"), (cosines, "c"), (lights, "intensity")):
            out.append(np.concatenate([getattr(scans[k], name) for k in part])[keep][seen_twice])
    if not cells:
        none = np.zeros(0)
        return none.astype(np.int64), none, none, none
    c = np.maximum(np.concatenate(cosines), cfg.least_cosine)
    _, number = np.unique(np.concatenate(cells), return_inverse=True)
    return number, np.concatenate(ranges), c, np.concatenate(lights)


def _hats(r: np.ndarray, knot: float, K: int) -> np.ndarray:
    """(n, K): the weights of the knots in a function linear between them."""
    at = np.clip((r / knot).astype(int), 0, K - 2)
    share = r / knot - at
    out = np.zeros((len(r), K))
    rows = np.arange(len(r))
    out[rows, at], out[rows, at + 1] = 1.0 - share, share
    return out


def _centred(Z: np.ndarray, cell: np.ndarray, weight: np.ndarray, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of Z less their weighted mean in each cell; the last column apart."""
    total = np.bincount(cell, weight, groups)
    mean = np.column_stack([np.bincount(cell, weight * z, groups) for z in Z.T]) / total[:, None]
    centred = Z - mean[cell]
    return centred[:, :-1], centred[:, -1]
