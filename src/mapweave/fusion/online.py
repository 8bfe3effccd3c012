"""Fusing while the robots drive: a fresher version of a robot's map takes the place of its older one.

How maps are named, which are refused and how far each covariance is trusted is judged by `fuse` over all maps, when
they rest on a quarter more sightings, or when one of them is doubted. In between a fresher map, another landmark and
another robot are put into the sum of what they are tied to (`InformationSum`): a robot is tied in, and a landmark
doubted, by the very tests of `fuse`, but of what has changed alone.

The sum eliminates each map's frame and scale. What ties two robots is landmarks alone: given these, every map's frame
and scale follow from it by itself, so that the system to be solved grows with landmarks and not with robots, and a
newer map takes the place of its older one: nothing counts twice.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.errors import EstimateError
from ..core.gaussian import solve_psd, symmetrise
from ..core.names import in_order
from ..landmarks.landmark_map import LandmarkMap, LocalMap
from .cluster import ENOUGH
from .config import JUDGE_AGAIN, FuseConfig
from .full_covariance import MapTerm
from .initial_frames import (
    Consensus,
    Entries,
    Outlier,
    PlaceTest,
    absorbed,
    find_contradicting,
    find_outliers,
    place_in,
)
from .join import fuse, outlier_findings, unsound
from .result import APART, Component, Decision, Fusion

NEAR = 1e-4  # [m], [rad], and of scales: so far the estimate may move from where a part was taken; its square is left
ROUNDS = 30  # of taking parts anew, at most


@dataclass(frozen=True, slots=True)
class InformationTerm:
    """What one map tells of its m landmarks, taken at its frame, scale and landmarks `at` (4 + 2m,).

    S (2m, 2m), s (2m,): information over its landmarks and that times their place; given these at p its frame and scale
    are `c - G p`, with covariance C. Of the map that is the gauge the frame is fixed, and the scale alone follows.
    """

    term: MapTerm
    at: Float[np.ndarray, " d"]
    S: Float[np.ndarray, "m m"]
    s: Float[np.ndarray, " m"]
    C: Float[np.ndarray, "e e"]
    G: Float[np.ndarray, "e m"]
    c: Float[np.ndarray, " e"]

    @classmethod
    def of(cls, term: MapTerm, at: Float[np.ndarray, " d"], scale_sigma: float, *, gauge: bool) -> "InformationTerm":
        """scale_sigma: the deviation of the scale from 1 a priori."""
        first = 3 if gauge else 0
        H, g = (part[0] for part in term.normal(at))
        eta = H[:, first:] @ at[first:] - g
        H[3, 3] += scale_sigma**-2
        eta[3] += scale_sigma**-2
        C = solve_psd(H[first:4, first:4], np.eye(4 - first))
        G, c = C @ H[first:4, 4:], C @ eta[first:4]
        return cls(term, at, H[4:, 4:] - H[4:, first:4] @ G, eta[4:] - H[4:, first:4] @ c, C, G, c)

    def placed(self, points: Float[np.ndarray, " m"]) -> Float[np.ndarray, " d"]:
        """Frame, scale and landmarks where its landmarks are at `points`."""
        own = self.at.copy()
        own[4 - len(self.c) : 4] = self.c - self.G @ points
        own[4:] = points
        return own


@dataclass(frozen=True, slots=True)
class InformationSum:
    """Maps that are tied, as one Gaussian over the landmarks of all, in the first pose of the lowest-numbered robot.

    maps: robot -> its map, named as in the component; factors: what its covariance is multiplied by; widened[robot]
    [landmark]: variance added to one that is doubted [m^2]; floor [m]: independent error of every landmark of every
    map; own: robot -> frame x, y, theta and scale; places: of every landmark [m].
    """

    maps: Mapping[str, LandmarkMap]
    factors: Mapping[str, float]
    own: Mapping[str, Float[np.ndarray, "4"]]
    places: Mapping[str, Float[np.ndarray, "2"]]
    scale_sigma: float
    floor: float
    widened: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    terms: Mapping[str, InformationTerm] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        component: Component,
        maps: Mapping[str, LandmarkMap],
        factors: Mapping[str, float],
        scale_sigma: float,
        floor: float,
    ) -> "InformationSum":
        """The sum of `maps` (a robot of the component each, named as in its map), started where the component lies."""
        own = {r: np.append(frame, component.scales.get(r, 1.0)) for r, frame in component.frames.items()}
        places = dict(zip(component.map.ids, component.map.mean, strict=True))
        return cls(maps, factors, own, places, scale_sigma, floor, component.widened).converged()

    @classmethod
    def alone(cls, robot: str, m: LandmarkMap, scale_sigma: float, floor: float) -> "InformationSum":
        """One map by itself."""
        places = dict(zip(m.ids, m.mean, strict=True))
        return cls({robot: m}, {robot: 1.0}, {robot: np.array([0.0, 0.0, 0.0, 1.0])}, places, scale_sigma, floor)

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(sorted(self.maps, key=in_order))

    def put(self, newer: Mapping[str, LandmarkMap]) -> "InformationSum":
        """With these maps in place of their robots' older ones, not solved: each may hold landmarks that are new."""
        changed = {r: m for r, m in newer.items() if not _same(m, self.maps[r])}
        if not changed:
            return self
        if len(self.maps) < 2:
            ((robot, m),) = changed.items()
            return self.alone(robot, m, self.scale_sigma, self.floor)
        places = dict(self.places)
        for robot, m in changed.items():
            new = [i for i, name in enumerate(m.ids) if name not in places]
            x, y, theta, scale = self.own[robot]
            at = se2.act(np.array([x, y, theta]), m.mean[new] / scale)
            places |= {m.ids[i]: place for i, place in zip(new, at, strict=True)}
        terms = {r: term for r, term in self.terms.items() if r not in changed}
        return replace(self, maps={**self.maps, **changed}, places=places, terms=terms)

    def tied(self, other: "InformationSum", T: Float[np.ndarray, "3"]) -> "InformationSum":
        """Both, whose robots differ, `T` being about where the other lies in this; not solved, in this one's frame."""
        moved = {r: np.append(se2.compose(T, own[:3]), own[3]) for r, own in other.own.items()}
        there = {name: np.asarray(se2.act(T, place)) for name, place in other.places.items()}
        return replace(
            self,
            maps={**self.maps, **other.maps},
            factors={**self.factors, **other.factors},
            own={**self.own, **moved},
            places={**there, **self.places},
            widened={**self.widened, **other.widened},
            terms={},
        )

    def select(self, robots: Collection[str]) -> "InformationSum":
        """Of the maps of these robots alone, which lie as they do here; not solved."""
        maps = {r: m for r, m in self.maps.items() if r in robots}
        return replace(
            self,
            maps=maps,
            factors={r: self.factors[r] for r in maps},
            own={r: self.own[r] for r in maps},
            widened={r: self.widened[r] for r in maps if r in self.widened},
            terms={},
        )

    def doubting(self, widened: Mapping[str, Mapping[str, float]]) -> "InformationSum":
        """With these variances, and no others, added to landmarks that are doubted; not solved."""
        changed = {r for r in self.maps if widened.get(r, {}) != self.widened.get(r, {})}
        terms = {r: term for r, term in self.terms.items() if r not in changed}
        return replace(self, widened=widened, terms=terms) if changed else self

    def converged(self) -> "InformationSum":
        """Solved, every part taken anew until the estimate stays within `NEAR` of where it was taken.

        Raises EstimateError where it does not after `ROUNDS`, numpy.linalg.LinAlgError where nothing holds the maps.
        """
        if len(self.maps) < 2:  # a map by itself is what it is
            return self
        ids = tuple(dict.fromkeys(name for m in self.maps.values() for name in m.ids))
        index, gauge = {name: i for i, name in enumerate(ids)}, self.robots[0]
        T = se2.inverse(self.own[gauge][:3])
        places = se2.act(T, np.array([self.places[name] for name in ids]).reshape(-1, 2))
        rows = {r: _rows(m, index) for r, m in self.maps.items()}
        own = {
            r: np.concatenate([se2.compose(T, one[:3]), one[3:], places.ravel()[rows[r]]])
            for r, one in self.own.items()
        }
        terms = dict(self.terms)
        for _ in range(ROUNDS):
            for robot in self.maps:
                old = terms.get(robot)
                if old is None or np.abs(own[robot] - old.at).max() > NEAR:
                    term = self._term(robot) if old is None else old.term
                    terms[robot] = InformationTerm.of(term, own[robot], self.scale_sigma, gauge=robot == gauge)
            Lambda, eta = _summed(terms, rows, 2 * len(ids))
            x = solve_psd(Lambda, eta)
            own = {r: terms[r].placed(x[rows[r]]) for r in self.maps}
            if all(np.abs(own[r] - terms[r].at).max() <= NEAR for r in self.maps):
                break
        else:
            raise EstimateError("its map and those of the others come to no rest")
        return replace(
            self,
            own={r: one[:4] for r, one in own.items()},
            places=dict(zip(ids, x.reshape(-1, 2), strict=True)),
            terms=terms,
        )

    def joined(self) -> Component:
        """The component as the sum has it, once it is converged."""
        if len(self.maps) < 2:
            return self._by_itself()
        ids = tuple(sorted(self.places, key=in_order))
        index = {name: i for i, name in enumerate(ids)}
        rows = {r: _rows(m, index) for r, m in self.maps.items()}
        Lambda, _ = _summed(self.terms, rows, 2 * len(ids))
        cov = symmetrise(solve_psd(Lambda, np.eye(len(Lambda))))
        robots = self.robots
        frame_cov = {robots[0]: np.zeros((3, 3))}
        for robot in robots[1:]:
            term, at = self.terms[robot], rows[robot]
            G = term.G[:3]
            frame_cov[robot] = symmetrise(term.C[:3, :3] + G @ cov[np.ix_(at, at)] @ G.T)
        members: dict[str, list[str]] = {name: [] for name in ids}
        for robot in robots:
            for name in self.maps[robot].ids:
                members[name].append(robot)
        return Component(
            robots=robots,
            map=LandmarkMap(ids, np.array([self.places[name] for name in ids]).reshape(-1, 2), cov),
            frames={r: np.append(self.own[r][:2], se2.wrap_angle(self.own[r][2])) for r in robots},
            frame_cov=frame_cov,
            members={name: tuple(some) for name, some in members.items()},
            scales={r: float(self.own[r][3]) for r in robots},
            widened={r: self.widened[r] for r in robots if self.widened.get(r)},
        )

    def _by_itself(self) -> Component:
        ((robot, m),) = self.maps.items()
        ids = sorted(m.ids, key=in_order)
        frame, members = {robot: np.zeros(3)}, dict.fromkeys(ids, (robot,))
        return Component((robot,), m.select(ids), frame, {robot: np.zeros((3, 3))}, members, {robot: 1.0})

    def _term(self, robot: str) -> MapTerm:
        m, extra = self.maps[robot], self.widened.get(robot, {})
        V = self.factors[robot] * (m.cov + np.diag(np.repeat([extra.get(name, 0.0) for name in m.ids], 2)))
        V = V + self.floor**2 * np.eye(len(V))
        return MapTerm(np.arange(4 + len(V)), m.mean.ravel(), symmetrise(solve_psd(V, np.eye(len(V)))))


