"""A team smoothed while its logs play: what is new is linearised, what has moved is linearised anew, the rest is kept.

Time is cut into stretches. The poses inside one are eliminated onto its ends, landmarks and calibrations, which are
all that stretches share (`solve.chain`). Nothing is ever thrown away: an older stretch keeps what it says, taken at
the estimate of its time, until that has moved by more than `OnlineConfig.move`; then it is taken anew. The minimum is
that of the whole problem, and a step costs the latest stretches and what moved, not the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.findings import Finding
from ..core.gaussian import symmetrise
from ..core.landmark_log import LandmarkLog
from ..core.names import in_order, robot_key
from ..core.records import Odometry, Track
from ..fusion.cluster import ENOUGH
from ..landmarks.landmark_map import LandmarkMap
from ..laser.scan_odometry import blended
from ..solve import Pattern, Problem
from ..solve.chain import Gauss, Passed, SchurComplement, passed, solve
from .config import (
    ONLINE_ITERATIONS,
    ONLINE_MOVE,
    ONLINE_RENEWED,
    ONLINE_SETTLE,
    ONLINE_STILL,
    ONLINE_STRETCH,
    ONLINE_WINDOW,
    OnlineConfig,
    SmoothingConfig,
)
from .problem import prior_of, seen_when, team_problem
from .robot_part import PARAMETERS, RobotPart, instants_between

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


HELD = 1e-6  # standard deviation of a calibration parameter that is held
LOOSE = 1e-6  # information [1/m^2] on a landmark, so that one nobody has seen again stays where it is
FRAME = 1e8  # information [1/m^2] on the landmarks as a body, which are the frame
MARGIN = 3.0  # [s] of a robot's own trajectory before a stretch
Labels = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class OnlineStep:
    """What one step did. linearised: stretches taken anew; renewed: older ones of these; change: the last one."""

    iterations: int
    linearised: int
    renewed: int
    change: float


class OnlineTeam:
    """The smoothed map of the robots tied in so far, in a frame of its landmarks'. `adopt` and `advance` change it.

    logs: those of robots with wheels; own: each robot's poses as its filter had them at their time, in its own frame.
    """

    def __init__(
        self,
        logs: Sequence[LandmarkLog],
        own: Mapping[str, Track],
        smoothing: SmoothingConfig,
        online: OnlineConfig,
        calibration: Mapping[str, Mapping[str, tuple[float, float]]],
    ) -> None:
        self.logs = {log.robot: log for log in logs}
        self.own, self.smoothing, self.online, self.calibration = own, smoothing, online, calibration
        self.begin = min(log.span[0] for log in logs)
        self.members: tuple[str, ...] = ()
        self.labels: Labels = {}
        self.names: tuple[str, ...] = ()
        self.h = np.zeros(0)
        self.stretches: list[Stretch] = []
        self.x: list[np.ndarray] = []
        self._links: list[SchurComplement | None] = []
        self._entries: list[Gauss] = []
        self._passed: list[Passed] = []

    @property
    def landmarks(self) -> LandmarkMap:
        """Where the landmarks are; their covariance is the model's, conditioned on nothing."""
        n = 2 * len(self.names)
        if not self.stretches:
            return LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))
        end = self._entries[-1]
        first = 3 * len(self.stretches[-1].exit)
        cov = symmetrise(solve(end.Lambda, np.eye(len(end.eta)))[first : first + n, first : first + n])
        return LandmarkMap(self.names, self.h[:n].reshape(-1, 2), cov)

    def calibration_of(self, robot: str) -> dict[str, float]:
        """The robot's calibration as it is estimated now."""
        k = 2 * len(self.names) + len(PARAMETERS) * self.members.index(robot)
        return dict(zip(PARAMETERS, self.h[k : k + len(PARAMETERS)].tolist(), strict=True))

    def adopt(
        self, t: float, robots: Sequence[str], landmarks: LandmarkMap, ways: Mapping[str, Track], labels: Labels
    ) -> bool:
        """Whether anything is new of who is connected; then all stretches until `t` [s] are laid out anew.

        robots: tied together, the map's frame the first pose of the first; landmarks, ways: where the filters have
        them, to start what is not estimated yet.
        """
        robots = tuple(sorted((r for r in robots if r in self.logs), key=in_order))
        labels = {r: dict(labels.get(r, {})) for r in robots}
        names = (*(n for n in self.names if n in landmarks.ids), *(n for n in landmarks.ids if n not in self.names))
        if not robots or (robots, names, labels) == (self.members, self.names, self.labels):
            return False
        known = self.members[:1] == robots[:1]
        self.update_poses()
        place = dict(zip(landmarks.ids, landmarks.mean, strict=True))
        both = [n for n in self.names if n in place]
        if known and len(both) >= ENOUGH:  # the filters' frame has moved against this one
            here = dict(zip(self.names, self.h[: 2 * len(self.names)].reshape(-1, 2), strict=True))
            T = se2.align(np.array([place[n] for n in both]), np.array([here[n] for n in both]))
            place = {n: se2.act(T, p) for n, p in place.items()}
            ways = {r: Track(way.t, se2.compose(T, way.pose)) for r, way in ways.items()}
        if known:
            place |= dict(zip(self.names, self.h[: 2 * len(self.names)].reshape(-1, 2), strict=True))
        calibrations = {r: list(self.calibration_of(r).values()) for r in self.members} if known else {}
        estimated = {r: self.way(r) for r in self.members} if known else {}
        means = [
            calibrations.get(r, prior_of(self.calibration.get(r, {}), self.smoothing.calibration, wheels=True)[0])
            for r in robots
        ]
        self.members, self.names, self.labels = robots, names, labels
        self.h = np.concatenate([*(place[n] for n in names), *means])
        self.stretches, self.x, self._links, self._entries, self._passed = [], [], [], [], []
        k = 0
        while k == 0 or self._start(k) < t:
            self._lay_out(k, min(t, self._start(k + 1)), t, {r: estimated.get(r, ways[r]) for r in robots})
            k += 1
        self._entries = [self._prior()]
        self._solve(ONLINE_SETTLE, everything=True)
        return True

    def advance(self, t: float) -> OnlineStep:
        """The map with all rows until `t` [s]."""
        k = len(self.stretches) - 1
        if k < 0:
            return OnlineStep(0, 0, 0, 0.0)
        whole = False
        while t > self._start(k):
            end = min(t, self._start(k + 1))
            whole |= k == len(self.stretches)
            self._lay_out(k, end, t, {})
            k += 1
        if whole:  # a stretch has ended: the older ones are looked at
            self.update_poses()
        return self._solve(ONLINE_ITERATIONS, everything=False, older=whole)

    def forget(self) -> None:
        """Nothing is estimated any more, until robots are adopted again."""
        self.members, self.names, self.labels, self.h = (), (), {}, np.zeros(0)
        self.stretches, self.x, self._links, self._entries, self._passed = [], [], [], [], []

    def update_poses(self) -> None:
        """Every stretch where the map as it is now puts it."""
        if self.stretches:
            self._back(0)

    def converge(self) -> OnlineStep:
        """Everything linearised where it is now, until nothing moves."""
        return self._solve(ONLINE_SETTLE, everything=True)

    def way(self, robot: str) -> Track:
        """The robot's poses so far at all of its stamps, as of the last `update_poses`."""
        at, poses = self._estimates(robot, self.stretches, self.x)
        return self._carried(robot, at, poses, at[0], at[-1])

    def _start(self, k: int) -> float:
        return self.begin + k * ONLINE_STRETCH

    def _there(self, k: int) -> list[str]:
        """The robots whose logs reach into stretch k."""
        spans = {r: self.logs[r].span for r in self.members}
        return [r for r in self.members if spans[r][0] < self._start(k + 1) and spans[r][1] > self._start(k)]

    def _lay_out(self, k: int, end: float, now: float, ways: Mapping[str, Track]) -> None:
        """Stretch k until `end` [s]; `now`: the time until which rows are known.

        ways: initial trajectories of its robots; without one a robot goes on from where it is estimated.
        """
        there = [r for r in self._there(k) if self.logs[r].span[0] < end]
        before = set(self._there(k - 1)) if k else set()
        after = set(self._there(k + 1)) if end >= self._start(k + 1) else set()
        begin = self._start(k)
        tracks = {r: ways[r] if r in ways else self._onward(r, k, begin, now) for r in there}
        n = 2 * len(self.names)
        places = LandmarkMap(self.names, self.h[:n].reshape(-1, 2), np.zeros((n, n)))
        stretch = stretch_of(
            [self.logs[r] for r in there], tracks, (begin, end), places, self.labels,
            [r for r in there if r in before], [r for r in there if r in after], self.smoothing, self.calibration,
            self.members[0] if k == self._first() and len(self.names) < ENOUGH else None,
        )  # fmt: skip
        x = stretch.problem.x0.copy()
        for part in stretch.parts:
            angles = part.start + 3 * np.arange(len(part.instants.t)) + 2
            x[angles] = np.unwrap(x[angles])
            if part.robot in stretch.entry:  # the same pose as the end of the stretch before, on the same turn
                last = self.x[k - 1][self.stretches[k - 1].columns(part.robot, -1)]
                x[angles] += 2 * np.pi * np.round((last[2] - x[angles[0]]) / (2 * np.pi))
                x[stretch.columns(part.robot, 0)] = last
        x[stretch.landmark_start :] = self.h[self._hubs(stretch)]
        del self.stretches[k:], self.x[k:], self._links[k:], self._entries[k + 1 :], self._passed[k:]
        self.stretches.append(stretch)
        self.x.append(x)
        self._links.append(None)

    def _first(self) -> int:
        """The stretch in which the first robot begins."""
        return int((self.logs[self.members[0]].span[0] - self.begin) // ONLINE_STRETCH)

    def _onward(self, robot: str, k: int, begin: float, now: float) -> Track:
        """Where the robot went from `begin` on: as estimated, beyond that as its filter goes on."""
        have = [j for j in (k - 1, k) if 0 <= j < len(self.stretches) and robot in self.stretches[j].robots]
        at, poses = self._estimates(robot, [self.stretches[j] for j in have], [self.x[j] for j in have])
        if not len(at):  # it begins here: nothing of it was known when all was laid out
            own = self.own[robot]
            return Track(own.t, own.pose)
        return self._carried(robot, at, poses, begin - MARGIN, now)

    def _estimates(
        self, robot: str, stretches: Sequence[Stretch], x: Sequence[np.ndarray]
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        mine = [
            (s.part(robot).instants.t, s.poses(robot, v))
            for s, v in zip(stretches, x, strict=True)
            if robot in s.robots
        ]
        t, first = np.unique(np.concatenate([np.zeros(0), *(a for a, _ in mine)]), return_index=True)
        return t, np.concatenate([np.zeros((0, 3)), *(b for _, b in mine)])[first]

    def _carried(
        self, robot: str, at: Float[np.ndarray, " k"], poses: Float[np.ndarray, "k 3"], begin: float, end: float
    ) -> Track:
        """The robot's own trajectory between `begin` and `end` [s], bent so that it passes through `poses` at `at`."""
        own = self.own[robot]
        first, last = int(np.searchsorted(own.t, begin)), int(np.searchsorted(own.t, end, side="right"))
        inside = (at >= begin) & (at <= end)
        at, poses = at[inside], poses[inside]
        t = np.unique(np.concatenate([own.t[first:last], at]))
        near = slice(max(first - 1, 0), last + 1)
        return Track(t, blended(se2.interpolate(t, own.t[near], own.pose[near]), np.searchsorted(t, at), poses))

    def _hubs(self, stretch: Stretch) -> Int[np.ndarray, " h"]:
        """Where the stretch's landmarks and calibrations stand among all."""
        first, n = 2 * len(self.names), len(PARAMETERS)
        own = [first + n * self.members.index(r) + np.arange(n) for r in stretch.robots]
        return np.concatenate([np.arange(first), *own])

    def _prior(self) -> Gauss:
        """What is known of landmarks and calibrations beforehand; the landmarks as a body stay where they are.

        So the frame is theirs: that of a robot's first pose would turn as long as little is known of its heading.
        """
        mean, information = np.zeros(len(self.h)), np.full(len(self.h), LOOSE)
        mean[: 2 * len(self.names)] = self.h[: 2 * len(self.names)]
        at = 2 * len(self.names)
        for robot in self.members:
            value, sd = prior_of(self.calibration.get(robot, {}), self.smoothing.calibration, wheels=True)
            rows = slice(at, at + len(PARAMETERS))
            mean[rows], information[rows] = value, np.maximum(sd, HELD) ** -2
            at = rows.stop
        Lambda, eta = np.diag(information), information * mean
        if len(self.names) >= ENOUGH:
            points = self.h[: 2 * len(self.names)].reshape(-1, 2)
            away = points - points.mean(axis=0)
            rigid = np.zeros((2 * len(points), 3))
            rigid[0::2, 0] = rigid[1::2, 1] = 1.0
            rigid[0::2, 2], rigid[1::2, 2] = -away[:, 1], away[:, 0]
            Q = np.linalg.qr(rigid)[0]
            hold = FRAME * Q @ Q.T
            rows = slice(2 * len(points))
            Lambda[rows, rows] += hold
            eta[rows] += hold @ points.ravel()
        return Gauss(Lambda, eta)

    def _solve(self, iterations: int, *, everything: bool, older: bool = True) -> OnlineStep:
        """Gauss-Newton: stretches linearised where they are, a pass forward, a pass back.

        older: whether stretches before the latest are linearised anew where they have moved.
        """
        _cfg, n = self.online, len(self.stretches)
        first = 0 if everything else max(0, n - ONLINE_WINDOW)
        linearised = renewed = i = 0
        change = np.inf
        for i in range(iterations):
            anew = {k for k in range(first, n) if self._change(k) > (0.1 if everything else 0.5) * ONLINE_STILL}
            if i == 0 and older and not everything:
                moves = {k: m for k in range(first) if (m := self._change(k)) > ONLINE_MOVE}
                far = sorted(moves, key=lambda k: -moves[k])[:ONLINE_RENEWED]
                renewed = len(far)
                anew |= set(far)
            for k in anew:
                self._links[k] = self.stretches[k].linearised(self.x[k])
            linearised += len(anew)
            self._forward(min(anew, default=n))
            change = self._back(first)
            if change < ONLINE_STILL:
                break
        return OnlineStep(i + 1, linearised, renewed, change)

    def _change(self, k: int) -> float:
        """How far what stretch k shares has moved since it was linearised."""
        link = self._links[k]
        return np.inf if link is None else float(np.abs(self.x[k][link.shared] - link.x[link.shared]).max(initial=0.0))

    def _forward(self, k: int) -> None:
        """The chain passed from stretch k on."""
        del self._entries[k + 1 :], self._passed[k:]
        for s, link in zip(self.stretches[k:], self._links[k:], strict=True):
            assert link is not None  # noqa: S101  (linearised by the caller)
            out = passed(self._entries[-1], link, 3 * len(s.entry), 3 * len(s.exit), self._hubs(s))
            self._passed.append(out)
            self._entries.append(out.on)

    def _back(self, first: int) -> float:
        """Every stretch from `first` on where the chain puts it now; the largest change of landmarks and the latest."""
        if any(link is None for link in self._links) or len(self._passed) < len(self.stretches):
            self._link_and_pass()
        end = self._entries[-1]
        ends, hubs = np.split(solve(end.Lambda, end.eta), [3 * len(self.stretches[-1].exit)])
        change = float(np.abs(hubs - self.h).max(initial=0.0))
        latest = max(0, len(self.stretches) - ONLINE_WINDOW)
        self.h = hubs
        for k in reversed(range(first, len(self.stretches))):
            s, link, step = self.stretches[k], self._links[k], self._passed[k]
            assert link is not None  # noqa: S101  (linearised above)
            entry = step.w - step.W @ np.concatenate([ends, hubs])
            x = link.inside(np.concatenate([entry, ends, hubs[self._hubs(s)]]))
            if k >= latest:
                change = max(change, float(np.abs(x - self.x[k]).max(initial=0.0)))
            self.x[k], ends = x, entry
        return change

    def _link_and_pass(self) -> None:
        """Stretches that are new linearised, and the chain passed to its end."""
        fresh = [k for k, link in enumerate(self._links) if link is None]
        for k in fresh:
            self._links[k] = self.stretches[k].linearised(self.x[k])
        self._forward(min([*fresh, len(self._passed)]))


@dataclass(frozen=True, slots=True)
class OnlineMap:
    """The largest component `t` [s] after the first row of all logs; robots: how many were tied in."""

    t: float
    robots: int
    landmarks: LandmarkMap


@dataclass(frozen=True, slots=True)
class OnlineRun:
    """What smoothing while the logs played took, and what it came to.

    step: [s] of the logs taken in at once; seconds: (n,) each step took; lag: (n,) [s] from the oldest row of a step
    until the map held it, were the logs as fast as the robots; linearised: stretches of each step; renewed: of these
    older ones that had moved; laid_out: [s] after the first row at which robots or landmarks came in; stretches: how
    many there are, none of them given up; closing: [s] for what was left to do when the logs ended; landmarks_moved,
    ways_moved: [m] root mean square by which that changed them; growth: intermediate maps; waited: robots without
    wheels, whose rows came in when the logs ended; members: those that were smoothed before. A result holds no `team`.
    """

    team: OnlineTeam | None
    step: float
    seconds: Float[np.ndarray, " n"]
    lag: Float[np.ndarray, " n"]
    linearised: Float[np.ndarray, " n"]
    renewed: int
    laid_out: tuple[float, ...]
    stretches: int
    growth: tuple[OnlineMap, ...]
    closing: float = 0.0
    landmarks_moved: float | None = None
    ways_moved: float | None = None
    waited: tuple[str, ...] = ()
    members: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A finding where nothing, or not every robot, could be smoothed before the end."""
        if self.members:
            robots = ", ".join(map(robot_key, self.waited))
            why = f"no wheels: smoothed when the logs ended: robot {robots}"
            return (Finding("smoothed-late", value=why),) if robots else ()
        why = "no robot with wheels had a map while the logs played: all was smoothed at their end"
        return (Finding("smoothed-late", value=why),)

    def timing(self) -> dict[str, float]:
        """Seconds a step and seconds of lag: mean, 99 % and largest; and of the closing."""
        out: dict[str, float] = {}
        for name, values in (("step", self.seconds), ("lag", self.lag)):
            if len(values):
                statistics = (values.mean(), np.quantile(values, 0.99), values.max())
                out |= {f"{name}_{k}": float(v) for k, v in zip(("mean", "p99", "max"), statistics, strict=True)}
        return out | {"closing": self.closing}
