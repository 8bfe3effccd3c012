"""Laser robots followed while they drive: an estimate of each from what it told, woven into one map again and again.

What costs as much as a scan (following, laying a keyframe into the map) is told apart from what costs as much as the
team: trying two maps on each other, and solving the graph of all. Between two solutions the map goes on: new keyframes
stand where their steps put them, beside those of their robot that were woven last.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from ..core import se2
from ..core.records import Track
from ..laser.robot_graph import RobotGraph
from ..mapping.config import LaserConfig
from ..mapping.merge_search import Start, start_between
from ..team.relation import SURE_THETA
from ..team.relative_frame import PLACING_LEVER
from ..team.walls import unless_far
from .door import kept
from .driven import DrivenSession
from .isolation import in_words
from .joined import Joined, into_one_frame
from .laser_stream import LaserRecord
from .messages import Header, Scans, encode
from .pair_search import PairSearch, PairTrial
from .sources import OFFICE, messages, open_source
from .store import Store
from .tile_mapper import Standing, TileMapper, UnmappableError
from .tiles import TileKey
from .weaving import ALONE, Placed, Weaving, WovenGraphs

FINE = 0.5  # [m] cells of one robot's walls, so that each is kept once
COARSE = 1.0  # [m] cells of all robots' walls: what a start told and a map's bend are off
ROWS = 1 << 20  # more than there are cells along any axis

Pair = tuple[str, str]


@dataclass(slots=True)
class WallCells:
    """Where one robot saw walls, in its own frame, with keyframes as they stood when they came.

    cells: of `FINE`, as whole numbers that tell both axes; until: keyframes up to this scan are among them.
    """

    cells: Int[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0, np.int64))
    until: int = -1

    def take(self, session: DrivenSession) -> None:
        """The keyframes that came since."""
        graph, ids = session.keyframes, session.ids
        if graph is None or ids[-1] <= self.until:
            return
        fresh = np.flatnonzero(ids > self.until).tolist()
        points = [np.asarray(se2.act(graph.pose[k], graph.nodes[k].beams.s)) for k in fresh]
        self.cells = np.union1d(self.cells, _coded(np.concatenate(points), FINE))
        self.until = int(ids[-1])

    @property
    def centres(self) -> Float[np.ndarray, "n 2"]:
        """Of the cells [m]."""
        return FINE * (np.column_stack(np.divmod(self.cells + ROWS // 2, ROWS)) - [0.0, ROWS // 2] + 0.5)


def in_common(walls: Mapping[str, WallCells], starts: Mapping[int, Start]) -> dict[Pair, int]:
    """Cells of `COARSE` in which both of a pair saw walls, by their names in the order of `walls`.

    starts: by place among them, where robots' frames are said to lie in that of the first. Pairs of which the start of
    either is not told are left out.
    """
    names = list(walls)
    placed = [k for k in range(len(names)) if k in starts or k == 0] if starts else []
    seen = []
    for k in placed:
        frame = starts[k].transform if k in starts else np.zeros(3)
        seen.append(np.unique(_coded(np.asarray(se2.act(frame, walls[names[k]].centres)), COARSE)))
    every, column = np.unique(np.concatenate([np.zeros(0, np.int64), *seen]), return_inverse=True)
    first = np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64)
    holds = csr_array((np.ones(len(column), np.int64), column, first), shape=(len(placed), len(every)))
    both = (holds @ holds.T).toarray()
    return {(names[placed[i]], names[placed[j]]): int(both[i, j]) for i, j in _pairs(len(placed))}


def _coded(points: Float[np.ndarray, "n 2"], side: float) -> Int[np.ndarray, " cells"]:
    """The cells in which the points lie, each once."""
    near = points[(np.abs(points) < side * ROWS // 2).all(axis=1)]  # what is no number, or farther out, is in no cell
    column, row = np.floor(near / side).astype(np.int64).T
    return np.unique(ROWS * column + row)


def _pairs(n: int) -> Iterator[tuple[int, int]]:
    return ((i, j) for j in range(n) for i in range(j))


AT_ONCE = 50  # messages of all robots worked in at once, of each robot one at least
LEAST_KEYFRAMES = 3  # of a robot to be woven
RIPE = 13  # keyframes of a map from which on it is likely to be tied: with fewer too few places confirm it
LAID_AT_ONCE = 100  # keyframes laid into the map at most each time it is drawn

Starts = Callable[[Sequence[str]], Mapping[int, Start]]


def nobody(robots: Sequence[str]) -> Mapping[int, Start]:  # noqa: ARG001
    """Nobody's start is known."""
    return {}


