"""Scan to local map: how the robot moved since the last scan, far better than its wheels know.

The local map holds the last keyframes only, so it bends with the drift and never shows a wall twice.
"""

import math
import mmap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from ..core import se2
from ..core.config import config
from ..core.errors import ConfigError
from ..kernels.laser.beams import spacing
from ..kernels.laser.local_map import MatchCost, ScanPoints, add_points, align_scan, count_matches, fit_lines
from ..kernels.mapping.places import heading_peaks
from .beam import Beams

BINS = 360  # directions
SMOOTH = 2.0  # [bins] by which they are smoothed
_AWAY = np.minimum(np.arange(BINS), BINS - np.arange(BINS))
_SMOOTHING = np.fft.rfft(np.exp(-0.5 * np.square(_AWAY / SMOOTH)))


def spectrum(amount: Float[np.ndarray, " bins"]) -> Complex[np.ndarray, " f"]:
    """Of how much wall faces each direction, smoothed, the mean off."""
    out = np.fft.rfft(amount) * _SMOOTHING
    out[0] = 0.0
    return np.asarray(out)


FRONT_END_AGREE = 0.5  # least cosine between a beam's normal and its cell's

FRONT_END_COARSE = 0.2  # cell [m] of the first iterations
FRONT_END_FINE = 0.1  # cell [m] of the last ones
COARSE_ITERATIONS = 8  # Gauss-Newton steps on the coarse level
FINE_ITERATIONS = 12  # Gauss-Newton steps on the fine level
COARSE_KAPPA = 0.15  # [m] width of the robust kernel
FRONT_END_KAPPA = 0.1  # [m] width of the robust kernel on the fine level
KEYFRAME_DISTANCE = 0.4  # [m] driven from which a keyframe is new, however little was turned
FRONT_END_SIGMA = 0.02  # [m] sd of each return
BARE_TANGENT = 0.03  # weight of the error along a line without a feature: a bare wall is alike all along
WIDE_SEARCH = 0.3  # [rad] rotations tried to either side when under WIDE_UNDER of the returns match,
WIDE_SD = 2.0  # sd of the turn that are searched, where that is farther
WIDE_STEP = 0.03  # [rad] between the rotations tried
WIDE_REACH = 0.1  # [m] a return this near its line counts there, on the coarse level
WIDE_TRIES = 3  # rotations, those that most returns match, which are refined
WIDE_TURN = 0.15  # [rad] standard deviation of the turn there, at least
WIDE_UNDER = 0.65  # share of returns matched under which rotations are tried
WIDE_LOSS = 0.08  # of the returns a match must win: so much times ln(1 + squared sd it lies from odometry)
PAST = 0.55  # of a cell, or
PAST_SD = 0.75  # sd of what odometry may err by: so far past the end of a wall that was seen a return may be of it
FRONT_END_REACH = 0.1  # [m] a return this near its line counts as matched
LEAST_SHARE = 0.25  # share of the returns that must match, or odometry is taken
GYRO_SCALE = 0.03  # share of a turn by which the turn of a gyroscope may err besides
ALONE_SEARCH = 1.3  # [rad] turns tried to either side of such a robot's last heading
ALONE_STEP = 0.06  # [rad] between them
ALONE_PEAKS = 5  # turns tried besides, by which its walls face where those of the local map do
ALONE_MOST = 2.6  # [rad] of those at most: turned about, a corridor looks the same
ALONE_PEAKS_APART, ALONE_PEAK_SHARE = 8, 0.3  # bins between peaks; of the greatest
ALONE_SHIFT, ALONE_SHIFTS = 0.4, 2  # [m] and how often to each side: the places tried with each of those
ALONE_REACH = 0.15  # [m] a return this near its line counts in these tries
ALONE_TRIES = 8  # of all, those that most returns match, which are refined,
ALONE_APART, ALONE_APART_TURN = 0.5, 0.075  # [m] or [rad] that these lie apart from each other
ALONE_LOSS = 0.04  # share of the returns that a change of its motion must win: so much times
ALONE_STEADY = 0.1  # ln(1 + (change of the step / this [m])^2 + (change of the turn / the next)^2)
ALONE_STEADY_TURN = 0.15  # [rad] change of the turn that weighs as much
STILL_XY = 0.1  # [m] a robot must leave its place, or
STILL_TURN = 0.1  # [rad] turn, while its wheels report no motion, before they are not believed
ALONE_TURN = 0.35  # [rad] that a robot without odometry may turn in a step, one sigma