def _rows(m: LandmarkMap, index: Mapping[str, int]) -> Int[np.ndarray, " m"]:
    """Where the coordinates of a map's landmarks stand among those of all."""
    at = np.array([index[name] for name in m.ids], dtype=np.intp)
    return np.asarray((2 * at[:, None] + np.arange(2)).ravel())


def _summed(
    terms: Mapping[str, InformationTerm], rows: Mapping[str, Int[np.ndarray, " m"]], size: int
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    Lambda, eta = np.zeros((size, size)), np.zeros(size)
    for robot, at in rows.items():
        Lambda[at[:, None], at] += terms[robot].S
        eta[at] += terms[robot].s
    return Lambda, eta


def _same(a: LandmarkMap, b: LandmarkMap) -> bool:
    return a is b or (a.ids == b.ids and np.array_equal(a.mean, b.mean) and np.array_equal(a.cov, b.cov))


NOTHING = Fusion((), ())
MOST = 2000  # landmarks up to which a sum, which is dense, is kept
TRIALS = 100  # of two parts on each other that may fail before an update goes on; the rest is tried by the next ones
ELSEWHERE = "landmark-elsewhere"  # the finding of a landmark that is doubted
Pair = tuple[str, str]


@dataclass(frozen=True, slots=True)
class OnlineFuser:
    """The latest map of every robot heard of and what they fuse to.

    sums: a component each, where maps can be exchanged in sums; sightings: of each robot when all was judged;
    judged: how often it was; doubts: robot and landmark that were doubted then; due: whether all is to be judged anew;
    tried: by the first robots of two parts, what they had to go by when they could not be tied (`_Parts.grounds`).
    """

    cfg: FuseConfig = field(default_factory=FuseConfig)
    recordings: Mapping[str, str] | None = None  # as `fuse` takes them
    latest: Mapping[str, LocalMap] = field(default_factory=dict)
    fusion: Fusion = NOTHING
    sums: tuple[InformationSum, ...] = ()
    sightings: Mapping[str, int] = field(default_factory=dict)
    judged: int = 0
    doubts: frozenset[Pair] = frozenset()
    due: bool = False
    tried: Mapping[Pair, float] = field(default_factory=dict)

    def update(self, *fresher: LocalMap) -> "OnlineFuser":
        """The fuser after these maps, each in place of its robot's older one; all judged anew if that is due."""
        try:
            now = self.grown(*fresher)
        except (EstimateError, np.linalg.LinAlgError):  # what no sum holds is judged
            now = replace(self, latest={**self.latest, **{m.robot: m for m in fresher}}, due=True)
        return now.converged() if now.due else now

    def grown(self, *fresher: LocalMap) -> "OnlineFuser":
        """The same, but that nothing is judged anew: `due` tells whether it ought to be."""
        latest = {**self.latest, **{m.robot: m for m in fresher}}
        now = replace(self, latest=latest)
        if not self.summable:
            return replace(now, due=True)
        sums, left = self._put(fresher)
        parts = _Parts.of(sums, latest, self.cfg)
        if apart := parts.without_contradicting():
            parts = _Parts.of(apart, latest, self.cfg)
        tried = parts.tie(self.recordings, self.tried, self.cfg)
        robots, outliers = parts.robots, parts.doubt()
        sums = sorted((part.converged() for part in parts.sums), key=_largest_first)
        doubts = {(robots[d.owner], d.id) for d in outliers}
        grown = _grown(self.sightings, latest)
        findings = [f for f in self.fusion.findings if f.code != ELSEWHERE] + outlier_findings(robots, outliers)
        components = tuple(part.joined() for part in sums)
        decisions = _decisions(sums, components, self.fusion.decisions)
        fusion = Fusion(components, decisions, tuple(findings), self.fusion.labels)
        due = left or grown or bool(apart) or not doubts <= self.doubts
        return replace(now, fusion=fusion, sums=tuple(sums), tried=tried, due=due)

    def converged(self) -> "OnlineFuser":
        """All latest maps judged and joined anew, as `fuse` does at the end."""
        fusion = fuse(list(self.latest.values()), self.cfg, self.recordings)
        doubts = frozenset((r, name) for c in fusion.components for r, wide in c.widened.items() for name in wide)
        judged = replace(
            self,
            fusion=fusion,
            sightings={r: _sightings(m) for r, m in self.latest.items()},
            judged=self.judged + 1,
            doubts=doubts,
            due=False,
        )
        sums = judged.summed()
        whole = len(sums) == len(fusion.components)
        return replace(judged, sums=sums, tried=_Parts.of(sums, self.latest, self.cfg).tried() if whole else {})

    def caught_up(self, now: "OnlineFuser") -> "OnlineFuser":
        """The fuser, judged beside, with robots that have come since where they are `now`; it is to be `grown` next.

        One that is tied `now` by what is not in it yet is by itself.
        """
        sums = list(self.sums)
        of = {robot: k for k, part in enumerate(sums) for robot in part.maps}
        for part in now.sums:
            new = {r: m for r, m in part.maps.items() if r not in self.latest}
            known = next((r for r in part.robots if r in of), None)
            k = len(sums) if known is None else of[known]
            while new:
                names = set(sums[k].places) if k < len(sums) else set[str]()
                tied = next((r for r, m in new.items() if len(names & set(m.ids)) >= ENOUGH), None)
                if tied is None or known is None:
                    robot, m = new.popitem()
                    sums.append(self._alone(robot, m))
                    known = known or robot
                    continue
                T = se2.compose(sums[k].own[known][:3], se2.inverse(part.own[known][:3]))
                one = self._alone(tied, new.pop(tied))
                sums[k] = sums[k].tied(one, np.asarray(se2.compose(T, part.own[tied][:3])))
        came = {r: m for r, m in now.latest.items() if r not in self.latest}
        return replace(self, latest={**self.latest, **came}, sums=tuple(sums))

    def without(self, robots: Iterable[str]) -> "OnlineFuser":
        """The fuser that never heard of these robots' maps; who is left of a part of theirs is tied anew when it is
        `grown` next.
        """
        gone = set(robots) & set(self.latest)
        if not gone:
            return self
        sums: list[InformationSum] = []
        for part in self.sums:
            if gone.isdisjoint(part.maps):
                sums.append(part)
            else:
                sums += [self._alone(r, m) for r, m in part.maps.items() if r not in gone]
        latest = {r: m for r, m in self.latest.items() if r not in gone}
        decisions = tuple(d for d in self.fusion.decisions if d.robot not in gone)
        labels = {r: names for r, names in self.fusion.labels.items() if r not in gone}
        fusion = Fusion((), decisions, self.fusion.findings, labels)
        return replace(self, latest=latest, fusion=fusion, sums=tuple(sums), tried={})

    @property
    def summable(self) -> bool:
        """Whether maps can be exchanged in sums: of the weights asked for, and of so many landmarks."""
        cfg = self.cfg
        plain = (cfg.weights, cfg.identities, cfg.repeats, cfg.robot_sightings) == ("full-scaled", "known", 1, False)
        return plain and all(len(c.map) <= MOST for c in self.fusion.components)

    def summed(self) -> tuple[InformationSum, ...]:
        """Sums of the components as they were judged; none where the weights asked for are not those of a sum."""
        if not self.summable:
            return ()
        factors = {d.robot: d.variance_factor or 1.0 for d in self.fusion.decisions}
        out: list[InformationSum] = []
        for c in self.fusion.components:
            maps = {r: self._named(self.latest[r]) for r in c.robots}
            mine = {r: factors[r] for r in c.robots}
            try:
                out.append(InformationSum.of(c, maps, mine, self.cfg.scale_sigma, self.cfg.floor))
            except (EstimateError, np.linalg.LinAlgError):  # they are tied anew, one by one
                out += [self._alone(r, m) for r, m in maps.items()]
        return tuple(out)

    def _alone(self, robot: str, m: LandmarkMap) -> InformationSum:
        return InformationSum.alone(robot, m, self.cfg.scale_sigma, self.cfg.floor)

    def _put(self, fresher: Iterable[LocalMap]) -> tuple[list[InformationSum], bool]:
        """The sums with these maps in them, those of new robots by themselves; whether any must be judged first."""
        of = {robot: k for k, part in enumerate(self.sums) for robot in part.maps}
        refused = {d.robot for d in self.fusion.decisions} - of.keys()
        logs = {m.log_hash for m in self.latest.values() if m.log_hash}
        newer: dict[int, dict[str, LandmarkMap]] = {}
        alone: list[InformationSum] = []
        left = False
        for m in fresher:
            old = self.latest.get(m.robot)
            ids = self._names(m)
            if m.robot in refused:
                left |= old is not None and m.log_hash != old.log_hash
            elif unsound(m) is not None or len(set(ids)) < len(ids):
                left = True
            elif m.robot in of:
                part = self.sums[of[m.robot]]
                if old is None or m.log_hash != old.log_hash or not set(part.maps[m.robot].ids) <= set(ids):
                    left = True
                else:
                    newer.setdefault(of[m.robot], {})[m.robot] = self._named(m)
            elif m.log_hash in logs and old is None:
                left = True
            else:
                logs |= {m.log_hash} - {""}
                alone.append(self._alone(m.robot, self._named(m)))
        return [*(part.put(newer.get(k, {})) for k, part in enumerate(self.sums)), *alone], left

    def _names(self, m: LocalMap) -> tuple[str, ...]:
        labels = self.fusion.labels.get(m.robot, {})
        return tuple(labels.get(name, name) for name in m.submap.ids)

    def _named(self, m: LocalMap) -> LandmarkMap:
        """Its landmarks by their names in the team's map."""
        own = m.submap.landmarks
        return LandmarkMap(self._names(m), own.mean, own.cov, own.frame)

    @property
    def largest(self) -> Component | None:
        """The component that most robots are tied into, if anything is mapped yet."""
        return self.fusion.components[0] if self.fusion.components else None

    @property
    def tied_in(self) -> int:
        """How many robots are part of the largest component."""
        return len(self.largest.robots) if self.largest else 0

    @property
    def trace(self) -> float | None:
        """The sum of all landmark variances of the largest component [m^2]; None while nothing is mapped."""
        return float(np.trace(self.largest.map.cov)) if self.largest and len(self.largest.map) else None

    @property
    def log_det(self) -> float | None:
        """The logarithm of the determinant of its landmark covariance; None while nothing is mapped."""
        return float(np.linalg.slogdet(self.largest.map.cov)[1]) if self.largest and len(self.largest.map) else None


def _largest_first(part: InformationSum) -> tuple[int, object]:
    return -len(part.maps), in_order(part.robots[0])


@dataclass(slots=True)
class _Parts:
    """Sums that are being tied and doubted: their maps (of `robots`, in this order) laid out as each has them.

    held[k]: which of all landmarks sum k has; common: how many two of them have in common; behind: sightings of each.
    """

    sums: list[InformationSum]
    robots: list[str]
    maps: list[LandmarkMap]
    laid: list[Consensus]
    held: Float[np.ndarray, "k n"]
    common: Float[np.ndarray, "k k"]
    behind: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, sums: Iterable[InformationSum], latest: Mapping[str, LocalMap], cfg: FuseConfig) -> "_Parts":
        sums = sorted(sums, key=_largest_first)
        robots = [robot for part in sums for robot in part.robots]
        maps = [part.maps[robot] for part in sums for robot in part.robots]
        own = np.array([part.own[robot] for part in sums for robot in part.robots]).reshape(-1, 4)
        entries = Entries.of(maps)
        entries = replace(entries, local=entries.local / own[entries.owner, 3:])
        laid, k = [], 0
        for part in sums:
            one = Consensus(entries, cfg)
            for _ in part.robots:
                one.place(k, own[k, :3])
                k += 1
            laid.append(one)
        held = np.array([one.count > 0 for one in laid], dtype=np.float32).reshape(len(sums), len(entries.ids))
        behind = np.array([sum(_sightings(latest[r]) for r in part.robots) for part in sums], dtype=float)
        return cls(sums, robots, maps, laid, held, held @ held.T, behind)

    def grounds(self) -> Float[np.ndarray, "k k"]:
        """What there is to tell by whether two are one: landmarks in common times sightings behind the lesser."""
        return np.asarray(self.common * np.minimum(self.behind, self.behind[:, None]))

    def tie(
        self, recordings: Mapping[str, str] | None, before: Mapping[Pair, float], cfg: FuseConfig
    ) -> dict[Pair, float]:
        """Two parts are one where what they share shows it, asked when that is a quarter more than `before`.

        What was tried by now.
        """
        first = [part.robots[0] for part in self.sums]
        at = {robot: k for k, robot in enumerate(first)}
        tried = np.zeros(self.common.shape)
        for (one, other), n in before.items():
            if one in at and other in at:
                tried[at[one], at[other]] = tried[at[other], at[one]] = n
        origins = ["" if recordings is None else recordings.get(robot, "") for robot in self.robots]
        test = PlaceTest(self.maps, self.robots, origins, cfg)
        alive = np.ones(len(self.sums), dtype=bool)
        trials = 0
        while len(self.sums) and trials < TRIALS:
            fresh = self.grounds() > JUDGE_AGAIN * tried
            open_ = np.triu(np.where(fresh, self.common, 0.0), 1) * alive * alive[:, None]
            if open_.max() < ENOUGH:
                break
            a, b = sorted(map(int, np.unravel_index(int(np.argmax(open_)), open_.shape)), key=self._size)
            tried[a, b] = tried[b, a] = self.common[a, b] * min(self.behind[a], self.behind[b])
            T = self._lies(a, b, test)
            if T is None:
                trials += 1
                continue
            self.sums[a] = self.sums[a].tied(self.sums[b], T)
            alive[b] = False
            self.behind[a] += self.behind[b]
            self.held[a] = np.maximum(self.held[a], self.held[b])
            self.common[a] = self.common[:, a] = self.held @ self.held[a]
        kept = np.flatnonzero(alive).tolist()
        self.sums, self.laid = [self.sums[k] for k in kept], [self.laid[k] for k in kept]
        self.held, self.common, self.behind = self.held[kept], self.common[np.ix_(kept, kept)], self.behind[kept]
        return self._by_name(tried[np.ix_(kept, kept)])

    def _lies(self, a: int, b: int, test: PlaceTest) -> Float[np.ndarray, "3"] | None:
        """Where part b lies in part a, in which it is placed; None where nothing shows it."""
        into, other = self.laid[a], self.laid[b]
        if len(other.placed) > 1:
            return absorbed(into, other, test)
        (k,) = other.placed
        T = place_in(into, test, k)
        if T is not None:
            into.place(k, T)
        return T

    def tried(self) -> dict[Pair, float]:
        """As if all had been tried on each other."""
        return self._by_name(self.grounds())

    def without_contradicting(self) -> list[InformationSum]:
        """The sums where maps that contradict the others of theirs are by themselves; none where no map does."""
        out: list[InformationSum] = []
        found = False
        for part, one in zip(self.sums, self.laid, strict=True):
            wrong = {self.robots[k] for k in find_contradicting(one)} if len(part.maps) > 1 else set[str]()
            found |= bool(wrong)
            out += [InformationSum.alone(r, part.maps[r], part.scale_sigma, part.floor) for r in sorted(wrong)]
            out += _connected(part.select(part.maps.keys() - wrong)) if wrong else [part]
        return out if found else []

    def doubt(self) -> list[Outlier]:
        """The landmarks that lie elsewhere in one map than in the others of its sum, which trusts them less now."""
        outliers = [d for one in self.laid if len(one.placed) > 1 for d in find_outliers(one)]
        wide: dict[str, dict[str, float]] = {}
        for d in outliers:
            wide.setdefault(self.robots[d.owner], {})[d.id] = d.residual**2
        self.sums = [part.doubting({r: wide[r] for r in part.maps if r in wide}) for part in self.sums]
        return outliers

    def _size(self, k: int) -> tuple[int, int]:
        return -len(self.laid[k].placed), k

    def _by_name(self, grounds: Float[np.ndarray, "k k"]) -> dict[Pair, float]:
        first = [part.robots[0] for part in self.sums]
        pairs = np.argwhere(np.triu(grounds, 1) > 0).tolist()
        return {(first[a], first[b]): float(grounds[a, b]) for a, b in pairs}


