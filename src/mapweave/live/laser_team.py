"""Laser robots followed while they drive: an estimate of each from what it told, woven into one map again and again.

What costs as much as a scan (following, laying a keyframe into the map) is told apart from what costs as much as the
team: trying two maps on each other, and solving the graph of all. Between two solutions the map goes on: new keyframes
stand where their steps put them, beside those of their robot that were woven last.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..laser.config import LaserConfig
from ..laser.joint_pass import JointConfig
from ..laser.merge import Merge
from ..laser.merge_search import Start
from ..laser.robot_graph import RobotGraph
from ..laser.weave import Woven, weave
from .canvas import Canvas, Seen
from .driven import DrivenSession
from .laser_stream import LaserRecord
from .messages import Header, Scans, decode
from .pair_search import UNTRIED, PairSearch, PairTrial, between
from .placed import ALONE, Placed
from .store import Store
from .tiles import TileKey

AT_ONCE = 50  # messages of all robots worked in at once, of each robot one at least
LEAST_KEYFRAMES = 3  # of a robot to be woven
UNTOUCHED = JointConfig(widths=())  # keyframes stay as the joint graph has them: the last pass is left to the end
MOST_TOLD = 60  # pairs of robots
LAID_AT_ONCE = 100  # keyframes laid into the map at most each time it is drawn

Starts = Callable[[Sequence[str]], Mapping[int, Start]]


def nobody(robots: Sequence[str]) -> Mapping[int, Start]:  # noqa: ARG001
    """Nobody's start is known."""
    return {}


@dataclass(frozen=True, slots=True)
class WovenTeam:
    """How laser robots hang together, by their names in the team.

    placed: where each one's frame stands; decisions: in words; tiles: the map, drawn; worked: robot -> its first
    message that is not in them; behind: messages that were heard and are not; number: counts the solutions.
    """

    placed: Mapping[str, Placed]
    decisions: Sequence[str]
    tiles: Mapping[TileKey, bytes]
    behind: int
    number: int
    worked: Mapping[str, int] = field(default_factory=dict)


@dataclass(slots=True)
class _Robot:
    record: LaserRecord
    session: DrivenSession
    next: int = 1

    @property
    def size(self) -> int:
        """Keyframes."""
        graph = self.session.keyframes
        return 0 if graph is None else len(graph)


