"""Laser SLAM of a team: each robot its own front end, one pose graph over all robots' keyframes, one merged map.

Frames: `local_k` is robot k's own, from its first scan; it never jumps. `map` is the frame the starts are given in and
hangs on the first robot's start; it may jump when loops close. Where nobody knows the starts each robot has a map of
its own, until places tell how two of them lie: their robots are a crew then, which hangs on its first robot's start.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core import se2
from ..core.gaussian import symmetrise
from ..core.records import Scan, Track
from ..laser.beam import Beams, beams
from ..laser.closures import Closure, Matched, PlaceMatcher
from ..laser.consistency import adjoint
from ..laser.keyframes import Keyframe, KeyframeOdometry, KeyframeScan
from ..laser.laser_map import GridMap
from ..laser.occupancy_mapper import OccupancyMapper
from ..laser.pose_graph import PoseGraph
from .config import LaserTeamConfig
from .keyframe_graph import KeyframeGraph
from .map_overlap import KeyframeMap
from .merge import Merge, swapped

CLOSURE_EVERY = 1.0  # [m] between keyframes that are tried
CLOSURE_TRIES = 2  # matches a robot and step, at most; 0: no loops are looked for
CLOSURE_REACH = 5.0  # [m] between the keyframes
CLOSURE_FAR = 20.0  # [m] driven since the old keyframe, within one robot: nearer ones are in its local map
RESOLVE_INNOVATION = 2.0  # [sd] by which a closure moves a pose for the graph to be solved anew
VIEW_NEAR, VIEW_FAR = 0.5, 6.0  # [m] within which one robot is sure to see another,
VIEW_HALF = 0.12  # [m] to either side of its middle, a hull being wider,
VIEW_BEAMS = 2  # beams there at least,
VIEW_BEHIND = 0.6  # [m] behind its middle at which they end if nobody is there
OPEN_SHARE = 0.9  # share of the scanner's range that is free where a beam does not come back


class LoopSearch:
    """Keyframes wait here until they are matched against old places, a few at a time."""

    def __init__(self, matcher: PlaceMatcher, robots: int) -> None:
        self.matcher = matcher
        self._untried: list[list[int]] = [[] for _ in range(robots)]
        self._path = np.full(robots, -np.inf)

    def offer(self, graph: KeyframeGraph, i: int) -> None:
        """Keyframe `i` will be tried when its robot drove far enough since the last one that was."""
        node = graph.nodes[i]
        if node.path - self._path[node.robot] >= CLOSURE_EVERY:
            self._path[node.robot] = node.path
            self._untried[node.robot].append(i)

    def step(self, graph: KeyframeGraph, j: int) -> None:
        """At most `CLOSURE_TRIES` matches of robot j's keyframes, the oldest first."""
        left = CLOSURE_TRIES
        while self._untried[j] and left > 0:
            i = self._untried[j].pop(0)
            for k in self.candidates(graph, i)[:left]:
                left -= self._try(graph, k, i)

    def _try(self, graph: KeyframeGraph, k: int, i: int) -> bool:
        """Keyframe `i` is matched against the place of keyframe `k`; returns whether it could be."""
        cov = graph.relative(k, i)
        if cov is None:
            return False
        match = self.matcher.match(graph.place(k), graph.nodes[i].beams, se2.between(graph.pose[k], graph.pose[i]), cov)
        graph.close(k, i, match)
        if match.accepted:
            distance2 = match.innovation @ np.linalg.solve(cov + 1e-12 * np.eye(3), match.innovation)
            graph.due |= bool(distance2 > RESOLVE_INNOVATION**2)
        return True

    def meet(self, graph: KeyframeGraph, mine: Int[np.ndarray, " m"], others: Int[np.ndarray, " k"]) -> None:
        """The keyframes that robots `mine` made until now are matched against the places of `others`, one a metre."""
        for j in mine.tolist():
            tried = -np.inf
            for i in graph.of[j]:
                if graph.path[i] - tried >= CLOSURE_EVERY:
                    tried = float(graph.path[i])
                    for k in self.candidates(graph, i, others):
                        self._try(graph, k, i)

    def candidates(self, graph: KeyframeGraph, i: int, others: Int[np.ndarray, " k"] | None = None) -> list[int]:
        """Solved keyframes near in the estimate, one a chain (another robot, or this one long ago), nearest first.

        others: the robots whose places come into question, all that share a frame with this one when None.
        """
        node, n = graph.nodes[i], graph.known
        d = np.hypot(*(graph.pose[:n, :2] - graph.pose[i, :2]).T)
        robot = graph.robot[:n]
        near = (d < CLOSURE_REACH) & (graph.crew[robot] == graph.crew[node.robot])
        if others is None:
            near &= (robot != node.robot) | (graph.path[:n] < node.path - CLOSURE_FAR)
        else:
            near &= np.isin(robot, others)
        out: list[tuple[float, int]] = []
        for j in np.unique(robot[near]):
            mine = np.flatnonzero(near & (robot == j))
            best = int(mine[np.argmin(d[mine])])
            out.append((float(d[best]), best))
        return [k for _, k in sorted(out)]