def _connected(part: InformationSum) -> list[InformationSum]:
    """The maps of a sum in as many as hang together, one with the next, by landmarks that both have."""
    waiting, out = dict(part.maps), list[InformationSum]()
    while waiting:
        group, fresh = set[str](), [next(iter(waiting))]
        while fresh:
            group.add(robot := fresh.pop())
            ids = set(waiting.pop(robot, part.maps[robot]).ids)
            fresh += [r for r, m in waiting.items() if r not in fresh and len(ids.intersection(m.ids)) >= ENOUGH]
        if len(group) > 1:
            out.append(part.select(group))
        else:
            out += [InformationSum.alone(r, part.maps[r], part.scale_sigma, part.floor) for r in group]
    return out


def _decisions(
    sums: Sequence[InformationSum], components: Sequence[Component], judged: Sequence[Decision]
) -> tuple[Decision, ...]:
    """What became of each robot; of those that are in no sum, what was `judged`."""
    before = {d.robot: d for d in judged}
    out = dict(before)
    for part, component in zip(sums, components, strict=True):
        for i, robot in enumerate(component.robots):
            ids = part.maps[robot].ids
            n = sum(len(component.members[name]) > 1 for name in ids)
            old, scale, factor = before.get(robot), component.scales[robot], part.factors[robot]
            if len(component.robots) == 1 and len(sums) > 1:
                refused = old is not None and old.decision == "refused"
                why = old.reason if old is not None and refused else f"nothing ties it to the others yet{APART}"
                out[robot] = Decision(robot, n, "refused", why, scale, factor)
            elif i == 0:
                out[robot] = Decision(robot, n, "reference", "its first pose is the map's frame", scale, factor)
            else:
                why = f"shares {n} landmarks with the others"
                out[robot] = Decision(robot, n, "merged", why, scale, factor)
    return tuple(out[robot] for robot in sorted(out, key=in_order))


def _sightings(m: LocalMap) -> int:
    return sum(m.sightings.values())


def _grown(before: Mapping[str, int], latest: Mapping[str, LocalMap]) -> bool:
    """Whether maps rest on so many more sightings than `before` that all are judged anew.

    On the average over their logarithms: what one robot claims counts for one.
    """
    more = [math.log(max(_sightings(m), 1) / max(before.get(r, 0), 1)) for r, m in latest.items()]
    return not before or sum(more) >= len(more) * math.log(JUDGE_AGAIN)