@dataclass(slots=True)
class LaserTeam:
    """The estimates of all laser robots of a team; everything here is the business of one thread.

    starts: for robots in an order, by place, where their frames are said to lie in that of the first. woven: how often
    the graph of all was solved.
    """

    store: Store
    cfg: LaserConfig
    starts: Starts
    robots: dict[str, _Robot] = field(default_factory=dict)
    search: PairSearch = field(default_factory=PairSearch)
    woven: int = 0
    unlaid: int = 0
    _placed: dict[str, Placed] = field(default_factory=dict)
    _poses: dict[str, Float[np.ndarray, "n 3"]] = field(default_factory=dict)  # of keyframes as they were woven last
    _decisions: list[str] = field(default_factory=list)
    _canvases: list[Canvas] = field(default_factory=list)

    def follow(self, heard: Mapping[str, int]) -> int:
        """Work in a few messages of each robot; how many are left. heard: robot -> its first number missing."""
        left, most = 0, max(1, AT_ONCE // max(len(heard), 1))
        for name, end in heard.items():
            robot = self._robot(name)
            if robot is None:
                continue
            until = min(end, robot.next + most)
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
            self.robots[name] = _Robot(LaserRecord(header), DrivenSession(header.log_robot, self.cfg))
        return self.robots[name]

    def _sizes(self) -> dict[str, int]:
        """Keyframes of each robot that has enough of them to be woven."""
        return {name: robot.size for name, robot in sorted(self.robots.items()) if robot.size >= LEAST_KEYFRAMES}

    def trial(self) -> PairTrial | None:
        """The two maps to be tried on each other next; None when no decision is wanted."""
        sizes = self._sizes()
        pair = self.search.next(sizes)
        if pair is None:
            return None
        names = list(sizes)
        start = between(self.starts(names), names.index(pair[0]), names.index(pair[1]))
        graphs = [graph for name in pair if (graph := self.robots[name].session.keyframes) is not None]
        a, b = (np.array(graph.pose) for graph in graphs)
        of_a, of_b = ([node.beams.s for node in graph.nodes] for graph in graphs)
        return PairTrial(*pair, (a, b), (of_a, of_b), self.cfg.merge, start)

    def weave(self) -> bool:
        """The graph of all robots solved by what is decided on pairs so far; whether there is any robot."""
        graphs: dict[str, RobotGraph] = {}
        for name in self._sizes():
            graph = self.robots[name].session.bare_graph(name)
            if graph is not None:
                graphs[name] = graph
        if not graphs:
            return False
        names, parts = list(graphs), list(graphs.values())
        woven = weave(parts, self.cfg.merge, known=self.search.known(names), last=UNTOUCHED)
        self.woven += 1
        self._placed = _placed(names, parts, woven, self.cfg.graph.unsure)
        self._poses = dict(zip(names, woven.pose, strict=True))
        self._decisions = _decisions(names, woven.merges, self._placed)
        return True

    def draw(self, heard: Mapping[str, int]) -> WovenTeam:
        """The map as it stands, with everything that was worked in; at most `LAID_AT_ONCE` keyframes are laid anew.

        unlaid: how many are left for the next time.
        """
        parts: dict[int, dict[str, Float[np.ndarray, "n 3"]]] = {}
        self._place_new()
        for name, placed in self._placed.items():
            parts.setdefault(placed.component, {})[name] = self._now(name)
        self._canvases, before = [], self._canvases
        tiles: dict[TileKey, bytes] = {}
        self.unlaid = 0
        for part, poses in sorted(parts.items()):
            canvas = _kept(before, poses.keys()) or Canvas(self.cfg.resolution)
            self.unlaid += canvas.update(poses, self._seen, LAID_AT_ONCE)
            self._canvases.append(canvas)
            tiles |= {(part, *key): cells for key, cells in canvas.draw().items()}
        worked = {name: robot.next for name, robot in self.robots.items()}
        behind = sum(max(n - worked.get(name, 0), 0) for name, n in heard.items())
        return WovenTeam(dict(self._placed), list(self._decisions), tiles, behind, self.woven, worked)

    def _place_new(self) -> None:
        """Robots that were not woven yet stand in parts of their own."""
        for name, robot in sorted(self.robots.items()):
            if name not in self._placed and robot.size:
                last = max((p.component for p in self._placed.values()), default=0)
                self._placed[name] = Placed(last + 1, *ALONE)

    def _now(self, name: str) -> Float[np.ndarray, "n 3"]:
        """The poses of all keyframes in the map of their part: as woven, those since beside the last of these."""
        graph, known = self.robots[name].session.keyframes, self._poses.get(name)
        assert graph is not None  # noqa: S101  (it has a place)
        if known is None:
            return np.array(graph.pose)
        last = len(known) - 1
        since = se2.compose(known[-1], se2.between(graph.pose[last], graph.pose[last + 1 :]))
        return np.concatenate([known, np.asarray(since).reshape(-1, 3)])

    def _seen(self, name: str, k: int) -> Seen:
        session = self.robots[name].session
        graph = session.keyframes
        assert graph is not None  # noqa: S101  (it has a place)
        return Seen(graph.nodes[k].beams.s, session.sensor(k))


def _kept(canvases: list[Canvas], robots: Iterable[str]) -> Canvas | None:
    """The canvas with the most keyframes of `robots` alone, taken out of `canvases`."""
    fit = [c for c in canvases if c.laid.keys() <= set(robots)]
    best = max(fit, key=lambda c: sum(map(len, c.laid.values())), default=None)
    if best is not None:
        canvases.remove(best)
    return best


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


def _decisions(names: Sequence[str], merges: Sequence[Merge], placed: Mapping[str, Placed]) -> list[str]:
    """What was decided on pairs; of more than `MOST_TOLD` those that hang together."""
    tried = [m for m in merges if m.reason != UNTRIED]
    tied = [m for m in tried if m.merged]
    told = [
        f"{m.a} and {m.b}: {m.reason if m.merged else f'not merged, {m.reason}'}"
        for m in (tried if len(tried) <= MOST_TOLD else tied)
    ]
    if len(tried) > MOST_TOLD:
        told.append(f"{len(tried) - len(tied)} pairs not merged")
    if len(tried) < len(merges):
        told.append(f"{len(merges) - len(tried)} pairs {UNTRIED}")
    parts = len({p.component for p in placed.values()})
    if len(names) == 1:
        return [f"{names[0]}: the only one so far"]
    return told if parts == 1 else [*told, f"{parts} parts that nothing ties"]
