"""Laser beams: valid returns as points with a feature q of the surface, its line and an insertion weight.

A feature comes from the intensity, less what its calibration says of where the light came back from.
"""

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
