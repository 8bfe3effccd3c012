"""How the robot moved between two scans: odometry, a match against the local map, and a gate between them.

What one scan did to the estimate is a `ScanInfo`; poses between corrections are filled in by blending.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.laser_log import LEAST_RETURNS
from ..core.plugins import Matcher, plugged_in
from ..core.records import Scan
from ..core.rows import RowBuffer
from .beam import STEERING, Beams
from .scan_matching import (
    ALONE_TURN,
    BARE_TANGENT,
    FRONT_END_SIGMA,
    GYRO_SCALE,
    LEAST_SHARE,
    STILL_TURN,
    STILL_XY,
    WIDE_UNDER,
    FrontEnd,
    FrontEndConfig,
    ScanMatch,
    allowed_sd,
    better,
)
from .wheel_worth import WheelWorth

FRONT_END_LEAST_BEAMS = LEAST_RETURNS  # scans with fewer returns are not matched

ALONE_SD = np.array([0.25, 0.25, ALONE_TURN])  # [m, m, rad] of a step of a robot without odometry
ALONE_TURNING = 2.0  # [rad/s] that it may turn by, one sigma, however near its scans follow each other
APART_LEARNED = 0.1  # [-] what one step counts in how far apart scans usually are
GYRO_TURN = 0.02  # [rad] by which the turn of a gyroscope may err in a step, one sigma


@dataclass(frozen=True, slots=True)
class ScanInfo:
    """One row of the per-scan record; see `ScanRecords` for the words."""

    innovation: Float[np.ndarray, "3"]
    beams: int
    matches: int
    decision: str
    n_eff: float = np.nan
    resampled: bool = False
    information: Float[np.ndarray, "3 3"] | None = None


class PoseEstimate(NamedTuple):
    """Where a robot is: pose (3,) [m, m, rad] in the frame of the first scan; cov (3, 3) over x, y, theta."""

    pose: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]


def blended(
    trajectory: Float[np.ndarray, "n 3"],
    at: Int[np.ndarray, " k"],
    corrected: Float[np.ndarray, "k 3"],
    cut: Bool[np.ndarray, " k"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Poses along `trajectory` (one that drifts, in order) that pass through `corrected` at its rows `at`.

    Between two corrected rows the pose is carried from both and blended by the share of the distance; before the first
    and after the last it is carried from the one there is. at: ascending, k >= 1. cut: the corrected rows whose step
    from the row before is not sure: up to there poses are carried from the corrected row before alone.
    """
    n = len(trajectory)
    step = se2.between(trajectory[:-1], trajectory[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]) + 0.5 * np.abs(step[:, 2]) + 1e-6)])
    before = np.searchsorted(at, np.arange(n), side="right") - 1
    first, second = np.maximum(before, 0), np.minimum(before + 1, len(at) - 1)
    i, j = at[first], at[second]
    a = se2.compose(corrected[first], se2.between(trajectory[i], trajectory))
    b = se2.compose(corrected[second], se2.between(trajectory[j], trajectory))
    share = np.where(j > i, (way - way[i]) / np.maximum(way[j] - way[i], 1e-12), 0.0)
    if cut is not None:
        share = np.where(cut[second], 0.0, share)
    d = b - a
    d[:, 2] = se2.wrap_angle(d[:, 2])
    out = a + np.clip(share, 0.0, 1.0)[:, None] * d
    out[:, 2] = se2.wrap_angle(out[:, 2])
    return np.asarray(out)


def up_to(at: Int[np.ndarray, " k"], these: Bool[np.ndarray, " k"], n: int) -> Bool[np.ndarray, " n"]:
    """Which of `n` rows are one of `these` of the rows `at`, ascending, or lie between it and the one before it."""
    return np.append(these, False)[np.searchsorted(at, np.arange(n))]


SEEN_LEAST = 0.5  # of a scan's returns lie where the robot looked before, or nothing of it need match,
BEAMS_LEAST = 0.1  # nor where fewer of its beams come back:
ELSEWHERE = 3.0  # sd from where odometry puts it that a match is believed then
NARROW = 2.2  # [rad] of a sector that is no narrow view;
VIEW_TURNED = 0.2  # of a narrow one a scan may be turned from the last in the local map, and not be put there
STILL = 1e-6  # [m] and [rad] that wheels which report no motion differ by
NO_INNOVATION = np.zeros(3)