@config
class FrontEndConfig:
    matcher: str = "lines"  # how scans are matched: lines, or what is plugged in as one of `mapweave.matchers`
    size: int = 1024  # cells a side of either level, a power of two; the fine one must hold the whole local map
    keyframes: int = 60  # scans the local map holds
    keyframe_turn: float = 0.4  # [rad] beyond which a keyframe is new, whatever was driven
    alpha: float = 1.0  # [m^2 per q^2] what a difference in the feature counts
    neff: float = 60.0  # a scan counts as so many independent returns
    tangent: float = 0.1  # weight of the error along the line, with a feature
    sd_xy: float = 0.03  # [m] + sd_xy_per_m d: how far odometry may err in a step
    sd_xy_per_m: float = 0.3  # and so much more a metre driven
    sd_turn: float = 0.03  # [rad] + sd_turn_per_m d + sd_turn_per_rad |turn|
    sd_turn_per_m: float = 0.15  # [rad] and so much more a metre driven
    sd_turn_per_rad: float = 0.6  # and so much more a radian turned


def allowed_sd(u: Float[np.ndarray, "3"], c: FrontEndConfig) -> Float[np.ndarray, "3"]:
    """Standard deviations [m, m, rad] allowed to an odometry increment `u`."""
    d, turn = float(np.hypot(u[0], u[1])), abs(float(u[2]))
    xy = c.sd_xy + c.sd_xy_per_m * d
    return np.array([xy, xy, c.sd_turn + c.sd_turn_per_m * d + c.sd_turn_per_rad * turn])


class ScanMatch(NamedTuple):
    """pose: (3,) in the front end's own frame; information: (3, 3) over robot-frame x, y, theta; counts of returns."""

    pose: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    innovation: Float[np.ndarray, "3"]
    matches: int
    beams: int


def better(match: ScanMatch, other: ScanMatch, sd: Float[np.ndarray, "3"], *, costs: bool) -> ScanMatch:
    """Of two matches of a scan the one that more returns bear out; less what being far `costs`, where it does.

    A view of what was not seen before matches nowhere, and anywhere a little better than where it is: that costs in
    narrow views, of which such are usual, and where wheels have proven good. sd: (3,) that odometry may err by.
    """

    def borne_out(m: ScanMatch) -> float:
        if not costs:
            return m.matches
        return m.matches - WIDE_LOSS * m.beams * math.log1p(float(np.sum((m.innovation / sd) ** 2)))

    return other if borne_out(other) > borne_out(match) else match


class _Keyframe(NamedTuple):
    """The returns of a scan in the local map's frame, and the spectrum of the directions in which their walls face."""

    points: Float[np.ndarray, "n 2"]
    normals: Float[np.ndarray, "n 2"]
    q: Float[np.ndarray, " n"]
    directions: Complex[np.ndarray, " f"]


