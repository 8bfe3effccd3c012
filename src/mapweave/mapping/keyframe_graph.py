"""The pose graph of one robot or a team as it grows: keyframes come in, closures tie them, solving moves them."""

from bisect import bisect_left
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.config import config
from ..laser.closures import Closure, Matched, Place
from ..laser.keyframes import Keyframe, KeyframeConfig, carried
from ..laser.pose_graph import PoseGraph, Solved, edge_factor, problem
from ..laser.robust_graph import CONTRADICTION, RobustGraphConfig, solve_graph
from .places import PlaceMatch
from .segments import FADED, GAP, REFUSED, SLID, SLID_HELD, WEAK_XY, WHEELED, border_covariance

PLACE_AROUND = 5  # keyframes on either side of the old one that its local map is made of
PLACE_WITHIN = 4.0  # [m] from the old keyframe that they stand at most
CLOSURE_KERNEL = 3.0  # [sd] width of the robust kernel
JITTER_XY = 0.002  # [m] sd of every keyframe's place, which no step inherits
JITTER_TURN = 0.001  # [rad] sd of its heading
RESOLVE_LEAST = 8  # new keyframes from which on the graph is solved anew, at least

OUTWEIGHED = 3  # places that hold without a step and not with it: then it is the step that is wrong
SLIPPED = 1.0  # sd, of a step over a border, that steps in a row may be wrong by: farther, the places are wrong
ALONE = 5  # keyframes between two such rows, at least
SLIPPERY = 0.05  # of the steps that wheels contradict: of more they tell nothing
LOST = 10  # places more that hold without a step for each that held with it and does not any more
NEAR, RIVALS = 3.0, 30  # sd of a step over a gap that places there may lie from it; times as many elsewhere
DENIED = 10  # places that agree over views that faded, and none where the wheels say: it was carried
SELDOM = 0.02  # of the keyframes must be new before it is decided again which places hold, however far those move it
ANEW = 1.25  # times the keyframes there were when all places were asked last: then all are asked anew,
ASKED = 10_000  # of those that did not hold before at most, which lie least far from what the others say
ELSEWHERE = "it lies elsewhere than what came after the border"
UNDECIDED = "found, and not decided on yet"
CARRIED = 16.0  # squared sd by which the places that hold contradict a step over a border that tells nothing, and
LOOSE = np.diag([1e4, 1e4, 10.0])  # [m^2, rad^2] covariance that such a step has: the robot was carried
START_SD = (0.01, 0.01, 0.0087)  # [m, m, rad] of the starts of all robots but the first, which `map` hangs on
EXACT = 1e-4  # [m, rad] sd of the start that `map` hangs on
UNTOLD = 1e3  # [m, rad] sd of a start that nobody told: places alone hold its robot


@config
class KeyframeGraphConfig:
    """How keyframes come about, and when their graph is solved anew."""

    resolve_share: float = 0.02  # share of new keyframes from which on the graph is solved anew
    keyframes: KeyframeConfig = KeyframeConfig()


