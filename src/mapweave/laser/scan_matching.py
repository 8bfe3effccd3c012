"""Scan to local map: how the robot moved since the last scan, far better than its wheels know.

The local map holds the last keyframes only, so it bends with the drift and never shows a wall twice.
"""

import math
import mmap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import config
from ..core.errors import ConfigError
from ..kernels.laser.local_map import MatchCost, ScanPoints, add_points, align_scan, count_matches, fit_lines
from .beam import Beams


@config
class FrontEndConfig:
    matcher: str = "lines"  # how scans are matched: lines, or what is plugged in as one of `mapweave.matchers`
    size: int = 1024  # cells a side of either level, a power of two; the fine one must hold the whole local map
    coarse: float = 0.2  # cell [m] of the first iterations
    fine: float = 0.1  # cell [m] of the last ones
    coarse_iterations: int = 8  # Gauss-Newton steps on the coarse level
    fine_iterations: int = 12  # and on the fine level
    coarse_kappa: float = 0.15  # [m] width of the robust kernel
    kappa: float = 0.1  # [m] the same on the fine level
    keyframes: int = 60  # scans the local map holds
    keyframe_distance: float = 0.4  # [m] driven and
    keyframe_turn: float = 0.4  # [rad]: a new keyframe beyond either
    alpha: float = 1.0  # [m^2 per q^2] what a difference in the feature counts
    agree: float = 0.5  # least cosine between a beam's normal and its cell's
    neff: float = 60.0  # a scan counts as so many independent returns
    sigma: float = 0.02  # [m] of each
    tangent: float = 0.1  # weight of the error along the line, with a feature and
    bare_tangent: float = 0.03  # without: a bare wall is alike all along
    sd_xy: float = 0.03  # [m] + sd_xy_per_m d: how far odometry may err in a step
    sd_xy_per_m: float = 0.3  # and so much more a metre driven
    sd_turn: float = 0.03  # [rad] + sd_turn_per_m d + sd_turn_per_rad |turn|
    sd_turn_per_m: float = 0.15  # [rad] and so much more a metre driven
    sd_turn_per_rad: float = 0.6  # and so much more a radian turned
    wide_search: float = 0.3  # [rad] rotations tried to either side when under wide_under of the returns match,
    wide_sd: float = 2.0  # and as far as so many standard deviations of the turn, where that is farther
    wide_step: float = 0.03  # [rad] between the rotations tried
    wide_reach: float = 0.1  # [m] a return this near its line counts there, on the coarse level
    wide_tries: int = 3  # of them, those that most returns match are refined,
    wide_turn: float = 0.15  # [rad] standard deviation of the turn there, at least
    wide_under: float = 0.65  # share of returns matched under which rotations are tried
    reach: float = 0.1  # [m] a return this near its line counts as matched
    least_beams: int = 10  # scans with fewer returns are not matched
    least_share: float = 0.25  # share of the returns that must match, or odometry is taken
    alone_xy: float = 0.25  # [m] a robot without odometry may move in a step, one sigma, and
    alone_turn: float = 0.35  # [rad] turn
    gyro_turn: float = 0.02  # [rad] by which the turn of a gyroscope may err in a step, one sigma,
    gyro_scale: float = 0.03  # and so much more a radian turned
    alone_search: float = 1.3  # [rad] turns tried to either side of such a robot's last heading
    alone_tries: int = 5  # of them, those that most returns match are refined,
    alone_apart: float = 2.5  # times `wide_step` apart from each other at least
    alone_loss: float = 0.04  # share of the returns that a change of its motion must win: so much times
    alone_steady: float = 0.1  # ln(1 + (change of the step / this [m])^2 + (change of the turn / the next)^2)
    alone_steady_turn: float = 0.15  # [rad] change of the turn that weighs as much
    still_xy: float = 0.1  # [m] a robot must leave its place, or
    still_turn: float = 0.1  # [rad] turn, while its wheels report no motion, before they are not believed


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