class FieldOfView(NamedTuple):
    """Where a scan's beams go, whether they come back or not.

    beams: how many; sensor: (3,) its pose on the robot; first, wide: [rad] of its sector; far: [m] it reaches.
    """

    beams: int
    sensor: Float[np.ndarray, "3"]
    first: float
    wide: float
    far: float

    def share_of(self, points: Float[np.ndarray, "n 2"]) -> float:
        """The share of points [m] on the robot that lie in it."""
        seen = se2.act(se2.inverse(self.sensor), points)
        ahead = (np.arctan2(seen[:, 1], seen[:, 0]) - self.first) % (2.0 * np.pi)
        return float(np.mean((ahead <= self.wide) & (np.hypot(seen[:, 0], seen[:, 1]) <= self.far)))


def field_of_view(scan: Scan) -> FieldOfView:
    wide = scan.angle_increment * (len(scan.ranges) - 1)
    return FieldOfView(
        len(scan.ranges), scan.T_robot_sensor, scan.angle_min + min(wide, 0.0), abs(wide), float(scan.range_max)
    )


class Increment(NamedTuple):
    """u: (3,) odometry since the last scan; sd: (3,) it may err by.

    alone: there is no odometry, or it reports no motion of a robot that moves: u is how the robot moved last, with the
    turn that a gyroscope tells where there is one.
    """

    u: Float[np.ndarray, "3"]
    sd: Float[np.ndarray, "3"]
    alone: bool = False


def inside(innovation: Float[np.ndarray, "3"], eps: Float[np.ndarray, "3"]) -> bool:
    """Whether a match lies where odometry allows: the motion model is 1 inside eps and 0 outside # [Hara07] eq. 5."""
    allowed: Bool[np.ndarray, 3] = np.abs(innovation) <= eps
    return bool(allowed.all())


Gate = Callable[[Float[np.ndarray, "3"]], Float[np.ndarray, "3"]] | None