class LaserTeam:
    """The estimator of a team, changed by `add_scan`, `deliver`, `remove_robot` and `optimise`; the rest reads it.

    starts: (M, 3) in `map`; `apart`: each in a map of its own. It belongs to one mission; the same calls give the same
    numbers.
    """

    def __init__(self, cfg: LaserTeamConfig | None, starts: Float[np.ndarray, "M 3"], *, apart: bool = False) -> None:
        self.cfg = cfg or LaserTeamConfig()
        self.starts = np.array(starts, dtype=float).reshape(-1, 3)
        M = len(self.starts)
        self.tracks = [KeyframeOdometry(j, self.cfg.graph.keyframes, self.cfg.front_end) for j in range(M)]
        self.team = KeyframeGraph(self.cfg.graph, self.starts, apart=apart)
        self.loops = LoopSearch(PlaceMatcher(self.cfg.front_end), M)
        self.scans: list[KeyframeScan] = []
        self._node: list[int] = []  # the keyframe of each scan
        self._waiting: list[list[Keyframe | KeyframeScan]] = [[] for _ in range(M)]
        self._stamp = np.full(M, -np.inf)
        self._now = self.starts.copy()  # each robot's latest pose
        self._driven = np.zeros(M)  # [m] it drove before its latest scan
        self._offset = np.zeros((0, 3))  # of each scan in its keyframe
        self._gone = np.zeros(M, dtype=bool)
        self._mapper: dict[tuple[float, int], OccupancyMapper] = {}

    def add_scan(self, j: int, t: float, scan: Scan) -> Float[np.ndarray, "3"]:
        """Robot j's latest pose in `map` after `scan`, taken at `t` [s]; what it learned waits until it is delivered.

        A robot's first scan is taken at its start.
        """
        track = self.tracks[j]
        b = self._without_teammates(j, t, beams(scan, "none", None, self.cfg.beams), scan)
        track.advance(scan, b, t=t)
        local = track.local
        keyframe = track.keyframe(t, b)
        if keyframe is not None:
            self._waiting[j].append(keyframe)
        if track.last is not None:
            offset = se2.between(track.last.local, local)
            eye = np.array(scan.T_robot_sensor[:2], dtype=float)
            self._waiting[j].append(KeyframeScan(j, track.last.number, t, offset, b.s, self._open_ends(scan), eye))
        self._stamp[j], self._driven[j] = t, np.hypot(*track.step[:2])
        self._now[j] = self._latest(j)
        return np.array(self._now[j])

    def deliver(self, j: int) -> int:
        """All that robot j has waiting reaches the team, and loops are looked for; returns how many keyframes came.

        A lost message is one that is not delivered: it waits for the next call.
        """
        came = 0
        for message in self._waiting[j]:
            if isinstance(message, Keyframe):
                self.loops.offer(self.team, self.team.add(message))
                came += 1
            else:
                self.scans.append(message)
                self._node.append(self.team.of[j][message.number])
        self._waiting[j] = []
        self.loops.step(self.team, j)
        self._now[j] = self._latest(j)
        return came

    def remove_robot(self, j: int) -> None:
        """Robot j is dead: what it had not delivered is gone; what it had stays."""
        self._waiting[j] = []
        self._gone[j] = True
        self._now[j] = self._latest(j)

    def waiting(self, j: int) -> int:
        """How many messages of robot j have not reached the team."""
        return len(self._waiting[j])

    def poses(self) -> Float[np.ndarray, "M 3"]:
        """Each robot's latest pose in `map`, its start before its first scan; of a dead one the last the team knows."""
        return self._now.copy()

    def optimise(self, *, force: bool = False) -> bool:
        """Whether the graph was solved anew: because a closure moved something, or it has grown enough, or by `force`.

        Closures that contradict the rest are dropped on the way. After it `poses` may jump.
        """
        team = self.team
        if not len(team) or not (force or team.due or team.grown):
            return False
        self._solve()
        return True

    @property
    def closures(self) -> tuple[Closure, ...]:
        """Every closure tried, in order: `first` and `second` number the keyframes of `graph`."""
        return tuple(self.team.closures)

    @property
    def owner(self) -> Int[np.ndarray, " n"]:
        """(n,) the robot of each keyframe of `graph`."""
        return np.array([node.robot for node in self.team.nodes], dtype=np.int64)

    @property
    def stamp(self) -> Float[np.ndarray, " n"]:
        """(n,) when each keyframe of `graph` was taken [s]."""
        return np.array([node.t for node in self.team.nodes], dtype=float)

    def graph(self) -> PoseGraph:
        """The delivered keyframes in the order they came, their steps and the closures believed."""
        return self.team.graph()

    def covariances(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of every delivered keyframe's pose in `map`, over x, y, theta. Solves what is not solved yet."""
        if len(self.team) and (self.team.due or self.team.known < len(self.team)):
            self._solve()
        return self.team.covariances()

    def trajectory(self, j: int) -> Track:
        """Robot j's poses in `map` at the stamps of its scans that reached the team."""
        mine = [k for k, scan in enumerate(self.scans) if scan.robot == j]
        stamps = np.array([self.scans[k].t for k in mine], dtype=float)
        return Track(stamps, self.scan_poses()[mine].reshape(-1, 3))

    def grid(self, resolution: float, crew: int = 0) -> GridMap:
        """The merged map of a crew's delivered scans; kept between calls, only scans that moved are laid in anew.

        crew: by its first robot.
        """
        mapper, scans, poses = self.mapper(resolution, crew), self.scans, self.scan_poses()
        if self.team.crew.any():
            mine = np.flatnonzero(self.team.crew[[scan.robot for scan in scans]] == crew)
            scans, poses = [scans[k] for k in mine.tolist()], poses[mine]
        mapper.update(scans, poses)
        return mapper.grid()

    def mapper(self, resolution: float, crew: int = 0) -> OccupancyMapper:
        """What `grid` keeps at this resolution [m]."""
        return self._mapper.setdefault((resolution, crew), OccupancyMapper(resolution, self.cfg.map))

    def keyframe_map(self, j: int) -> KeyframeMap:
        """What robot j brings to a meeting, in its crew's map. The robot has delivered a keyframe."""
        of = self.team.of[j]
        return KeyframeMap(str(j + 1), self.team.pose[of], [self.team.nodes[i].beams.s for i in of])

    def in_view(self, a: int, b: int, transform: Float[np.ndarray, "3"]) -> tuple[int, int]:
        """How often a robot of the crews of a and b sees one of the other crew where `transform` has it, and how often
        it sees through that place.

        transform: of b's map in a's, (3,). Scans of one stamp are compared; walls between them hide robots.
        """
        crew, pose = self.team.crew, self.scan_poses()
        rows: tuple[dict[float, list[int]], ...] = ({}, {})
        for n, scan in enumerate(self.scans):
            for side, j in enumerate((a, b)):
                if crew[scan.robot] == crew[j]:
                    rows[side].setdefault(scan.t, []).append(n)
        seen = through = 0
        for t in rows[0].keys() & rows[1].keys():
            for n in rows[0][t]:
                for m in rows[1][t]:
                    other = se2.compose(transform, pose[m])
                    for scan, at in (
                        (self.scans[n], se2.between(pose[n], other)),
                        (self.scans[m], se2.between(other, pose[n])),
                    ):
                        told = self._sees(scan, at[:2])
                        seen, through = seen + (told > 0), through + (told < 0)
        return seen, through

    def _sees(self, scan: KeyframeScan, place: Float[np.ndarray, "2"]) -> int:
        """1 where a scan ends at a robot at `place` in its frame, -1 where it goes on behind it, else 0."""
        reach = float(np.hypot(*(place - scan.origin)))
        if not VIEW_NEAR < reach < VIEW_FAR:
            return 0
        ends = []
        for points in (scan.points, scan.ends):
            u = points - scan.origin
            off = np.abs(se2.wrap_angle(np.arctan2(u[:, 1], u[:, 0]) - np.arctan2(*(place - scan.origin)[::-1])))
            ends.append(np.hypot(u[:, 0], u[:, 1])[off * reach < VIEW_HALF])
        r = np.concatenate(ends)
        if len(r) < VIEW_BEAMS:
            return 0
        return -1 if r.min() > reach + VIEW_BEHIND else 1 if abs(float(np.median(r)) - reach) < self.cfg.teammate else 0

    def meet(self, a: int, b: int, merge: Merge) -> None:
        """The crews of robots a and b have one map, which hangs on the first robot of both, as a `merge` of these says.

        Where the two crews were in the same place their keyframes are matched, and what one saw of the other's robots
        is no wall any more.
        """
        if self.team.crew[a] > self.team.crew[b]:
            a, b, merge = b, a, swapped(merge)
        T, P = merge.transform, merge.covariance
        if T is None or P is None:
            raise ValueError(f"robots {a} and {b} are not merged: {merge.reason}")
        team, (into, crew) = self.team, self.team.crew[[a, b]].tolist()
        mine, others = (np.flatnonzero(team.crew == c) for c in (crew, into))
        held = [c for c in merge.closures if c.accepted]
        k, i = (team.of[j][n] for j, n in ((a, held[len(held) // 2].first), (b, held[len(held) // 2].second)))
        A = adjoint(se2.inverse(team.pose[i]))
        P = symmetrise(A @ P @ A.T)
        team.meet(into, crew, T)
        self._now[mine] = se2.compose(T, self._now[mine])
        measured = np.asarray(se2.between(team.pose[k], team.pose[i]))
        tie = Matched(True, merge.reason, measured, symmetrise(np.linalg.inv(P)), np.zeros(3), merge.alike or 0.0, 0.0)
        team.close(k, i, tie)
        self._solve()
        self._without(mine, others)
        self._without(others, mine)
        self.loops.meet(team, mine, others)
        self._solve()
        self._mapper = {key: mapper for key, mapper in self._mapper.items() if key[1] not in {into, crew}}

    def scan_poses(self) -> Float[np.ndarray, "n 3"]:
        """Where each delivered scan was taken, in `map`."""
        new = [scan.offset for scan in self.scans[len(self._offset) :]]
        self._offset = np.concatenate([self._offset, np.reshape(new, (-1, 3))])
        return np.asarray(se2.compose(self.team.pose[self._node], self._offset))

    def _solve(self) -> None:
        self.team.solve()
        self._now = np.array([self._latest(j) for j in range(len(self.tracks))])

    def _latest(self, j: int) -> np.ndarray:
        """The robot's own trajectory, put onto its last keyframe that the team has."""
        of, local = self.team.of[j], self.tracks[j].local
        if not of:
            return np.array(se2.compose(self.starts[j], local))
        if self._gone[j]:
            return np.array(self.team.pose[of[-1]])
        return np.array(se2.compose(self.team.pose[of[-1]], se2.between(self.team.nodes[of[-1]].local, local)))

    def _without(self, mine: Int[np.ndarray, " m"], others: Int[np.ndarray, " k"]) -> None:
        """What robots `mine` saw of the `others` while they did not know of them leaves their scans and keyframes."""
        pose, at = self.scan_poses(), dict[float, list[np.ndarray]]()
        for scan, place in zip(self.scans, pose, strict=True):
            if scan.robot in others:
                at.setdefault(scan.t, []).append(place[:2])
        for n, (scan, place) in enumerate(zip(self.scans, pose, strict=True)):
            if scan.robot in mine and scan.t in at:
                kept = self._far(scan.points, se2.act(se2.inverse(place), np.array(at[scan.t])), self.cfg.teammate)
                self.scans[n] = scan._replace(points=scan.points[kept])
        for i, node in enumerate(self.team.nodes):
            if node.robot in mine and node.t in at:
                there = se2.act(se2.inverse(self.team.pose[i]), np.array(at[node.t]))
                kept = self._far(node.beams.s, there, self.cfg.teammate)
                self.team.nodes[i] = node._replace(beams=Beams(*(rows[kept] for rows in node.beams)))

    def _open_ends(self, scan: Scan) -> np.ndarray:
        """(m, 2) how far the beams that did not come back are free, in the robot frame [m]."""
        far = OPEN_SHARE * min(scan.range_max, self.cfg.beams.greatest_range)
        silent = ~scan.hit & (scan.ranges >= scan.range_max)
        angle = scan.angles()[silent]
        ends = far * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.asarray(se2.act(scan.T_robot_sensor, ends))

    def _without_teammates(self, j: int, t: float, b: Beams, scan: Scan) -> Beams:
        """The returns that are not from another robot, wherever it may have gone since it was last heard of."""
        others = np.flatnonzero((self.team.crew == self.team.crew[j]) & (np.arange(len(self.tracks)) != j))
        if not len(others) or not len(b.q):
            return b
        track = self.tracks[j]
        here = se2.compose(self._now[j], se2.between(track.local, track.predict(scan)))
        at = se2.act(se2.inverse(here), self._now[others, :2])
        reach = self.cfg.teammate + np.where(self._stamp[others] < t, self._driven[others], 0.0)
        kept = self._far(b.s, at, reach)
        return b if kept.all() else Beams(*(a[kept] for a in b))

    @staticmethod
    def _far(
        points: Float[np.ndarray, "n 2"], robots: Float[np.ndarray, "k 2"], reach: float | Float[np.ndarray, " k"]
    ) -> Bool[np.ndarray, " n"]:
        """Which points lie farther than `reach` [m] from every one of the robots."""
        return np.asarray((np.hypot(*(points[:, None] - robots).transpose(2, 0, 1)) >= reach).all(axis=1))