class FrontEnd:
    """The local map. `insert` changes it: it belongs to one estimator state."""

    def __init__(self, cfg: FrontEndConfig, tangent: float | None = None) -> None:
        self.cfg = cfg
        self.tangent = cfg.tangent if tangent is None else tangent
        if cfg.size < 8 or cfg.size & (cfg.size - 1):
            raise ConfigError(f"front_end.size: expected a power of two from 8 on, found {cfg.size}")
        if not cfg.agree > 0:
            raise ConfigError(f"front_end.agree: expected above 0, found {cfg.agree}")
        self.sums = [_untouched((cfg.size, cfg.size, 9)) for _ in range(2)]
        self.lines = [_untouched((cfg.size, cfg.size, 6)) for _ in range(2)]
        self.fine, self.coarse = self.lines
        self.keyframes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.last_keyframe: np.ndarray | None = None

    def match(self, b: Beams, predicted: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]) -> ScanMatch:
        """Where the scan fits, given where odometry says; the map is not touched."""
        c = self.cfg
        n = len(b.q)
        pose, H, _ = self._refine(b, predicted, predicted, sd)
        matches = self._count(self.fine, c.fine, b, pose, c.reach)
        if n and matches < c.wide_under * n:
            far = min(max(c.wide_search, c.wide_sd * float(sd[2])), np.pi)
            turns = np.arange(-far, far + 1e-9, c.wide_step)
            scores = [
                self._count(self.coarse, c.coarse, b, predicted + np.array([0, 0, a]), c.wide_reach) for a in turns
            ]
            for k in np.argsort(scores, kind="stable")[::-1][: c.wide_tries]:
                tried = self._refine(
                    b, predicted + np.array([0, 0, turns[k]]), predicted, np.maximum(sd, [0, 0, c.wide_turn])
                )
                count = self._count(self.fine, c.fine, b, tried[0], c.reach)
                if count > matches:
                    (pose, H, _), matches = tried, count
        return ScanMatch(pose, H, se2.between(predicted, pose), matches, n)

    def match_alone(
        self, b: Beams, last: Float[np.ndarray, "3"], step: Float[np.ndarray, "3"], sd: Float[np.ndarray, "3"]
    ) -> ScanMatch:
        """Where the scan fits when nothing is known but the last pose and the last motion; the map is not touched.

        Turns are tried far to either side, as if the robot drove on and as if it stood; where `sd` says that the turn
        is known, about that alone. Of the best that are refined
        the one is taken that most returns match, less what its change of motion costs: more returns match where the
        walls are known already, so that a scan along a bare wall would rather have the robot stand.
        """
        c = self.cfg
        n = len(b.q)
        on = np.asarray(se2.compose(last, step))
        known = bool(sd[2] < c.alone_turn)
        last = np.array([*last[:2], on[2]]) if known else last
        far = min(3.0 * float(sd[2]) if known else c.alone_search, np.pi)
        turns = np.arange(-far, far + 1e-9, c.wide_step)
        at = np.array([[*place[:2], last[2] + a] for place in (on, last) for a in turns])
        scores = np.array([self._count(self.coarse, c.coarse, b, pose, c.reach) for pose in at])
        starts = [on, last]
        for k in np.argsort(-scores, kind="stable").tolist():
            if len(starts) >= 2 + c.alone_tries:
                break
            if all(abs(se2.wrap_angle(at[k, 2] - s[2])) > c.alone_apart * c.wide_step for s in starts):
                starts.append(at[k])
        matches = []
        for start in starts:
            pose, H, _ = self._refine(b, start, start, sd)
            count = self._count(self.fine, c.fine, b, pose, c.reach)
            change = se2.between(on, pose)
            turned = min(abs(float(change[2])), abs(float(se2.wrap_angle(pose[2] - last[2]))))
            away = float(np.hypot(change[0], change[1])) / c.alone_steady
            cost = c.alone_loss * n * np.log1p(away**2 + (turned / c.alone_steady_turn) ** 2)
            matches.append((count - cost, ScanMatch(pose, H, change, count, n)))
        return max(matches, key=lambda one: one[0])[1]

    def insert(self, b: Beams, pose: Float[np.ndarray, "3"]) -> bool:
        """True when `pose` was far enough from the last keyframe for its scan to become one."""
        c = self.cfg
        if self.last_keyframe is not None:
            d = se2.between(self.last_keyframe, pose)
            if np.hypot(d[0], d[1]) < c.keyframe_distance and abs(d[2]) < c.keyframe_turn:
                return False
        self.last_keyframe = np.array(pose, float)
        frame = (se2.act(pose, b.s), b.normal @ se2.rotation(float(pose[2])).T, b.q)
        self._put(frame, 1.0)
        self.keyframes.append(frame)
        if len(self.keyframes) > c.keyframes:
            self._put(self.keyframes.pop(0), -1.0)
        return True

    def hold(self, scans: Sequence[tuple[Beams, Float[np.ndarray, "3"]]]) -> None:
        """The local map is made of these scans, each at its pose, and of nothing else."""
        for frame in self.keyframes:
            self._put(frame, -1.0)
        self.last_keyframe = None
        parts = [(se2.act(pose, b.s), b.normal @ se2.rotation(float(pose[2])).T, b.q) for b, pose in scans]
        self.keyframes = []
        if parts:
            points, normals, q = (np.concatenate(part) for part in zip(*parts, strict=True))
            self.keyframes = [(points, normals, q)]
            self._put(self.keyframes[0], 1.0)

    def information(self, b: Beams, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
        """What the lines alone tell of a scan at `pose`, over robot-frame x, y, theta: along a bare wall nothing.

        Neither odometry nor the error along the line, which `match` uses to hold a scan in its place, has a part.
        """
        c = self.cfg
        held = np.array([0.01, 0.01, 0.001])
        _, H, _ = align_scan(
            self.fine,
            c.fine,
            ScanPoints(b.s, b.normal, b.q),
            MatchCost(c.alpha, c.agree, c.neff / c.sigma**2, 0.0, c.kappa),
            pose,
            pose,
            held,
            1,
        )
        return np.asarray(H - np.diag(held**-2.0))

    def _put(self, frame: tuple[np.ndarray, np.ndarray, np.ndarray], sign: float) -> None:
        points, normals, q = (np.ascontiguousarray(a) for a in frame)
        for sums, lines, cell in zip(self.sums, self.lines, (self.cfg.fine, self.cfg.coarse), strict=True):
            add_points(sums, cell, points, normals, q, sign)
            fit_lines(sums, lines, cell, points)

    def _refine(
        self, b: Beams, start: np.ndarray, predicted: np.ndarray, sd: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        c = self.cfg
        scan = ScanPoints(b.s, b.normal, b.q)
        fine = MatchCost(c.alpha, c.agree, c.neff / c.sigma**2, self.tangent, c.kappa)
        coarse = fine._replace(kappa=c.coarse_kappa)
        pose, _, _ = align_scan(self.coarse, c.coarse, scan, coarse, start, predicted, sd, c.coarse_iterations)
        pose, H, cost = align_scan(self.fine, c.fine, scan, fine, pose, predicted, sd, c.fine_iterations)
        pose[2] = se2.wrap_angle(pose[2])
        return pose, H, cost

    def _count(self, grid: np.ndarray, cell: float, b: Beams, pose: np.ndarray, reach: float) -> int:
        return count_matches(grid, cell, b.s, b.normal, b.q, self.cfg.alpha, self.cfg.agree, pose, reach)


def _untouched(shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Zeros as float32 that take memory where they are written, page by page.

    NumPy asks for huge pages, of which a few walls touch nearly all.
    """
    pages = mmap.mmap(-1, 4 * math.prod(shape))
    if hasattr(mmap, "MADV_NOHUGEPAGE"):  # Linux
        pages.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(pages, np.float32).reshape(shape)