class KeyframeGraph:
    """nodes: the keyframes in the order they came; pose: (n, 3) of each in `map`; of: each robot's, by number;
    contradicted: the keyframes whose step places contradict, which is not believed then; wheeled: those of them where
    wheels tell what places do; loose: those after a border whose step tells nothing, the robot having been carried;
    carried: those of them that views tell; unclear: those after one that fit elsewhere about as well; crew: (M,) of
    each robot the first of those that share its frame; `apart`: each has one of its own until it `meet`s.
    """

    def __init__(self, cfg: KeyframeGraphConfig, starts: Float[np.ndarray, "M 3"], *, apart: bool = False) -> None:
        self.cfg, self.starts = cfg, starts
        self.crew = np.arange(len(starts)) if apart else np.zeros(len(starts), dtype=np.int64)
        self.start_sd = np.full((len(starts), 3), EXACT)
        if not apart:
            self.start_sd[1:] = START_SD
        self.contradicted: frozenset[int] = frozenset()
        self.wheeled: frozenset[int] = frozenset()
        self.loose: frozenset[int] = frozenset()
        self.carried: frozenset[int] = frozenset()
        self.unclear: tuple[int, ...] = ()
        self.nodes: list[Keyframe] = []
        self.pose = np.zeros((0, 3))
        self.of: list[list[int]] = [[] for _ in starts]
        self.robot = np.zeros(0, dtype=np.int64)  # (n,) whose each is
        self.path = np.zeros(0)  # (n,) [m] driven up to each
        self.closures: list[Closure] = []
        self.solved: Solved | None = None
        self.due = False  # a closure says that poses are elsewhere
        self._settled = 0  # how many keyframes there were when it was decided last which closures hold, and
        self._asked = 0  # when those were asked, too, that did not hold before
        self._since: list[np.ndarray] = []  # covariance of each seen from its robot's last solved one before it

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def known(self) -> int:
        """How many keyframes the last solution holds."""
        return 0 if self.solved is None else len(self.solved)

    def add(self, new: Keyframe) -> int:
        """The number of the new keyframe; it stands where its step puts it."""
        of = self.of[new.robot]
        pose, since = self.starts[new.robot], np.zeros((3, 3))
        if of:
            pose = se2.compose(self.pose[of[-1]], new.step)
            before = np.zeros((3, 3)) if of[-1] < self.known else self._since[of[-1]]
            since = carried(before, new.step) + new.cov
        of.append(len(self.nodes))
        self.nodes.append(new._replace(number=len(of) - 1))
        self._since.append(since)
        self.pose = np.concatenate([self.pose, np.asarray(pose)[None]])
        self.robot, self.path = np.append(self.robot, new.robot), np.append(self.path, new.path)
        return of[-1]

    def copy(self) -> "KeyframeGraph":
        """The same graph, which may grow and be solved without this one's knowing."""
        other = KeyframeGraph(self.cfg, np.array(self.starts))
        other.crew, other.start_sd = np.array(self.crew), np.array(self.start_sd)
        other.contradicted, other.wheeled = self.contradicted, self.wheeled
        other.loose, other.carried = self.loose, self.carried
        other.nodes, other.closures, other._since = list(self.nodes), list(self.closures), list(self._since)
        other.of = [list(of) for of in self.of]
        other.pose, other.robot, other.path = np.array(self.pose), self.robot, self.path
        other._settled, other._asked = self._settled, self._asked
        other.due, other.solved = self.due, None if self.solved is None else self.solved.copy()
        return other

    @property
    def undecided(self) -> bool:
        """Whether places were found since it was decided which hold."""
        return bool(self.closures) and self.closures[-1].reason == UNDECIDED

    @property
    def grown(self) -> bool:
        """Whether enough keyframes came since the last solution, or a robot's first one, for a new one."""
        fresh = len(self) - self.known
        enough = fresh >= max(RESOLVE_LEAST, self.cfg.resolve_share * len(self))
        return enough or any(of and of[0] >= self.known for of in self.of)

    @property
    def settled(self) -> bool:
        """Whether it was decided a few keyframes ago which closures hold."""
        return len(self) - self._settled < max(RESOLVE_LEAST, SELDOM * len(self))

    def anchor(self, i: int) -> int | None:
        """The last solved keyframe of the robot of keyframe `i`, up to `i`."""
        of, number = self.of[self.nodes[i].robot], self.nodes[i].number
        solved = min(bisect_left(of, self.known), number + 1)
        return of[solved - 1] if solved else None

    def relative(self, k: int, i: int) -> Float[np.ndarray, "3 3"] | None:
        """Covariance of keyframe `i` seen from the solved keyframe `k`, in i's frame; None when i has no anchor."""
        a = self.anchor(i)
        if a is None or k >= self.known or self.solved is None:
            return None
        C = self.solved.relative(k, a)
        C = se2.turned_covariance(-(self.pose[a, 2] - self.pose[k, 2]), C)
        return C if i == a else np.asarray(carried(C, se2.between(self.pose[a], self.pose[i])) + self._since[i])

    def marginal(self, i: int) -> Float[np.ndarray, "3 3"]:
        """Covariance of keyframe `i` over x, y, theta in `map`: that of its anchor, carried along the steps since."""
        a = self.anchor(i)
        if a is None or self.solved is None:
            return np.asarray(se2.turned_covariance(self.pose[i, 2], self._since[i])) + EXACT**2 * np.eye(3)
        C = self.solved.marginal(a)
        if i == a:
            return C
        C = carried(se2.turned_covariance(-self.pose[a, 2], C), se2.between(self.pose[a], self.pose[i]))
        return np.asarray(se2.turned_covariance(self.pose[i, 2], C + self._since[i]))

    def prepare(self, keyframes: list[int]) -> None:
        """What `relative` and `marginal` need of these solved keyframes is worked out in one go."""
        if self.solved is not None:
            self.solved.prepare(keyframes)

    def leave(self, first: int, last: int) -> int:
        """Keyframes `first` to `last` leave, with their closures, of which the number is returned.

        The step to the keyframe after them is theirs and its own one after the other; those after them are numbered
        anew. The graph is of one robot, keyframe 0 stays, and so does the last; it has to be solved again.
        """
        after = self.nodes[last + 1]
        step, cov = np.zeros(3), np.zeros((3, 3))
        wheels: np.ndarray | None = np.zeros(3)
        for node in self.nodes[first : last + 2]:
            step, cov = np.asarray(se2.compose(step, node.step)), carried(cov, node.step) + node.cov
            wheels = None if wheels is None or node.wheels is None else np.asarray(se2.compose(wheels, node.wheels))
        border = next((node.border for node in self.nodes[first : last + 2] if node.border), "")
        rest = [after._replace(step=step, cov=cov, border=border, wheels=wheels), *self.nodes[last + 2 :]]
        self.nodes = self.nodes[:first] + [node._replace(number=first + k) for k, node in enumerate(rest)]
        self.of = [list(range(len(self.nodes)))]
        kept = np.delete(np.arange(len(self.pose)), np.arange(first, last + 1))
        self.pose, self.robot, self.path = self.pose[kept], self.robot[kept], self.path[kept]
        self._since = [self._since[k] for k in kept.tolist()]
        number = np.searchsorted(kept, np.arange(kept[-1] + 1)).tolist()
        self.contradicted, self.wheeled, self.loose = (
            frozenset(number[i] for i in of) for of in (self.contradicted, self.wheeled, self.loose)
        )
        leaving = range(first, last + 1)
        before = len(self.closures)
        self.closures = [
            replace(c, first=number[c.first], second=number[c.second])
            for c in self.closures
            if c.first not in leaving and c.second not in leaving
        ]
        self.solved, self.due = None, True
        return before - len(self.closures)

    def place(self, k: int) -> Place:
        """Keyframe `k` and those its robot made before and after it, in its frame."""
        node = self.nodes[k]
        of = self.of[node.robot]
        near = of[max(0, node.number - PLACE_AROUND) : node.number + PLACE_AROUND + 1]
        rel = se2.between(self.pose[k], self.pose[near])
        inside = np.hypot(rel[:, 0], rel[:, 1]) <= PLACE_WITHIN
        return Place([(self.nodes[m].beams, rel[p]) for p, m in enumerate(near) if inside[p]])

    def close(self, k: int, i: int, match: Matched) -> None:
        """The closure is on record and, when accepted, in the graph."""
        robots = (self.nodes[k].robot, self.nodes[i].robot)
        self.closures.append(Closure(robots, k, i, *match))

    def tie(self, first: int, second: int, match: PlaceMatch) -> None:
        """Keyframe `second` seen from keyframe `first`, as places were found; it holds once `settle` says so."""
        innovation = se2.between(se2.between(self.pose[first], self.pose[second]), match.measured)
        robots = (self.nodes[first].robot, self.nodes[second].robot)
        second_score = match.ratio * match.score
        z, information = match.measured, match.information
        found = Matched(False, UNDECIDED, z, information, innovation, match.share, None, match.score, second_score)
        self.closures.append(Closure(robots, first, second, *found))

    def meet(self, into: int, crew: int, T: Float[np.ndarray, "3"]) -> None:
        """The robots of `crew`, whose frame lies at T in that of the crew `into`, are in that from now on.

        Nothing holds them there until a closure does.
        """
        mine = np.flatnonzero(self.crew == crew)
        nodes = np.isin(self.robot, mine)
        self.pose[nodes] = se2.compose(T, self.pose[nodes])
        self.starts[mine] = se2.compose(T, self.starts[mine])
        self.start_sd[mine] = UNTOLD
        self.crew[mine] = into
        self.due = True

    def edges(self, *, tried: bool = False) -> tuple[PoseGraph, PoseGraph]:
        """Steps and accepted closures, or all that were `tried`, over the same poses."""
        steps = [(of[n - 1], of[n]) for of in self.of for n in range(1, len(of))]
        steps.sort(key=lambda pair: pair[1])
        told = [self._step(i) for _, i in steps]
        covs = np.array([cov for _, cov in told]).reshape(-1, 3, 3)
        accepted = [c for c in self.closures if c.accepted or (tried and not c.reason.startswith(ELSEWHERE))]
        return (
            PoseGraph.of(self.pose, steps, [step for step, _ in told], list(np.linalg.inv(covs))),
            PoseGraph.of(
                self.pose,
                [(c.first, c.second) for c in accepted],
                [c.measured for c in accepted],
                [c.information for c in accepted],
            ),
        )

    def _step(self, i: int) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """The step to keyframe `i` as it is believed, and its covariance."""
        node = self.nodes[i]
        if i in self.wheeled and node.wheels is not None:
            return node.wheels, border_covariance(node.wheels, FADED)
        loose = LOOSE if i in self.loose else node.cov
        return node.step, border_covariance(node.step) if i in self.contradicted else loose

    def wheels_lead_to(self, i: int) -> bool:
        """Whether the step to keyframe `i` is the wheels', not the scans'."""
        node = self.nodes[i]
        if i in self.wheeled or node.border != FADED or node.wheels is None:
            return i in self.wheeled
        return np.array_equal(node.step, node.wheels)

    def solve(self) -> None:
        """All poses at the optimum; closures that contradict the rest there are dropped, one after the other."""
        while True:
            steps, closed = self.edges()
            first = [of[0] for of in self.of if of]
            robots = [self.nodes[i].robot for i in first]
            starts = (np.array(first), self.starts[robots], self.start_sd[robots])
            self.solved = Solved.of(problem(steps, closed, starts, CLOSURE_KERNEL))
            self.pose = np.array(self.solved.pose)
            if not self._drop_worst(closed):
                break
        self.due = False
        self.solved.prepare([of[-1] for of in self.of if of])

    def settle(self, *, for_now: bool = False) -> None:
        """Which closures hold is decided anew, all together, and the poses are at the optimum of those.

        Where every closure agrees with the optimum of all there is nothing to decide; else by graduated non-convexity:
        each is doubtful until others agree with it. Where many hold but for a step or two, those are not believed.

        for_now: more keyframes will come. Then all steps are believed, and until the graph has grown by a quarter
        closures that did not hold before are not asked; they hold again where they fit what the others say. So that
        work does not grow with the square of the way, no more than `ASKED` of them are asked at all.
        """
        self._decide(for_now=for_now)
        faded = [] if for_now else self._denied()
        if not faded:
            return
        nodes, closures, pose = self.nodes, self.closures, self.pose
        self.nodes = [_refused_at(node) if i in faded else node for i, node in enumerate(nodes)]
        self._decide(for_now=False)
        over = [c for c in self.closures if c.accepted and any(_over(c, k) for k in faded)]
        if len(over) < DENIED:
            self.nodes, self.closures, self.pose = nodes, closures, pose
            self._decide(for_now=False)

    def _denied(self) -> list[int]:
        """The keyframes after views that faded over which many places were found and none holds: it was carried."""
        if len(self.of) > 1:
            return []
        cuts = [i for i, node in enumerate(self.nodes) if i and node.border == FADED]
        found = [(c.accepted, k) for k in cuts for c in self.closures if _over(c, k)]
        held = {k for accepted, k in found if accepted}
        return [k for k in cuts if k not in held and len([None for _, of in found if of == k]) >= DENIED]

    def _decide(self, *, for_now: bool) -> None:
        """As `settle`, wheels being believed where they lead on."""
        self.contradicted, self.wheeled, self.loose = frozenset(), frozenset(), self.carried
        self._settled = len(self)
        every = not for_now or len(self) >= ANEW * self._asked
        self._asked = len(self) if every else self._asked
        self._leave_rivals()
        before = self.closures
        steps, tried = self.edges(tried=True)
        if not tried.edges:
            self.solve()
            return
        graph = steps.joined(tried)
        doubtful = np.arange(graph.edges) >= steps.edges
        asked = [k for k, c in enumerate(before) if not c.reason.startswith(ELSEWHERE)]
        refused = [(before[k].nis or 0.0, n) for n, k in enumerate(asked) if _refused(before[k])]
        unasked = np.zeros(graph.edges, dtype=bool)
        unasked[[steps.edges + n for _, n in sorted(refused)[ASKED if every else 0 :]]] = True
        decided = solve_graph(graph, RobustGraphConfig(), doubtful=doubtful, unasked=unasked)
        for wrong in () if for_now else (self._slid_steps, self._contradicted_steps):
            dropped = frozenset(d.edge - steps.edges for d in decided.dropped)
            found = wrong(steps, tried, dropped, unasked[steps.edges :]) if len(dropped) >= OUTWEIGHED else frozenset()
            if found:
                self.contradicted |= found
                steps, _ = self.edges()
                decided = solve_graph(steps.joined(tried), RobustGraphConfig(), doubtful=doubtful, unasked=unasked)
        why = {d.edge - steps.edges: d.reason for d in decided.dropped}
        nis = decided.nis[steps.edges :]
        self.closures = list(before)
        for n, k in enumerate(asked):
            c, reason = before[k], why.get(n) or _agrees(before[k].share, float(nis[n]))
            self.closures[k] = replace(c, accepted=n not in why, nis=float(nis[n]), reason=reason)
        self.pose = np.array(decided.graph.pose)
        self.solve()
        if self._hold_alone():
            self.solve()
        while (elsewhere := self._carried()) is not None:
            self.loose |= {elsewhere}
            self.solve()

    def _hold_alone(self) -> bool:
        """Segments that no place holds are held by the one that lies where the steps over their borders may lead.

        Nothing but such a step contradicts it, from which it is told how far it lies. Returns whether there are any.
        """
        if len(self.of) > 1:
            return False
        cuts = [i for i, node in enumerate(self.nodes) if i and node.border]
        ends = np.array([(c.first, c.second) for c in self.closures], dtype=np.int64).reshape(-1, 2)
        low, high = np.searchsorted(np.array(cuts, dtype=np.int64), np.sort(ends, axis=1), side="right").T
        held = {s for k, c in enumerate(self.closures) if c.accepted and low[k] < high[k] for s in (low[k], high[k])}
        found = False
        for n, c in enumerate(self.closures):
            if c.accepted or low[n] + 1 != high[n] or c.reason.startswith(ELSEWHERE) or {low[n], high[n]} <= held:
                continue
            off = se2.between(se2.between(self.pose[c.first], self.pose[c.second]), c.measured)
            nis = float(off @ np.linalg.solve(self.nodes[cuts[low[n]]].cov, off))
            if nis <= NEAR**2:
                self.closures[n] = replace(c, accepted=True, nis=nis, reason=_agrees(c.share, nis))
                held |= {low[n], high[n]}
                found = True
        return found

    def _carried(self) -> int | None:
        """The keyframe after a border whose step the places that hold contradict most; first where nothing matched.

        Between places that hold on both sides of a border only scans that nothing ties hang on its step: they go with
        the side that they were seen from. A gap's step is the wheels', which are asked elsewhere.
        """
        steps, _ = self.edges()
        squares = edge_factor(steps, "steps").squares(self.pose.ravel())
        why = [self.nodes[i].border for i in steps.second.tolist()]
        asked = [(border == REFUSED, sq, k) for k, (border, sq) in enumerate(zip(why, squares.tolist(), strict=True))]
        worst = max((row for row in asked if why[row[2]] not in {"", *WHEELED} and row[1] > CARRIED), default=None)
        return None if worst is None else int(steps.second[worst[2]])

    def _leave_rivals(self) -> None:
        """Places over a gap that lie elsewhere than the wheels say are left out where others lie there.

        In a building that looks alike in several places many more may agree on another than on the right one; so they
        must be `RIVALS` times as many. Where nothing lies where the wheels say (the robot was carried), all count.
        """
        cuts = [i for i, node in enumerate(self.nodes) if i and node.border]
        if not cuts or len(self.of) > 1:
            return
        segment = np.searchsorted(np.array(cuts), np.arange(len(self.nodes)), side="right")
        over: dict[int, list[tuple[int, bool]]] = {}
        for n, c in enumerate(self.closures):
            low, high = sorted((c.first, c.second))
            if segment[high] != segment[low] + 1:
                continue
            k = cuts[int(segment[low])]
            if self.nodes[k].border != GAP:
                continue
            measured = c.measured if c.first == low else se2.inverse(c.measured)
            ahead = se2.compose(se2.between(self.pose[k - 1], self.pose[low]), measured)
            step = se2.compose(ahead, se2.between(self.pose[high], self.pose[k]))
            e = se2.between(self.nodes[k].step, step)
            over.setdefault(k, []).append((n, bool(e @ np.linalg.solve(self.nodes[k].cov, e) <= NEAR**2)))
        for found in over.values():
            there = [n for n, near in found if near]
            if len(there) < OUTWEIGHED or len(found) - len(there) > RIVALS * len(there):
                there = [n for n, _ in found]
            for n, _ in found:
                c = self.closures[n]
                if n not in there:
                    reason = f"{ELSEWHERE}, which {len(there)} places put where the wheels do"
                    self.closures[n] = replace(c, accepted=False, reason=reason)
                elif c.reason.startswith(ELSEWHERE):
                    self.closures[n] = replace(c, reason=UNDECIDED)

    def _slid_steps(
        self, steps: PoseGraph, tried: PoseGraph, dropped: frozenset[int], unasked: Bool[np.ndarray, " t"]
    ) -> frozenset[int]:
        """The keyframes whose steps wheels tell otherwise than scans, and the places as the wheels: the scans slid.

        With the wheels' steps `OUTWEIGHED` more places hold, and these are `wheeled` from now on; else there are none.
        dropped, unasked: as of `_contradicted_steps`.
        """
        wheels = [(k, node.wheels) for k, i in enumerate(steps.second.tolist()) if not (node := self.nodes[i]).border]
        told = PoseGraph.of(
            steps.pose,
            [(int(steps.first[k]), int(steps.second[k])) for k, step in wheels if step is not None],
            [step for _, step in wheels if step is not None],
            [np.linalg.inv(border_covariance(step, FADED)) for _, step in wheels if step is not None],
        )
        rows = np.array([k for k, step in wheels if step is not None], dtype=np.int64)
        off = se2.between(told.measured, steps.measured[rows])
        far = np.flatnonzero(np.einsum("ki,kij,kj->k", off, told.information, off) > CONTRADICTION)
        if not 0 < len(far) <= SLIPPERY * len(rows):
            return frozenset()
        rows = rows[far]
        weak = np.array([np.linalg.inv(border_covariance(step)) for step in steps.measured[rows]])
        ends = steps.first[rows], steps.second[rows]
        sure = steps.joined(PoseGraph(steps.pose, *ends, steps.measured[rows], weak))
        both = sure.joined(PoseGraph(steps.pose, *ends, told.measured[far], told.information[far]))
        doubtful = np.arange(both.edges + tried.edges) >= sure.edges
        doubtful[rows] = True
        out = np.concatenate([np.zeros(both.edges, dtype=bool), unasked])
        decided = solve_graph(both.joined(tried), RobustGraphConfig(), doubtful=doubtful, unasked=out)
        slid = ~decided.used[rows] & decided.used[sure.edges : both.edges]
        gained = len(dropped) - int((~decided.used[both.edges :]).sum())
        self.wheeled = frozenset(steps.second[rows[slid]].tolist() if gained >= OUTWEIGHED else [])
        return self.wheeled

    def _contradicted_steps(
        self, steps: PoseGraph, tried: PoseGraph, dropped: frozenset[int], unasked: Bool[np.ndarray, " t"]
    ) -> frozenset[int]:
        """The keyframes whose steps are wrong where without them `OUTWEIGHED` more places a step hold; else none.

        Of places that held all must hold still, but for one in `LOST`, and such a step be wrong by little, and alone:
        in a building that looks alike in several places, steps all along would have to be wrong, by metres. One of them
        may be by metres where a score of places more hold: there the robot slid.

        dropped: which places do not hold as long as every step does; unasked: (t,) which are not asked. Over each step
        lies a weak one that holds always.
        """
        weak = np.array([np.linalg.inv(border_covariance(step)) for step in steps.measured])
        sure = [k for k, i in enumerate(steps.second.tolist()) if not (self.nodes[i].border or i in self.wheeled)]
        both = PoseGraph(steps.pose, steps.first, steps.second, steps.measured, weak).joined(
            PoseGraph(steps.pose, steps.first[sure], steps.second[sure], steps.measured[sure], steps.information[sure])
        )
        graph = both.joined(tried)
        doubtful = np.arange(graph.edges) >= steps.edges
        out = np.concatenate([np.zeros(both.edges, dtype=bool), unasked])
        decided = solve_graph(graph, RobustGraphConfig(), doubtful=doubtful, unasked=out)
        gone = [d.edge for d in decided.dropped]
        wrong = [sure[k - steps.edges] for k in gone if k < both.edges]
        gained = len(dropped) - (len(gone) - len(wrong))
        lost = {k - both.edges for k in gone if k >= both.edges} - dropped
        runs = np.split(np.array(wrong, dtype=np.int64), np.flatnonzero(np.diff(wrong) >= ALONE) + 1)
        if not wrong or LOST * len(lost) > gained or gained < OUTWEIGHED * len(runs):
            return frozenset()
        *less, most = sorted(float(np.sqrt(decided.nis[run]).sum()) for run in runs)
        far = SLID / WEAK_XY if gained >= SLID_HELD else SLIPPED
        if most > far or any(one > SLIPPED for one in less):
            return frozenset()
        return frozenset(int(steps.second[k]) for k in wrong)

    def covariances(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of every keyframe's pose in `map`, over x, y, theta; what is not solved yet is solved for it."""
        if not len(self):
            return np.zeros((0, 3, 3))
        if self.due or self.known < len(self) or self.solved is None:
            self.solve()
        assert self.solved is not None  # noqa: S101  (solving makes it)
        return np.asarray(self.solved.covariances() + self.jitter)

    @property
    def jitter(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of a single scan's match, which no step tells."""
        return np.diag(np.square([JITTER_XY, JITTER_XY, JITTER_TURN]))

    def graph(self) -> PoseGraph:
        """Keyframes, steps and accepted closures."""
        steps, closed = self.edges()
        return steps.joined(closed)

    def _drop_worst(self, closed: PoseGraph) -> bool:
        if not closed.edges:
            return False
        squares = edge_factor(closed, "closures").squares(self.pose.ravel())
        worst = int(np.argmax(squares))
        if squares[worst] <= CONTRADICTION:
            return False
        at = [p for p, c in enumerate(self.closures) if c.accepted][worst]
        reason = f"it contradicts the other measurements by {np.sqrt(squares[worst]):.1f} standard deviations"
        self.closures[at] = replace(self.closures[at], accepted=False, reason=reason)
        return True


def _over(closure: Closure, k: int) -> bool:
    """Whether it lies over the border before keyframe `k`."""
    return (closure.first < k) != (closure.second < k)


def _refused_at(node: Keyframe) -> Keyframe:
    """The keyframe, after a border of which nothing is known."""
    return node._replace(border=REFUSED, cov=border_covariance(node.step))


def _refused(closure: Closure) -> bool:
    """Whether it was decided that it does not hold."""
    return not closure.accepted and closure.reason != UNDECIDED


def _agrees(share: float, nis: float) -> str:
    return f"{100 * share:.0f} % of the points lie on walls, {np.sqrt(nis):.1f} standard deviations from the rest"