class FrontEnd:
    """The local map. `insert` changes it: it belongs to one estimator state.

    ends: whether returns past the end of the walls that were seen are matched to none; costs: whether it costs a match
    to lie far from odometry, see `better`.
    """

    def __init__(self, cfg: FrontEndConfig, tangent: float | None = None) -> None:
        self.cfg, self.ends, self.costs = cfg, False, False
        self.tangent = cfg.tangent if tangent is None else tangent
        if cfg.size < 8 or cfg.size & (cfg.size - 1):
            raise ConfigError(f"front_end.size: expected a power of two from 8 on, found {cfg.size}")
        self.sums = [_untouched((cfg.size, cfg.size, 9)) for _ in range(2)]
        self.lines = [_untouched((cfg.size, cfg.size, 6)) for _ in range(2)]
        self.fine, self.coarse = self.lines
        self.keyframes: list[_Keyframe] = []
        self.last_keyframe: np.ndarray | None = None

    def match(self, b: Beams, predicted: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]) -> ScanMatch:
        """Where the scan fits, given where odometry says; the map is not touched."""
        n = len(b.q)
        pose, H, _ = self._refine(b, predicted, predicted, sd)
        matches = self._count(self.fine, FRONT_END_FINE, b, pose, FRONT_END_REACH)
        if n and matches < WIDE_UNDER * n:
            far = min(max(WIDE_SEARCH, WIDE_SD * float(sd[2])), np.pi)
            turns = np.arange(-far, far + 1e-9, WIDE_STEP)
            scores = [
                self._count(self.coarse, FRONT_END_COARSE, b, predicted + np.array([0, 0, a]), WIDE_REACH)
                for a in turns
            ]
            best = ScanMatch(pose, H, se2.between(predicted, pose), matches, n)
            for k in np.argsort(scores, kind="stable")[::-1][:WIDE_TRIES]:
                tried = self._refine(
                    b, predicted + np.array([0, 0, turns[k]]), predicted, np.maximum(sd, [0, 0, WIDE_TURN])
                )
                count = self._count(self.fine, FRONT_END_FINE, b, tried[0], FRONT_END_REACH)
                other = ScanMatch(tried[0], tried[1], se2.between(predicted, tried[0]), count, n)
                best = better(best, other, sd, costs=self.costs)
            return best
        return ScanMatch(pose, H, se2.between(predicted, pose), matches, n)

    def match_alone(
        self, b: Beams, last: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]
    ) -> ScanMatch:
        """Where the scan fits when nothing is known but the last pose and the last motion; the map is not touched.

        Turns are tried far to either side, as if the robot drove on and as if it stood, and those by which its walls
        face where the local map's do, all about; where `sd` says that the turn is known, about that alone. Of the best,
        which are refined, the one is taken that most returns match, less what its change of motion costs: more returns
        match where the walls are known already, so that a scan along a bare wall would rather have the robot stand.
        """
        n = len(b.q)
        on = np.asarray(se2.compose(last, step))
        known = bool(sd[2] < ALONE_TURN)
        last = np.array([*last[:2], on[2]]) if known else last
        far = min(3.0 * float(sd[2]) if known else ALONE_SEARCH, np.pi)
        turns = np.arange(-far, far + 1e-9, ALONE_STEP)
        at = np.array([[*place[:2], last[2] + a] for place in (on, last) for a in turns])
        if not known:
            at = np.concatenate([at, self._by_directions(b, last)])
        scores = np.array([self._count(self.coarse, FRONT_END_COARSE, b, pose, ALONE_REACH) for pose in at])
        starts = [on, last]
        for k in np.argsort(-scores, kind="stable").tolist():
            if len(starts) >= 2 + ALONE_TRIES:
                break
            away = at[k] - starts
            if (
                (np.hypot(away[:, 0], away[:, 1]) > ALONE_APART) | (abs(se2.wrap_angle(away[:, 2])) > ALONE_APART_TURN)
            ).all():
                starts.append(at[k])
        matches = []
        for start in starts:
            pose, H, _ = self._refine(b, start, start, sd)
            count = self._count(self.fine, FRONT_END_FINE, b, pose, FRONT_END_REACH)
            change = se2.between(on, pose)
            turned = min(abs(float(change[2])), abs(float(se2.wrap_angle(pose[2] - last[2]))))
            away = float(np.hypot(change[0], change[1])) / ALONE_STEADY
            cost = ALONE_LOSS * n * np.log1p(away**2 + (turned / ALONE_STEADY_TURN) ** 2)
            matches.append((count - cost, ScanMatch(pose, H, change, count, n)))
        return max(matches, key=lambda one: one[0])[1]

    def insert(self, b: Beams, pose: Float[np.ndarray, "3"]) -> bool:
        """True when `pose` was far enough from the last keyframe for its scan to become one."""
        c = self.cfg
        if self.last_keyframe is not None:
            d = se2.between(self.last_keyframe, pose)
            if np.hypot(d[0], d[1]) < KEYFRAME_DISTANCE and abs(d[2]) < c.keyframe_turn:
                return False
        self.last_keyframe = np.array(pose, float)
        self.keyframes.append(_keyframe([(b, pose)]))
        self._put(self.keyframes[-1], 1.0)
        if len(self.keyframes) > c.keyframes:
            self._put(self.keyframes.pop(0), -1.0)
        return True

    def near(self, b: Beams, pose: Float[np.ndarray, "3"], reach: float) -> int:
        """How many returns of a scan at `pose` lie within `reach` [m] of the lines they are matched to."""
        return self._count(self.fine, FRONT_END_FINE, b, pose, reach)

    def hold(self, scans: Sequence[tuple[Beams, Float[np.ndarray, "3"]]]) -> None:
        """The local map is made of these scans, each at its pose, and of nothing else."""
        for frame in self.keyframes:
            self._put(frame, -1.0)
        self.last_keyframe = None
        self.keyframes = [_keyframe(scans)] if scans else []
        for frame in self.keyframes:
            self._put(frame, 1.0)

    def information(self, b: Beams, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """What the lines alone tell of a scan at `pose`, over robot-frame x, y, theta: along a bare wall nothing.

        Neither odometry nor the error along the line, which `match` uses to hold a scan in its place, has a part.
        """
        c = self.cfg
        held = np.array([0.01, 0.01, 0.001])
        _, H, _ = align_scan(
            self.fine,
            FRONT_END_FINE,
            _points(b, c.alpha),
            MatchCost(c.alpha, FRONT_END_AGREE, self._whole(b), 0.0, FRONT_END_KAPPA, math.inf),
            pose,
            pose,
            held,
            1,
        )
        return np.asarray(H - np.diag(held**-2.0))

    def _whole(self, b: Beams) -> float:
        """What all returns of a scan together tell across one wall [1/m^2]: few are no more than they are."""
        return min(self.cfg.neff, len(b.q)) / FRONT_END_SIGMA**2

    def _by_directions(self, b: Beams, last: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k 3"]:
        """Poses about the last one at which the scan's walls face where those of the local map do."""
        seen = np.sum([frame.directions for frame in self.keyframes], axis=0)
        alike = np.fft.irfft(seen * np.conj(_directions(b.normal)), BINS)
        (peaks,), (count,) = heading_peaks(alike[None], ALONE_PEAKS, ALONE_PEAKS_APART, ALONE_PEAK_SHARE, 0.0)
        turns = peaks[:count][np.abs(se2.wrap_angle(peaks[:count] - last[2])) < ALONE_MOST]
        to = ALONE_SHIFT * np.arange(-ALONE_SHIFTS, ALONE_SHIFTS + 1)
        return np.array([[last[0] + x, last[1] + y, turn] for turn in turns for x in to for y in to]).reshape(-1, 3)

    def _put(self, frame: "_Keyframe", sign: float) -> None:
        for sums, lines, cell in zip(self.sums, self.lines, (FRONT_END_FINE, FRONT_END_COARSE), strict=True):
            add_points(sums, cell, frame.points, frame.normals, frame.q, sign)
            fit_lines(sums, lines, cell, frame.points)

    def _refine(
        self, b: Beams, start: np.ndarray, predicted: np.ndarray, sd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        c = self.cfg
        scan = _points(b, c.alpha)
        least = PAST if self.ends else math.inf
        past = PAST_SD * float(np.max(sd[:2]))
        fine = MatchCost(
            c.alpha,
            FRONT_END_AGREE,
            self._whole(b),
            self.tangent,
            FRONT_END_KAPPA,
            max(least * FRONT_END_FINE, past),
        )
        coarse = fine._replace(kappa=COARSE_KAPPA, past=max(least * FRONT_END_COARSE, past))
        pose, _, _ = align_scan(self.coarse, FRONT_END_COARSE, scan, coarse, start, predicted, sd, COARSE_ITERATIONS)
        pose, H, cost = align_scan(self.fine, FRONT_END_FINE, scan, fine, pose, predicted, sd, FINE_ITERATIONS)
        pose[2] = se2.wrap_angle(pose[2])
        return pose, H, cost

    def _count(self, grid: np.ndarray, cell: float, b: Beams, pose: np.ndarray, reach: float) -> int:
        return count_matches(grid, cell, b.s, b.normal, b.q, self.cfg.alpha, FRONT_END_AGREE, pose, reach)


def _points(b: Beams, alpha: float) -> ScanPoints:
    """The returns of a scan for matching. alpha: 0 where light tells nothing of where along a wall a return is."""
    apart = spacing(b.s) if alpha == 0.0 else np.zeros(len(b.s))
    return ScanPoints(b.s, b.normal, b.q, apart)


def _keyframe(scans: Sequence[tuple[Beams, Float[np.ndarray, "3"]]]) -> _Keyframe:
    parts = [(se2.act(pose, b.s), b.normal @ se2.rotation(float(pose[2])).T, b.q) for b, pose in scans]
    points, normals, q = (np.ascontiguousarray(np.concatenate(part)) for part in zip(*parts, strict=True))
    return _Keyframe(points, normals, q, _directions(normals))


def _directions(normals: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, " f"]:
    """The spectrum of how many of the normals show in each direction."""
    at = np.floor(np.arctan2(normals[:, 1], normals[:, 0]) / (2.0 * np.pi) * BINS).astype(int) % BINS
    return spectrum(np.bincount(at, minlength=BINS).astype(float))


def _untouched(shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Zeros as float32 that take memory where they are written, page by page.

    NumPy asks for huge pages, of which a few walls touch nearly all.
    """
    pages = mmap.mmap(-1, 4 * math.prod(shape))
    if hasattr(mmap, "MADV_NOHUGEPAGE"):  # Linux
        pages.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(pages, np.float32).reshape(shape)
