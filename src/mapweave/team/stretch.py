"""A few seconds of a team's problem: the very factors of the whole, over what was driven and seen in between."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..core.landmark_log import LandmarkLog
from ..core.records import Odometry, Track
from ..landmarks.landmark_map import LandmarkMap
from ..solve import Pattern, Problem
from ..solve.chain import SchurComplement
from .config import SmoothingConfig
from .problem import seen_when, team_problem
from .robot_part import RobotPart, instants_between

BEFORE = 3.0  # [s] of commands before a stretch: those in force when it begins, however late they act
ANCHOR = 1e10  # information on the pose that is the frame
TINY = 1e-6  # information on everything, so that what nothing tells stays where it is


@dataclass(frozen=True, slots=True)
class Stretch:
    """Parts of the team's robots between two times, where their poses are, and the factors over them.

    entry, exit: robots that come in from the stretch before, and that go on into the next; anchor: the robot whose
    first pose is the map's frame, where that lies in it. What is known of calibrations beforehand counts once for all
    stretches, and is left out.
    """

    begin: float
    end: float
    parts: tuple[RobotPart, ...]
    landmarks: tuple[str, ...]
    landmark_start: int
    entry: tuple[str, ...]
    exit: tuple[str, ...]
    problem: Problem
    pattern: Pattern
    anchor: str | None

    def columns(self, robot: str, which: int) -> Int[np.ndarray, "3"]:
        """Where the robot's pose at its first (0) or last (-1) instant stands."""
        part = self.part(robot)
        k = which % len(part.instants.t)
        return np.asarray(part.start + 3 * k + np.arange(3))

    def part(self, robot: str) -> RobotPart:
        return next(p for p in self.parts if p.robot == robot)

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(p.robot for p in self.parts)

    @property
    def shared(self) -> Int[np.ndarray, " e"]:
        """Ends that come in, ends that go on, landmarks and calibrations."""
        hubs = np.arange(self.landmark_start, len(self.problem.x0))
        ends = [self.columns(r, 0) for r in self.entry] + [self.columns(r, -1) for r in self.exit]
        return np.concatenate([*ends, hubs]).astype(int)

    def poses(self, robot: str, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k 3"]:
        part = self.part(robot)
        return np.asarray(x[part.start : part.start + 3 * len(part.instants.t)].reshape(-1, 3))

    def linearised(self, x: Float[np.ndarray, " n"]) -> SchurComplement:
        """What it says of all that it shares, at x."""
        parts = [term.normal(x) for term in self.problem.terms]
        H, g = self.pattern.assemble([p[0] for p in parts], [p[1] for p in parts])
        H.data[self.pattern.diagonal] += TINY
        if self.anchor is not None:
            H.data[self.pattern.diagonal[self.columns(self.anchor, 0)]] += ANCHOR
        return SchurComplement.of(H, g, x, self.shared)

    def cost(self, x: Float[np.ndarray, " n"]) -> float:
        return self.problem.cost(x)


def stretch_of(
    logs: Sequence[LandmarkLog],
    ways: Mapping[str, Track],
    span: tuple[float, float],
    landmarks: LandmarkMap,
    labels: Mapping[str, Mapping[str, str]],
    entry: Sequence[str],
    exit_: Sequence[str],
    cfg: SmoothingConfig,
    calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    anchor: str | None,
) -> Stretch:
    """The stretch over `span` [s] of the robots of `logs`, each with its trajectory there in the map's frame.

    entry, exit_: robots that were there before `span`, and that will be after it.
    """
    begin, end = span
    cut = [_cut(log, begin, end) for log in logs]
    names = [log.robot for log in logs]
    seen_at = seen_when(cut, names) if cfg.robot_sightings else {name: np.zeros(0) for name in names}
    instants = {}
    for log, mine in zip(logs, cut, strict=True):
        first, last = log.span
        stamps = np.concatenate([mine.sightings.t, mine.bearings.t, seen_at[log.robot]])
        instants[log.robot] = instants_between(max(first, begin), min(last, end), stamps, ways[log.robot], cfg)
    whole = team_problem(cut, landmarks, ways, labels, calibration, cfg, instants=instants)
    terms = [t for t, origin in zip(whole.factors, whole.origins, strict=True) if origin is not None]
    problem = Problem(whole.problem.x0, terms)
    return Stretch(
        begin, end, whole.parts, whole.landmarks, whole.landmark_start, tuple(entry), tuple(exit_), problem,
        Pattern.of(problem), anchor,
    )  # fmt: skip


def _cut(log: LandmarkLog, begin: float, end: float) -> LandmarkLog:
    """The rows after `begin` up to `end` [s], the log's very first too, with the commands that may still act then."""
    odometry = log.odometry
    if odometry is not None:
        a = max(int(np.searchsorted(odometry.t, begin - BEFORE, side="right")) - 1, 0)
        a = min(a, len(odometry.t) - 1)
        b = max(int(np.searchsorted(odometry.t, end, side="right")), a + 1)
        odometry = Odometry(odometry.t[a:b], odometry.v[a:b], odometry.w[a:b])
    first = log.span[0]
    seen, bearings = (
        table.select(((table.t > begin) | (table.t == first)) & (table.t <= end))
        for table in (log.sightings, log.bearings)
    )
    return replace(log, odometry=odometry, sightings=seen, bearings=bearings)
