"""Laser robots followed while they drive: an estimate of each from what it told, woven into one map again and again.

All of it runs in a thread of its own, so that nobody waits for it: messages are taken from the store, in order, up to
where there is no gap, and the newest woven map stands in `newest`.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Condition, Thread

import numpy as np

from ..core import se2
from ..core.errors import MapweaveError
from ..laser.config import LaserConfig
from ..laser.joint_pass import JointConfig
from ..laser.merge import Merge
from ..laser.merge_search import Start
from ..laser.occupancy_mapper import keyframe_returns, render_returns
from ..laser.robot_graph import RobotGraph
from ..laser.session import LaserSession
from ..laser.weave import Woven, weave
from .laser_stream import LaserRecord
from .messages import Header, Scans, decode
from .placed import ALONE, Placed
from .store import Store
from .tiles import TileKey, tiles_of

AT_ONCE = 50  # messages worked in before another robot has its turn
GROWN = 1.25  # a pair is tried again when the maps of both together have so many times the keyframes they had
LEAST_KEYFRAMES = 3  # of a robot to be woven
UNTOUCHED = JointConfig(widths=())  # keyframes stay as the joint graph has them: the last pass is left to the end
RESTED = 3.0  # the time from weaving to weaving is at least so many times what weaving takes
PATIENCE = 0.5  # [s] until it is looked again whether to end


Starts = Callable[[Sequence[str]], Mapping[int, Start]]


def nobody(robots: Sequence[str]) -> Mapping[int, Start]:  # noqa: ARG001
    """Nobody's start is known."""
    return {}


@dataclass(frozen=True, slots=True)
class WovenTeam:
    """How laser robots hang together, by their names in the team.

    placed: where each one's frame stands; decisions: in words; tiles: the map, drawn; behind: messages that were heard
    and are not worked in yet; number: counts the weavings.
    """

    placed: Mapping[str, Placed]
    decisions: Sequence[str]
    tiles: Mapping[TileKey, bytes]
    behind: int
    number: int


@dataclass(slots=True)
class _Robot:
    record: LaserRecord
    session: LaserSession
    next: int = 1


@dataclass(slots=True)
class _Tried:
    """What was decided on a pair when both had so many keyframes together."""

    merge: Merge
    keyframes: int


@dataclass(slots=True)
class LaserTeam:
    """The estimates of all laser robots of a team; everything here is the business of one thread.

    starts: for robots in an order, by place, where their frames are said to lie in that of the first.
    """

    store: Store
    cfg: LaserConfig
    starts: Starts
    robots: dict[str, _Robot] = field(default_factory=dict)
    tried: dict[tuple[str, str], _Tried] = field(default_factory=dict)
    woven: int = 0

    def follow(self, heard: Mapping[str, int]) -> int:
        """Work in a few messages of each robot; how many are left. heard: robot -> its first number missing."""
        left = 0
        for name, end in heard.items():
            robot = self._robot(name)
            if robot is None:
                continue
            until = min(end, robot.next + AT_ONCE)
            for seq, payload in self.store.get(name, robot.next, until - 1):
                if seq != robot.next:  # a full disk: the rest is not in the store yet
                    break
                message = decode(payload)
                robot.next = seq + 1
                part = robot.record.add(message) if isinstance(message, Scans) else None
                for event in () if part is None else part.events():
                    robot.session.push(event)
            left += max(end - robot.next, 0)
        return left

    def _robot(self, name: str) -> _Robot | None:
        """The robot's estimate, begun when its header is in the store."""
        if name not in self.robots:
            first = self.store.get(name, 0, 0)
            header = decode(first[0][1]) if first else None
            if not isinstance(header, Header):
                return None
            self.robots[name] = _Robot(LaserRecord(header), LaserSession(header.log_robot, self.cfg))
        return self.robots[name]

    def weave(self, behind: int) -> WovenTeam | None:
        """One map of all robots that can be tied together by now; None before there is any."""
        graphs: dict[str, RobotGraph] = {}
        for name, robot in sorted(self.robots.items()):
            graph = robot.session.graph(covariances=False)
            if graph is not None and len(graph) >= LEAST_KEYFRAMES:
                graphs[name] = replace(graph.stored(), robot=name)
        if not graphs:
            return None
        names, parts = list(graphs), list(graphs.values())
        known = {
            (i, j): tried.merge
            for i, a in enumerate(names)
            for j, b in enumerate(names)
            if (tried := self.tried.get((a, b))) is not None
            and len(graphs[a]) + len(graphs[b]) < GROWN * tried.keyframes
        }
        woven = weave(parts, self.cfg.merge, self.starts(names), known=known, last=UNTOUCHED)
        for merge in woven.merges:
            if (names.index(merge.a), names.index(merge.b)) not in known:
                self.tried[merge.a, merge.b] = _Tried(merge, len(graphs[merge.a]) + len(graphs[merge.b]))
        self.woven += 1
        placed = _placed(names, parts, woven, self.cfg.graph.unsure)
        tiles: dict[TileKey, bytes] = {}
        for part in sorted({p.component for p in placed.values()}):
            members = [k for k, name in enumerate(names) if placed[name].component == part]
            laid = [scan for k in members for scan in keyframe_returns(parts[k], lit=False)]
            grid = render_returns(laid, np.concatenate([woven.pose[k] for k in members]), self.cfg.resolution, "map")
            tiles.update(tiles_of(grid, part))
        return WovenTeam(placed, _decisions(names, woven, placed), tiles, behind, self.woven)


