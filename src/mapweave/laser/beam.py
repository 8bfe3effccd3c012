"""Laser beams: valid returns as points with a feature q of the surface, its line and an insertion weight.

A feature is what intensity says of the surface, less how it falls with range and incidence. That is found from the log
itself: `log I = rho[window, cell] + g(r) + h(c)`, where what a place reflects is unknown but the same for every beam
that hits it, so that looking at one place from several ranges and angles tells g and h. Odometry is good enough over a
window of a few scans; no map is needed. What the feature is worth is another question: `light_worth`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse

from ..core import se2
from ..core.config import config
from ..core.gaussian import symmetrise
from ..core.records import Scan, freeze, frozen
from ..kernels.laser.beams import scan_returns

LEAST_INTENSITY = 0.0  # returns at or under this bear no light
CALIBRATION_ITERATIONS = 12  # of the robust fit, at most

LINE_ANGLE = 0.1  # [rad] beams to each side this near may share a line (8 of a URG-04LX, 6 of a SICK)
BEAM_NEAR = 0.08  # [m] at no range, and
BEAM_NEAR_SHARE = 0.15  # [m/m]: neighbours differ in range by less than near + near_share r
BEAM_LEAST_COSINE = 0.15  # of incidence that is reckoned with: what grazes a wall more counts as this
GREATEST_Q = 1.2  # normalised intensities are cut off here

CALIBRATION_WINDOW = 12  # scans laid together
CALIBRATION_CELL = 0.1  # [m] in which surfaces are taken for one
CALIBRATION_KNOT = 0.4  # [m] between the knots of g
CALIBRATION_SMOOTH = 10.0  # weight of second differences of g
CALIBRATION_BEND = 0.1  # [log units] second difference of g between knots that laws of real light have
BLUR, BLUR_ANGLE = 0.01, 0.015  # [m], [rad] errors of ranges and of angles of incidence
CALIBRATION_CAUCHY = 0.1  # [log units] width of the robust weight
CALIBRATION_LEAST_COSINE = 0.15  # of incidence that is reckoned with: what grazes a wall more counts as this
MOST_WINDOWS = 150  # of scans that are used
CALIBRATION_TOP = 0.9  # the q given to the 95th percentile
LEAST_SAMPLES = 500  # returns, or there is no calibration
MOST_RESIDUAL = 0.35  # [log units] beyond this the intensity does not follow the model

WHOLE = 50.0  # [1/m^2] along its wall: 60 returns then tell a decimetre e^15 to 1, and light counts as set
NO_LIGHT = 65535.0  # what scanners of 16 bits send where they measured no light


@dataclass(frozen=True, slots=True)
class IntensityCalibration:
    """How intensity falls with range and incidence: `log I = log rho + log_gain(r) + log_incidence(c)`.

    knots: (k,) ranges [m]; log_gain: (k,) at the knots, linear between, held outside; exponent: p of incidence c^p;
    scale: the intensity of q = 1 at gain 1; residual: robust standard deviation of the fit in log units; samples:
    returns used. residual_by_range: (k,) median absolute residual near each knot. gain_sd: (k,) of log_gain, which
    is told over that at 1 m; exponent_sd: of p; empty and 0 where not known. cosines, log_incidence: (j,) the law
    of incidence where none of the form c^p fits as well, empty where it does. information: [1/m^2] what the feature of
    a return tells of where along its wall it is; `WHOLE` where nobody asked. middle: the median feature.
    """

    knots: Float[np.ndarray, " k"]
    log_gain: Float[np.ndarray, " k"]
    exponent: float
    scale: float
    residual: float
    samples: int
    residual_by_range: Float[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))
    cosines: Float[np.ndarray, " j"] = field(default_factory=lambda: np.zeros(0))
    log_incidence: Float[np.ndarray, " j"] = field(default_factory=lambda: np.zeros(0))
    information: float = WHOLE
    middle: float = 0.5
    gain_sd: Float[np.ndarray, " _"] = field(default_factory=lambda: np.zeros(0))
    exponent_sd: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "knots", "log_gain", "residual_by_range", "cosines", "log_incidence", "gain_sd")

    @property
    def weight(self) -> float:
        """What light gets of what the settings give it, 0 to 1."""
        return min(1.0, max(0.0, self.information) / WHOLE)

    def gain(self, r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.asarray(np.exp(np.interp(r, self.knots, self.log_gain)))

    def incidence(self, c: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Of cosines; 1 straight ahead."""
        if len(self.cosines):
            return np.asarray(np.exp(np.interp(c, self.cosines, self.log_incidence)))
        return np.asarray(c**self.exponent)

    def feature(
        self, intensity: Float[np.ndarray, " n"], r: Float[np.ndarray, " n"], c: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """`I / (scale g(r) h(c))`: what the surface reflects, about 0.9 of the brightest."""
        return np.asarray(intensity / (self.scale * self.gain(r) * self.incidence(c)))


STEERING = ("normalised",)  # features of the surface alone; raw intensity changes with range and would hold the robot
FEATURES = ("normalised", "raw", "none")


@config
class BeamConfig:
    least_range: float = 0.02  # [m], nearer returns are the robot itself
    greatest_range: float = 25.0  # [m], farther returns are left out, whatever the sensor allows


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
    """The valid returns of `scan` with the `feature` asked for, each from where the robot was when it was taken.

    Beam k of n is seen from `exp((k / (n - 1) - 1/2) log(motion))` in the frame of the robot at the scan's pose.
    `raw`: I / scale; `normalised`: `min(1.2, I / (scale g(r) h(max(c, 0.15))))`, the median of the log where no light
    was measured; both need `calibration` (for `raw` its scale alone is read); `none`: 0.
    """
    n = len(scan.ranges)
    every = np.zeros(n) if scan.intensities is None else np.nan_to_num(scan.intensities, posinf=0.0, neginf=0.0)
    hit = scan.hit & (every > LEAST_INTENSITY) if feature == "raw" else scan.hit
    s, normal, r, c, support, beam = scan_returns(
        frozen(scan.ranges),
        frozen(hit, np.bool_),
        (float(cfg.least_range), float(min(scan.range_max, cfg.greatest_range))),
        (float(scan.angle_min), float(scan.angle_increment)),
        frozen(scan.T_robot_sensor),
        max(2, round(LINE_ANGLE / max(abs(scan.angle_increment), 1e-6))),
        BEAM_NEAR,
        BEAM_NEAR_SHARE,
    )
    light = every[beam]
    if scan.motion is not None and n > 1:
        there = se2.exp(np.outer(beam / (n - 1) - 0.5, se2.log(scan.motion)))
        s, normal = se2.act(there, s), np.ascontiguousarray(se2.act(there * [0.0, 0.0, 1.0], normal))
    q = _feature(light, r, c, feature, calibration)
    return Beams(s, q, insertion_weight(r), normal, r, c, light, support, beam)


def insertion_weight(r: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """`(0.01 / max(0.01, 0.01 r))^2`: what a return counts in its cell; 1 up to a metre, falling with range squared."""
    return np.asarray((0.01 / np.maximum(0.01, 0.01 * r)) ** 2)


def _feature(
    intensity: Float[np.ndarray, " n"],
    r: Float[np.ndarray, " n"],
    c: Float[np.ndarray, " n"],
    feature: str,
    calibration: IntensityCalibration | None,
) -> Float[np.ndarray, " n"]:
    if feature == "none" or calibration is None:
        return np.zeros(len(r))
    if feature == "raw":
        return np.minimum(GREATEST_Q, intensity / calibration.scale)
    q = np.minimum(GREATEST_Q, calibration.feature(intensity, r, np.maximum(c, BEAM_LEAST_COSINE)))
    return np.where(measured(intensity), q, calibration.middle)


def measured(intensity: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Where light was measured at all."""
    return np.asarray((intensity > LEAST_INTENSITY) & (intensity != NO_LIGHT))


FREE_KNOT = 0.1  # of log range between the knots of a law without a form,
FREE_SMOOTH = 3.0  # whose second differences weigh so much,
FREE_COSINES = frozen(np.array([0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 1.0]))  # and the knots of its law of incidence
FORM_COSTS = 1.03  # times the held-out residual that a law with a form may have of one without
HALVED = 10  # windows of either half, at most, that tell what a law of the others is worth,
HALF_ITERATIONS = 6  # of their robust fits
CAPPED = 0.5  # [log units] more residual than this counts as this there


class Overlaps(NamedTuple):
    """Returns of places that several scans of a window hit: cell number, range [m], cosine, intensity, window."""

    cell: Int[np.ndarray, " n"]
    r: Float[np.ndarray, " n"]
    c: Float[np.ndarray, " n"]
    light: Float[np.ndarray, " n"]
    window: Int[np.ndarray, " n"]

    def of(self, keep: Bool[np.ndarray, " n"]) -> "Overlaps":
        _, cell = np.unique(self.cell[keep], return_inverse=True)
        return Overlaps(cell, *(a[keep] for a in self[1:]))


class Calibrated(NamedTuple):
    """whole: from all windows; halves: two from every other one of some windows, of the same form."""

    whole: IntensityCalibration
    halves: tuple[IntensityCalibration, IntensityCalibration]


def calibrate(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"]) -> IntensityCalibration | None:
    """The calibration from scans and poses that are right over a window; None when places are not seen twice.

    `g` linear over range and `c^p` where they foretell returns of other windows as well as laws without a form do.
    """
    made = calibrated(scans, poses)
    return None if made is None else made.whole


def calibrated(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"]) -> Calibrated | None:
    """As `calibrate`, and calibrations of halves of the windows, those with even numbers first, or None."""
    seen = _samples(scans, poses)
    if len(seen.r) < LEAST_SAMPLES:
        return None
    halves = _halves(seen)
    if not min(len(half.r) for half in halves):
        whole = _scaled(seen, _fitted(seen, free=False))
        return Calibrated(whole, (whole, whole))
    formed, free = ([_fitted(half, HALF_ITERATIONS, free=free) for half in halves] for free in (False, True))
    chosen = free if _held_out(halves, formed) > FORM_COSTS * _held_out(halves, free) else formed
    whole = _scaled(seen, _fitted(seen, free=chosen is free))
    first, second = (_scaled(half, fit) for half, fit in zip(halves, chosen, strict=True))
    return Calibrated(whole, (first, second))


def _halves(seen: Overlaps) -> tuple[Overlaps, Overlaps]:
    """The returns of windows with even numbers and of those with odd ones, of so many windows as tell a law."""
    pairs = np.unique(seen.window // 2)
    if len(pairs) > HALVED:
        pairs = pairs[np.linspace(0, len(pairs) - 1, HALVED).astype(int)]
    kept = np.isin(seen.window // 2, pairs)
    return seen.of(kept & (seen.window % 2 == 0)), seen.of(kept & (seen.window % 2 == 1))


LawFit = tuple[IntensityCalibration, Float[np.ndarray, " _"]]  # a law with scale 1 and the size of its residuals


def _scaled(seen: Overlaps, fit: LawFit) -> IntensityCalibration:
    law, size = fit
    K = len(law.knots)
    at = np.searchsorted(0.5 * (law.knots[1:] + law.knots[:-1]), seen.r)
    by_range = np.array([np.median(size[at == k]) if (at == k).any() else np.nan for k in range(K)])
    expected = law.gain(seen.r) * law.incidence(seen.c)
    scale = float(np.quantile(seen.light / expected, 0.95)) / CALIBRATION_TOP
    return replace(
        law,
        scale=scale,
        residual=float(1.4826 * np.median(size)),
        residual_by_range=np.nan_to_num(by_range),
        middle=float(np.median(seen.light / expected)) / scale,
    )


def _held_out(halves: tuple[Overlaps, Overlaps], fits: Sequence[LawFit]) -> float:
    """Mean residual [log units] of the law of either half in the windows of the other."""
    total = 0.0
    for (law, _), other in zip(fits, halves[::-1], strict=True):
        y = np.log(other.light) - np.log(law.gain(other.r) * law.incidence(other.c))
        _, off = _centred(np.column_stack([y, y]), other.cell, np.ones(len(y)), int(other.cell.max()) + 1)
        total += float(np.minimum(np.abs(off), CAPPED).sum())
    return total / (len(halves[0].r) + len(halves[1].r))


def _fitted(seen: Overlaps, iterations: int = CALIBRATION_ITERATIONS, *, free: bool) -> LawFit:
    """The law with scale 1, its gain 1 at 1 m and 1 straight ahead, and the size of the residual of every return."""
    y = np.log(seen.light)
    if free:
        first = FREE_KNOT * np.floor(np.log(seen.r.min()) / FREE_KNOT)
        K = max(3, int(np.ceil((np.log(seen.r.max()) - first) / FREE_KNOT)) + 1)
        knots = np.exp(first + FREE_KNOT * np.arange(K))

        def design(r: np.ndarray, c: np.ndarray) -> np.ndarray:
            return np.column_stack([_hats(r, knots), _hats(c, FREE_COSINES)])

    else:
        K = int(np.ceil(seen.r.max() / CALIBRATION_KNOT)) + 1
        knots = CALIBRATION_KNOT * np.arange(K)

        def design(r: np.ndarray, c: np.ndarray) -> np.ndarray:
            return np.column_stack([_hats(r, knots), np.log(c)])

    X = design(seen.r, seen.c)
    n = X.shape[1]
    ridge = 1e-3 * np.eye(n)
    for first_row, size in ((0, K), (K, n - K)):
        if size >= 3:
            second = np.diff(np.eye(size), 2, axis=0)
            part = slice(first_row, first_row + size)
            ridge[part, part] += (FREE_SMOOTH if free else CALIBRATION_SMOOTH) * second.T @ second
    weight = np.ones(len(y))
    x, residual, Xc, A = np.zeros(n), y, X, ridge
    groups = int(seen.cell.max()) + 1
    for _ in range(iterations):
        Xc, yc = _centred(np.column_stack([X, y]), seen.cell, weight, groups)
        A = (Xc * weight[:, None]).T @ Xc
        x = np.linalg.solve(A + ridge, (Xc * weight[:, None]).T @ yc)
        residual = yc - Xc @ x
        weight = 1.0 / (1.0 + (residual / CALIBRATION_CAUCHY) ** 2)
    bends = float((weight * np.square(residual)).sum() / weight.sum())
    bends = bends if free else max(bends, CALIBRATION_SMOOTH * CALIBRATION_BEND**2)
    blurred = np.column_stack([design(*_blurred(seen)), y])
    Xb, yb = _centred(blurred, seen.cell, weight, groups)
    off = np.linalg.solve((Xb * weight[:, None]).T @ Xb + ridge, (Xb * weight[:, None]).T @ yb) - x
    P = _sandwich(Xc, weight * residual, A, ridge, bends, seen.window) + np.outer(off, off)
    at_one = np.zeros((K, n))
    at_one[:, :K] = np.eye(K) - _hats(np.array([1.0]), knots)  # gains are told over that at 1 m
    slope = np.zeros((1, n))
    slope[0, K:] = np.linalg.pinv(np.log(FREE_COSINES)[:, None] - np.log(FREE_COSINES).mean())[0] if free else 1.0
    gain, exponent = at_one @ x, float((slope @ x)[0])
    incidence = (FREE_COSINES, x[K:] - x[-1]) if free else (np.zeros(0), np.zeros(0))
    law = IntensityCalibration(knots, gain, exponent, 1.0, 0.0, len(y), np.zeros(K), *incidence)
    gain_sd, exponent_sd = (np.sqrt(np.maximum(np.diag(J @ P @ J.T), 0.0)) for J in (at_one, slope))
    return replace(law, gain_sd=gain_sd, exponent_sd=float(exponent_sd[0])), np.abs(residual)


def _blurred(seen: Overlaps) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Ranges and cosines with as much error again as they have: what that changes, their own error may have changed."""
    rng = np.random.default_rng(0)
    angle = np.arccos(np.clip(seen.c, 0.0, 1.0)) + BLUR_ANGLE * rng.standard_normal(len(seen.c))
    return seen.r + BLUR * rng.standard_normal(len(seen.r)), np.maximum(np.cos(angle), CALIBRATION_LEAST_COSINE)


def _sandwich(
    X: np.ndarray, pull: np.ndarray, A: np.ndarray, ridge: np.ndarray, bends: float, window: np.ndarray
) -> Float[np.ndarray, "n n"]:
    """Covariance of a law whose returns of one window err alike: places are not even and poses bend.

    X, pull: rows and weighed residuals at the fit; A: its normal matrix; bends: what a unit of `ridge` is uncertain by
    where it alone holds the law.
    """
    sums = np.zeros((int(window.max()) + 1, X.shape[1]))
    np.add.at(sums, window, X * pull[:, None])
    seen = int((np.abs(sums).sum(axis=1) > 0).sum())
    bread = np.linalg.inv(A + ridge)
    return symmetrise(bread @ (sums.T @ sums * (seen / max(seen - 1, 1)) + bends * ridge) @ bread)


def raw_scale(scans: Sequence[Beams]) -> IntensityCalibration:
    """What `raw` divides by: the greatest intensity but for one in a thousand; no gain, no incidence."""
    light = np.concatenate([b.intensity[(b.intensity > 0) & (b.intensity != NO_LIGHT)] for b in scans])
    top = float(np.quantile(light, 0.999)) if len(light) else 1.0
    return IntensityCalibration(np.array([0.0, 1.0]), np.zeros(2), 0.0, max(top, 1e-9), 0.0, len(light), np.zeros(2))


def _samples(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"]) -> Overlaps:
    """Every return with light in a cell that more than one scan of a window hit."""
    starts = np.arange(0, len(scans), CALIBRATION_WINDOW)
    if len(starts) > MOST_WINDOWS:
        starts = starts[np.linspace(0, len(starts) - 1, MOST_WINDOWS).astype(int)]
    parts: list[Overlaps] = []
    count = 0
    for start in starts.tolist():
        part = range(start, min(start + CALIBRATION_WINDOW, len(scans)))
        points = np.concatenate([se2.act(poses[k], scans[k].s) for k in part])
        who = np.concatenate([np.full(len(scans[k].r), k) for k in part])
        r, light, support = (
            np.concatenate([getattr(scans[k], name) for k in part]) for name in ("r", "intensity", "support")
        )
        keep = (support >= 3) & (light > 0) & (light != NO_LIGHT)
        if not keep.any():
            continue
        ij = np.floor(points[keep] / CALIBRATION_CELL).astype(np.int64)
        ij -= ij.min(axis=0)
        _, number = np.unique(ij[:, 0] * (int(ij[:, 1].max()) + 1) + ij[:, 1], return_inverse=True)
        first, last = np.full(number.max() + 1, 1 << 60), np.full(number.max() + 1, -1)
        np.minimum.at(first, number, who[keep])
        np.maximum.at(last, number, who[keep])
        twice = (last > first)[number]
        cosine = np.maximum(_settled_cosine(scans, poses, part, number, keep)[twice], CALIBRATION_LEAST_COSINE)
        window = np.full(int(twice.sum()), start // CALIBRATION_WINDOW)
        parts.append(Overlaps(number[twice] + count, r[keep][twice], cosine, light[keep][twice], window))
        count += int(number.max()) + 1
    if not parts:
        none = np.zeros(0)
        return Overlaps(none.astype(np.int64), none, none, none, none.astype(np.int64))
    whole = Overlaps(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    return whole.of(np.ones(len(whole.r), bool))


def _settled_cosine(
    scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], part: range, cell: np.ndarray, keep: np.ndarray
) -> Float[np.ndarray, " n"]:
    """Cosines of incidence on the mean line of all returns of each `cell`, of those of scans `part` that are kept.

    A line of one scan's few beams is so unsure where it is grazed that the law of incidence would come out too weak.
    """
    seen = [scans[k] for k in part]
    facing = np.concatenate([b.normal @ se2.rotation(float(poses[k, 2])).T for k, b in zip(part, seen, strict=True)])
    side = np.concatenate([np.sign(b.normal[:, 0] * b.s[:, 1] - b.normal[:, 1] * b.s[:, 0]) for b in seen])[keep]
    x, y = facing[keep].T
    mean_x, mean_y = (np.bincount(cell, a)[cell] for a in (x, y))
    turned = np.arctan2(mean_x * y - mean_y * x, mean_x * x + mean_y * y)
    c = np.concatenate([b.c for b in seen])[keep]
    return np.asarray(np.cos(np.arccos(np.clip(c, 0.0, 1.0)) - side * turned))


def _hats(x: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(n, K): the weights of the knots in a function linear between them and held outside."""
    K = len(knots)
    x = np.clip(x, knots[0], knots[-1])
    at = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, K - 2)
    share = (x - knots[at]) / (knots[at + 1] - knots[at])
    out = np.zeros((len(x), K))
    rows = np.arange(len(x))
    out[rows, at], out[rows, at + 1] = 1.0 - share, share
    return out


def _centred(Z: np.ndarray, cell: np.ndarray, weight: np.ndarray, groups: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns of Z less their weighted mean in each cell; the last column apart."""
    weighted = sparse.csc_array((weight, cell, np.arange(len(cell) + 1)), shape=(groups, len(cell)))
    centred = Z - ((weighted @ Z) / np.bincount(cell, weight, groups)[:, None])[cell]
    return centred[:, :-1], centred[:, -1]