class ScanOdometry:
    """A trajectory through all scans that drifts but never jumps. It belongs to one state, which `advance` changes.

    poses: one a scan, the first zero; step: (3,) the latest motion; told: (3,) what odometry says of it, None where it
    says nothing; lines: (3, 3) information of the walls alone on the latest pose, over robot-frame x, y, theta (zero
    where no match was taken; asked for by `tell_lines`).
    gate: what deviations from odometry [m, m, rad] it allows for the sd of an increment; a match outside is refused
    and odometry taken. None: only a match of too few returns is refused. matching: False is odometry alone. worth:
    what is learned of the wheels, needs `tell_lines`; None: they are as any.
    """

    def __init__(
        self,
        cfg: FrontEndConfig,
        *,
        feature: str = "none",
        gate: Gate = None,
        matching: bool = True,
        tell_lines: bool = False,
        worth: WheelWorth | None = None,
    ) -> None:
        steers = feature in STEERING
        self.cfg = cfg if steers else replace(cfg, alpha=0.0)
        self.gate, self.matching, self.tell_lines, self.worth = gate, matching, tell_lines, worth
        self.narrow = False  # views: see `FieldOfView`
        self.tangent = cfg.tangent if steers else BARE_TANGENT
        self._matcher: Callable[[FrontEndConfig, float], Matcher] = plugged_in(
            "matchers", self.cfg.matcher, "front_end.matcher"
        )
        self.front_end = self._local_map()
        self._anew: Matcher | None = None  # of the latest scan alone, where it does not match the local map
        self.poses = RowBuffer(3)
        self.odometry: np.ndarray | None = None
        self.step = np.zeros(3)
        self.told: np.ndarray | None = None
        self.heading: float | None = None
        self._t: float | None = None  # of the latest scan [s]
        self._usual = 0.0  # time from scan to scan [s]
        self._view = FieldOfView(0, np.zeros(3), 0.0, 0.0, 0.0)  # of the latest scan
        self._looked = (np.zeros(3), self._view)  # from where, and at what, with the latest in the local map
        self._stood: np.ndarray | None = None  # where it was when the wheels moved last, while they report nothing
        self.lines = np.zeros((3, 3))

    def _local_map(self) -> Matcher:
        """An empty one. Where wheels have shown what they are worth, walls do not go on past their ends."""
        made = self._matcher(self.cfg, self.tangent)
        if isinstance(made, FrontEnd):
            made.ends = self.worth is not None
        return made

    @property
    def pose(self) -> Float[np.ndarray, "3"]:
        """The latest pose; zero before the first scan."""
        return np.asarray(self.poses[-1]) if len(self.poses) else np.zeros(3)

    def increment(
        self, odometry: Float[np.ndarray, "3"] | None, heading: float | None = None, apart: float = np.inf
    ) -> Increment:
        """What odometry says of the motion since the last scan; wheels that stand while the robot drives say none.

        apart: time since the last scan [s]: without odometry the robot turned no further than robots can in it.
        """
        if odometry is None or (self._wheels_stand(odometry) and self._left_its_place()):
            if heading is None or self.heading is None:
                turns = max(min(ALONE_TURN, ALONE_TURNING * apart), GYRO_TURN)
                return Increment(self.step, np.array([*ALONE_SD[:2], turns]), alone=True)
            turn = heading - self.heading
            way = se2.rotation(0.5 * (turn - float(self.step[2]))) @ self.step[:2]
            return Increment(
                np.array([*way, turn]),
                np.array([*ALONE_SD[:2], GYRO_TURN + GYRO_SCALE * abs(turn)]),
                alone=True,
            )
        u = np.zeros(3) if self.odometry is None else se2.between(self.odometry, odometry)
        sd = allowed_sd(u, self.cfg)
        return Increment(u, sd if self.worth is None else sd * self.worth.step)

    def _wheels_stand(self, odometry: Float[np.ndarray, "3"] | None) -> bool:
        """Whether wheels report no motion at all since the last scan."""
        if odometry is None or self.odometry is None:
            return False
        return bool((np.abs(odometry - self.odometry) <= STILL).all())

    def _left_its_place(self) -> bool:
        """Whether the robot is elsewhere than where its wheels moved last."""
        if self._stood is None:
            return False
        away = se2.between(self._stood, self.pose)
        return bool(np.hypot(away[0], away[1]) > STILL_XY or abs(away[2]) > STILL_TURN)

    def _apart(self, t: float | None) -> float:
        """How long a scan at `t` may be after the last [s]: bursts of a log that was buffered are no faster scanner."""
        if t is None or self._t is None:
            self._t = t
            return np.inf
        since, self._t = max(t - self._t, 0.0), t
        self._usual = since if self._usual == 0.0 else self._usual + APART_LEARNED * (since - self._usual)
        return max(since, self._usual)

    def advance(self, scan: Scan, b: Beams, *, leapt: bool = False, t: float | None = None) -> ScanInfo:
        """`poses` has one more: where the robot was at the scan.

        leapt: its odometry was set anew, tells nothing. t: when the scan was taken [s]; None: nobody knows.
        """
        u, sd, alone = self.increment(None if leapt else scan.odometry, scan.heading, self._apart(t))
        self.told = None if alone else u
        self.heading = scan.heading
        if not self._wheels_stand(scan.odometry):
            self._stood = None
        elif self._stood is None:
            self._stood = self.pose
        self.odometry = None if scan.odometry is None else np.array(scan.odometry, float)
        self.lines = np.zeros((3, 3))
        self._view, n = field_of_view(scan), len(b.q)
        if not len(self.poses):
            if self._view.wide < NARROW:
                self._look_narrowly()
            return self._accept(b, np.zeros(3), ScanInfo(NO_INNOVATION, n, 0, "first", information=np.zeros((3, 3))))
        predicted = se2.compose(self.poses[-1], u)
        if n < FRONT_END_LEAST_BEAMS or not self.matching:
            decision = "odometry" if n >= FRONT_END_LEAST_BEAMS else "empty"
            info = ScanInfo(NO_INNOVATION, n, 0, decision, information=np.diag(sd**-2.0))
            return self._accept(b, predicted, info)
        gate = None if alone or scan.odometry is None else self.gate
        match, decision = self._placed(b, predicted, Increment(u, sd, alone), gate)
        accepted = decision == "matched"
        if accepted and self.tell_lines:
            self.lines = self.front_end.information(b, match.pose)
        match = self._learn(match, u, predicted, alone=alone or decision == "unseen")
        information = match.information if accepted else np.diag(sd**-2.0)
        info = ScanInfo(match.innovation, match.beams, match.matches, decision, information=information)
        return self._accept(b, match.pose if accepted else predicted, info)

    def _placed(
        self, b: Beams, predicted: Float[np.ndarray, "3"], told: Increment, gate: Gate
    ) -> tuple[ScanMatch, str]:
        """The match of a scan, and whether it is "matched", or "odometry" or the view was "unseen"."""
        u, sd, alone = told
        for fe in (self.front_end, self._anew):
            if fe is None:
                break
            match = fe.match_alone(b, self.pose, u, sd) if alone else self._match(fe, b, predicted, u, sd)
            accepted = match.matches >= LEAST_SHARE * match.beams
            if accepted:
                self.front_end = fe
                break
        self._anew = None if accepted or self.gate is not None else self._local_map()
        elsewhere = self.narrow and not alone and self._looks_elsewhere(b, predicted)
        if gate is not None:
            accepted = accepted and inside(match.innovation, gate(sd))
        if elsewhere:
            accepted = accepted and inside(match.innovation, ELSEWHERE * sd)
        return match, "matched" if accepted else "unseen" if elsewhere else "odometry"

    def _look_narrowly(self) -> None:
        """Before the first scan is taken: those of this robot see little of what the last ones saw."""
        self.narrow = True
        self.cfg = replace(self.cfg, keyframe_turn=min(self.cfg.keyframe_turn, VIEW_TURNED * self._view.wide))
        self.front_end = self._local_map()
        if self.worth is not None:
            self.worth.narrow = True

    def _looks_elsewhere(self, b: Beams, predicted: Float[np.ndarray, "3"]) -> bool:
        """Whether odometry turned the view away from what the local map shows, so that nothing need match."""
        pose, view = self._looked
        few = len(b.s) < BEAMS_LEAST * self._view.beams
        return few or view.share_of(se2.act(se2.between(pose, predicted), b.s)) < SEEN_LEAST

    def _match(self, fe: Matcher, b: Beams, predicted: np.ndarray, u: np.ndarray, sd: np.ndarray) -> ScanMatch:
        """A scan against the local map from where wheels put it; where few match, good ones may have slipped."""
        costs = self.narrow or (self.worth is not None and self.worth.proven)
        if isinstance(fe, FrontEnd):
            fe.costs = costs
        match: ScanMatch = fe.match(b, predicted, sd)
        if self.worth is None or match.matches >= WIDE_UNDER * match.beams:
            return match
        of_any: ScanMatch = fe.match(b, predicted, allowed_sd(u, self.cfg))
        return better(match, of_any, sd, costs=costs)

    def _learn(
        self, match: ScanMatch, u: Float[np.ndarray, "3"], predicted: Float[np.ndarray, "3"], *, alone: bool
    ) -> ScanMatch:
        """What the wheels are worth is learned from a step that scans and wheels tell together; what the match is then.

        It lies nearer to where wheels put it where few returns match and the wheels have proven good.
        """
        if self.worth is None:
            return match
        sd = allowed_sd(u, self.cfg)
        if alone or match.matches < WIDE_UNDER * match.beams:
            self.worth.interrupted()
        else:
            self.worth.see(u, match.innovation, sd, self.lines, self.cfg.neff / FRONT_END_SIGMA**2)
        if alone or match.matches < LEAST_SHARE * match.beams:
            return match
        off = self.worth.few(match.matches / match.beams, u, match.innovation, sd)
        same = off is match.innovation
        return match if same else match._replace(pose=np.asarray(se2.compose(predicted, off)), innovation=off)

    def _accept(self, b: Beams, pose: np.ndarray, info: ScanInfo) -> ScanInfo:
        if len(self.poses):
            self.step = se2.between(self.poses[-1], pose)
        self.poses.append(pose)
        if self.matching and len(b.q) >= FRONT_END_LEAST_BEAMS:
            if self.front_end.insert(b, pose):
                self._looked = (np.array(pose, float), self._view)
            if self._anew is not None:
                self._anew.insert(b, pose)
        return info