def _placed(names: Sequence[str], graphs: Sequence[RobotGraph], woven: Woven, unsure: float) -> dict[str, Placed]:
    """Where each robot's frame stands by its last keyframe, in the map of its part; the largest part is number 1.

    unsure: times the graph's covariances are those told.
    """
    order = sorted(
        set(woven.component.tolist()),
        key=lambda c: (-int((woven.component == c).sum()), woven.component.tolist().index(c)),
    )
    part = {c: k for k, c in enumerate(order, 1)}
    last = np.cumsum([len(g) for g in graphs]) - 1
    cov = [unsure * woven.joint.solution.covariance(3 * i + np.arange(3)) for i in last.tolist()]
    out = {}
    for k, (name, graph) in enumerate(zip(names, graphs, strict=True)):
        c = int(woven.component[k])
        if (woven.component == c).sum() == 1:
            out[name] = Placed(part[c], *ALONE)
            continue
        here = graph.pose[-1]
        frame = np.asarray(se2.compose(woven.pose[k][-1], se2.inverse(here)))
        lever = np.linalg.inv(se2.compose_jacobians(frame, here)[0])
        turned = se2.turned_covariance(float(woven.pose[k][-1, 2] - woven.joint.graph.pose[last[k], 2]), cov[k])
        out[name] = Placed(part[c], frame, lever @ turned @ lever.T, 1.0, own=False)
    return out


def _decisions(names: Sequence[str], woven: Woven, placed: Mapping[str, Placed]) -> list[str]:
    told = [f"{m.a} and {m.b}: {m.reason if m.merged else f'not merged, {m.reason}'}" for m in woven.merges]
    parts = len({p.component for p in placed.values()})
    if len(names) == 1:
        return [f"{names[0]}: the only one so far"]
    return told if parts == 1 else [*told, f"{parts} parts that nothing ties"]


class LaserWeaver:
    """The thread in which a laser team is followed.

    newest: the last woven map, None before the first; failed: why the last weaving gave none, empty when it did.
    """

    def __init__(self, store: Store, cfg: LaserConfig, every: float, starts: Starts = nobody) -> None:
        self.newest: WovenTeam | None = None
        self.failed = ""
        self._team = LaserTeam(store, replace(cfg, method="graph", threads=1), starts)
        self._every = every
        self._heard: dict[str, int] = {}
        self._changed = Condition()
        self._ended = False
        self._thread = Thread(target=self._run, name="weaver", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def hear(self, heard: Mapping[str, int]) -> None:
        """Robot -> the first number missing: all before it is to be worked in."""
        with self._changed:
            if dict(heard) != self._heard:
                self._heard = dict(heard)
                self._changed.notify()

    def stop(self) -> None:
        """No more is worked in; what is under way ends first."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        due, fresh, followed = 0.0, False, {"": -1}
        while True:
            with self._changed:
                if self._ended:
                    return
                heard = dict(self._heard)
                if heard == followed:
                    self._changed.wait(max(PATIENCE if not fresh else min(PATIENCE, due - time.monotonic()), 0.01))
                    heard = dict(self._heard)
            try:
                if heard != followed:
                    before = self._worked_in()
                    left = self._team.follow(heard)
                    more = self._worked_in() > before
                    fresh = fresh or more
                    followed = {"": -1} if left and more else heard  # what is not in the store yet is waited for
                now = time.monotonic()
                if fresh and now >= due:
                    behind = sum(max(n - self._done(name), 0) for name, n in heard.items())
                    self.newest = self._team.weave(behind) or self.newest
                    self.failed, fresh = "", False
                    due = time.monotonic() + max(self._every, RESTED * (time.monotonic() - now))
            except (MapweaveError, np.linalg.LinAlgError) as error:
                self.failed, fresh = str(error), False
                followed, due = heard, time.monotonic() + self._every

    def _worked_in(self) -> int:
        return sum(robot.next for robot in self._team.robots.values())

    def _done(self, name: str) -> int:
        robot = self._team.robots.get(name)
        return 0 if robot is None else robot.next