@dataclass(frozen=True, slots=True)
class WovenTeam:
    """How laser robots are connected, by their names in the team.

    placed: where each one's frame stands; decisions: in words; tiles: the map, drawn; worked: robot -> its first
    message that is not in them; behind: messages that were heard and are not; number: counts the solutions; lost: why
    robots are in them no more. anchors: where each one's first keyframe is; ways: its keyframes in its own frame.
    """

    placed: Mapping[str, Placed]
    decisions: Sequence[str]
    tiles: Mapping[TileKey, bytes]
    behind: int
    number: int
    worked: Mapping[str, int] = field(default_factory=dict)
    lost: Mapping[str, str] = field(default_factory=dict)
    anchors: Mapping[str, Float[np.ndarray, "3"]] = field(default_factory=dict)
    ways: Mapping[str, Track] = field(default_factory=dict)


@dataclass(slots=True)
class _Robot:
    record: LaserRecord
    session: DrivenSession
    walls: WallCells = field(default_factory=WallCells)
    next: int = 1
    told: bool = False  # whether what comes is told once more

    @property
    def size(self) -> int:
        """Keyframes."""
        graph = self.session.keyframes
        return 0 if graph is None else len(graph)


@dataclass(slots=True)
class LiveLaserTeam:
    """The estimates of all laser robots of a team; everything here is the business of one thread.

    starts: for robots in an order, by place, where their frames are said to lie in that of the first. woven: how often
    the graph of all was solved. lost: robots on whose data something failed, and what: they are followed no more.
    joined: what sightings tie, which no wall is believed against.
    """

    store: Store
    cfg: LaserConfig
    starts: Starts
    robots: dict[str, _Robot] = field(default_factory=dict)
    search: PairSearch = field(default_factory=PairSearch)
    lost: dict[str, str] = field(default_factory=dict)
    woven: int = 0
    unlaid: int = 0
    joined: Joined = field(default_factory=Joined)
    _placed: dict[str, Placed] = field(default_factory=dict)
    _standing: dict[str, Standing] = field(default_factory=dict)  # as they were woven last
    _decisions: list[str] = field(default_factory=list)
    _mappers: list[TileMapper] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.search.ripe = RIPE

    def follow(self, heard: Mapping[str, int]) -> int:
        """Work in a few messages of each robot; how many are left. heard: robot -> its first number missing.

        Where more than one of each waits, scans are passed over that show less new.
        """
        left, most = 0, max(1, AT_ONCE // max(len(heard), 1))
        waiting = sum(max(end - self.robots[name].next, 0) for name, end in heard.items() if name in self.robots)
        for robot in self.robots.values():
            robot.session.hurried = waiting > len(heard)
        for name, end in heard.items():
            begun = self.robots.get(name)
            first = 0 if begun is None else begun.next
            payloads = () if name in self.lost else self.store.get(name, first, min(end, max(first, 1) + most) - 1)
            with self._at_cost_of(name):
                self._work_in(name, payloads)
            left += 0 if name not in self.robots else max(end - self.robots[name].next, 0)
        return left

    def _work_in(self, name: str, payloads: Sequence[tuple[int, bytes]]) -> None:
        """A robot's next messages; it begins with the first one."""
        for seq, payload in payloads:
            message = kept(payload)
            if isinstance(message, Header) and seq == 0:
                self.robots[name] = _Robot(LaserRecord(message), DrivenSession(message.log_robot, self.cfg))
                continue
            robot = self.robots.get(name)
            if robot is None or seq != robot.next:  # a full disk: the rest is not in the store yet
                return
            robot.next = seq + 1
            robot.told |= isinstance(message, Header)
            part = robot.record.add(message) if isinstance(message, Scans) and not robot.told else None
            for event in () if part is None else part.events():
                robot.session.push(event)

    @contextmanager
    def _at_cost_of(self, name: str) -> Iterator[None]:
        """Whatever fails within is the fault of what this robot told: it is lost, and nobody else."""
        try:
            yield
        except Exception as error:  # noqa: BLE001  (there is no end to what numbers can break)
            self.lose(name, in_words(error))

    def lose(self, name: str, why: str) -> None:
        """The robot is in no map and followed no more."""
        self.lost[name] = why
        self.forget(name)

    def forget(self, name: str) -> None:
        """Nothing that came of what the robot told is kept; unless it is lost, it begins anew."""
        self.robots.pop(name, None)
        self._placed.pop(name, None)
        self._standing.pop(name, None)
        self.search.forget(name)

    def _sizes(self) -> dict[str, int]:
        """Keyframes of each robot that has enough of them to be woven."""
        return {name: robot.size for name, robot in sorted(self.robots.items()) if robot.size >= LEAST_KEYFRAMES}

    def trial(self) -> PairTrial | None:
        """The two maps to be tried on each other next; None when no decision is wanted."""
        sizes = self._sizes()
        names = list(sizes)
        for name in names:
            with self._at_cost_of(name):
                self.robots[name].walls.take(self.robots[name].session)
        names = [name for name in names if name in self.robots]
        starts = self.starts(names) if len(names) > 1 else {}
        wanted = bool(starts) and self.search.apart(names)
        common = in_common({name: self.robots[name].walls for name in names}, starts) if wanted else {}
        pair = self.search.next({name: sizes[name] for name in names}, common)
        if pair is None:
            return None
        start = start_between(starts, names.index(pair[0]), names.index(pair[1])) or self._sighted_start(*pair)
        sessions = [self.robots[name].session for name in pair]
        graphs = [graph for session in sessions if (graph := session.keyframes) is not None]
        a, b = (np.array(graph.pose) for graph in graphs)
        of_a, of_b = ([node.beams.s for node in graph.nodes] for graph in graphs)
        ids_a, ids_b = (session.ids for session in sessions)
        return PairTrial(
            *pair, (a, b), (of_a, of_b), (ids_a, ids_b), self.cfg.merge, start, common.get((pair[0], pair[1]), 0)
        )

    def weaving(self) -> Weaving | None:
        """All robots' graphs as they are, with what is decided on pairs so far; None before there is any robot."""
        self._overrule_walls()
        there = list[RobotGraph]()
        for name in self._sizes():
            with self._at_cost_of(name):
                graph = self.robots[name].session.bare_graph(name)
                there += [] if graph is None else [graph]
        if not there:
            return None
        ids = {graph.robot: self.robots[graph.robot].session.ids for graph in there}
        return Weaving(there, list(ids.values()), self.search.known(ids), self.cfg.merge, self.cfg.graph.unsure)

    def take(self, woven: WovenGraphs) -> None:
        """The robots stand as they were woven, be it that they went on since."""
        self.woven += 1
        self._placed = {name: placed for name, placed in woven.placed.items() if name in self.robots}
        self._standing = {name: standing for name, standing in woven.standing.items() if name in self.robots}
        self._decisions = woven.decisions
        for name, why in woven.failed.items():
            self.lose(name, why)

    def draw(self, heard: Mapping[str, int]) -> WovenTeam:
        """The map as it stands, with everything that was worked in; at most `LAID_AT_ONCE` keyframes are laid anew.

        unlaid: how many are left for the next time.
        """
        parts: dict[int, dict[str, Standing]] = {}
        self._place_new()
        for name, placed in list(self._placed.items()):
            with self._at_cost_of(name):
                parts.setdefault(placed.component, {})[name] = self._now(name)
        ways = {name: self._way(name) for standing in parts.values() for name in standing}
        parts, where = self._tied_together(parts)
        self._mappers, before = [], self._mappers
        tiles: dict[TileKey, bytes] = {}
        self.unlaid = 0
        for part, standing in sorted(parts.items()):
            mapper = _kept(before, standing.keys()) or TileMapper(self.cfg.resolution)
            try:
                self.unlaid += mapper.update(standing, lambda name, k: self.robots[name].session.seen(k), LAID_AT_ONCE)
            except UnmappableError as error:
                self.lose(error.robot, str(error))
                self.unlaid += 1  # the part is drawn from its first keyframe on the next time, without that robot
                continue
            self._mappers.append(mapper)
            tiles |= {(part, *key): cells for key, cells in mapper.draw().items()}
        for robot in self.robots.values():
            robot.session.left.clear()
        worked = {name: robot.next for name, robot in self.robots.items()}
        behind = sum(max(n - worked.get(name, 0), 0) for name, n in heard.items())
        behind -= sum(heard.get(name, 0) for name in self.lost)
        decisions = [*self._decisions, *(f"{name}: left out, {why}" for name, why in self.lost.items())]
        where = {name: placed for name, placed in where.items() if name in self._placed}
        anchors = {name: at.pose[0] for standing in parts.values() for name, at in standing.items()}
        return WovenTeam(where, decisions, tiles, behind, self.woven, worked, dict(self.lost), anchors, ways)

    def _way(self, name: str) -> Track:
        """The robot's keyframes in its own frame."""
        graph = self.robots[name].session.keyframes
        assert graph is not None  # noqa: S101  (it has a place)
        return Track(np.array([node.t for node in graph.nodes]), np.array(graph.pose))

    def _sighted_start(self, a: str, b: str) -> Start | None:
        """Where sightings say that the frame of `b` lies in that of `a`; None where they say nothing."""
        at = self.joined.between(a, b)
        graphs = [self.robots[name].session.keyframes for name in (a, b)]
        if at is None or graphs[0] is None or graphs[1] is None:
            return None
        T = se2.compose(se2.compose(graphs[0].pose[0], at), se2.inverse(graphs[1].pose[0]))
        return Start(np.asarray(T), np.array([*2 * [PLACING_LEVER * self.joined.sure], SURE_THETA]))

    def _overrule_walls(self) -> None:
        """Robots are tied by walls no more that sightings put elsewhere."""
        for (a, b), tried in list(self.search.tried.items()):
            start = self._sighted_start(a, b) if {a, b} <= self.robots.keys() and tried.merge.merged else None
            if start is not None:
                merge = unless_far(tried.merge, start, self._way(b), self.joined.sure)
                self.search.tried[a, b] = tried._replace(merge=merge)

    def _tied_together(
        self, parts: Mapping[int, Mapping[str, Standing]]
    ) -> tuple[dict[int, dict[str, Standing]], dict[str, Placed]]:
        """The parts with those in one that sightings tie, and where each robot's frame stands in them."""
        placed = {name: self._placed[name] for standing in parts.values() for name in standing}
        whole = {part: dict(standing) for part, standing in parts.items()}
        anchors = {part: {name: at.pose[0] for name, at in sorted(each.items())} for part, each in parts.items()}
        for part, (root, T, cov) in into_one_frame(anchors, self.joined.tied).items():
            for name, at in whole.pop(part).items():
                whole[root][name] = Standing(at.ids, np.asarray(se2.compose(T, at.pose)))
                old = placed[name]
                spread = se2.composed_covariance(T, cov, old.frame, old.frame_cov)
                placed[name] = Placed(root, np.asarray(se2.compose(T, old.frame)), spread, old.scale, own=old.own)
        return whole, placed

    def _place_new(self) -> None:
        """Robots that were not woven yet stand in parts of their own."""
        for name, robot in sorted(self.robots.items()):
            if name not in self._placed and robot.size:
                last = max((p.component for p in self._placed.values()), default=0)
                self._placed[name] = Placed(last + 1, *ALONE)

    def _now(self, name: str) -> Standing:
        """All keyframes in the map of their part: as woven, those since beside the last of these."""
        session, woven = self.robots[name].session, self._standing.get(name)
        graph, ids = session.keyframes, session.ids
        assert graph is not None  # noqa: S101  (it has a place)
        if woven is None:
            return Standing(ids, np.array(graph.pose))
        still = np.isin(woven.ids, ids)
        known = woven.pose[still]  # the first keyframe never leaves
        last = int(np.searchsorted(ids, woven.ids[still][-1]))
        since = se2.compose(known[-1], se2.between(graph.pose[last], graph.pose[last + 1 :]))
        return Standing(ids, np.concatenate([known, np.asarray(since).reshape(-1, 3)]))


def _kept(mappers: list[TileMapper], robots: Iterable[str]) -> TileMapper | None:
    """The mapper with the most keyframes of `robots` alone, taken out of `mappers`."""
    fit = [c for c in mappers if c.laid.keys() <= set(robots)]
    best = max(fit, key=lambda c: sum(len(laid.ids) for laid in c.laid.values()), default=None)
    if best is not None:
        mappers.remove(best)
    return best


ROBOTS = ("r1", "r2")
DRIVEN = 25.0  # [s] of their drives: long enough for their maps to be tried on each other


def compile_kernels(path: Path) -> None:
    """Two simulated robots are followed, tried on each other, solved and drawn once; `path` keeps what they tell."""
    with Store(path, "a map") as store:
        for name in ROBOTS:
            told = messages(open_source(OFFICE, name, None), name, "run", 1.0)
            begin, header = next(told)
            some = takewhile(lambda one: one[0] < begin + DRIVEN, told)  # noqa: B023  (used at once)
            store.put([(name, m.seq, encode(m)) for m in (header, *(message for _, message in some))])
        team = LiveLaserTeam(store, LaserConfig(method="graph", threads=1), nobody)
        while team.follow(dict.fromkeys(ROBOTS, 1 + max(store.numbers(ROBOTS[0])))):
            pass
        trial = team.trial()
        if trial is not None:
            team.search.decided(trial, trial.run())
        weaving = team.weaving()
        if weaving is not None:
            team.take(weaving.run())
        team.draw({})
