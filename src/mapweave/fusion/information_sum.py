"""Maps of one component as a sum of information over its landmarks, each map's frame and scale eliminated.

What ties two robots is landmarks alone. Given these, every map's frame and scale follow from it by itself, so that the
system to be solved grows with landmarks and not with robots, a robot or a landmark more is a part more, and a newer map
takes the place of its older one: nothing counts twice.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.errors import EstimateError
from ..core.gaussian import solve_psd, symmetrise
from ..core.names import in_order
from ..landmarks.landmark_map import LandmarkMap
from .full_covariance import MapTerm
from .result import Component

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
