"""Parts of a team's map that were made apart, laid into one frame where sightings of each other tie them."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.records import Track

SURER = 2.0  # times as large a covariance as now may have been for a tie to stay as it was

Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True)
class Tied:
    """How a robot lies beside robot `to` of another part, in a way that lasts while both parts are made anew.

    at: (3,) the robot's anchor seen from that of `to`; cov: (3, 3) of where the frame of its part lies in the other.
    The anchor of a laser robot is its first keyframe, of a landmark robot its own frame.
    """

    to: str
    at: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, slots=True)
class SightedAt:
    """Where a robot without a map stood, by what it and others saw, when it told that it was at `told` (3,).

    to: robot; at: (3,) seen from the anchor of `to`; cov: (3, 3) of the pose.
    """

    to: str
    at: Float[np.ndarray, "3"]
    cov: Float[np.ndarray, "3 3"]
    told: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class Joined:
    """What sightings tie of a mixed team, by robots' names in the team.

    decisions: in words; sure: [m] sd that a tie has at most, of either axis.
    """

    tied: Mapping[str, Tied] = field(default_factory=dict)
    sighted: Mapping[str, SightedAt] = field(default_factory=dict)
    decisions: Sequence[str] = ()
    sure: float = 0.0

    def after(self, before: "Joined") -> "Joined":
        """The same, with ties as they were `before` that are hardly surer and moved by less than they are sure of."""
        held = {}
        for name, new in self.tied.items():
            old = before.tied.get(name)
            if old is not None and old.to == new.to:
                near = (np.abs(se2.between(old.at, new.at)) <= np.sqrt(np.diag(new.cov))).all()
                held[name] = old if near and np.trace(old.cov) <= SURER * np.trace(new.cov) else new
        return replace(self, tied={**self.tied, **held})

    def between(self, a: str, b: str) -> Float[np.ndarray, "3"] | None:
        """The anchor of `b` seen from that of `a`, (3,); None where nothing ties them."""
        places = []
        for name in (a, b):
            tie = self.tied.get(name)
            places.append((name, np.zeros(3)) if tie is None else (tie.to, tie.at))
        (root, at), (other, to) = places
        return np.asarray(se2.between(at, to)) if root == other else None


@dataclass(frozen=True, slots=True)
class Apart:
    """What is known of a mixed team, by the robots of its logs (`robotK`), before sightings tie it.

    ways: each laser robot's keyframes, in its own frame; told: when [s] and where (3,) each robot last told that it
    was, in its own frame; called: what the team calls each.
    """

    ways: Mapping[str, Track]
    told: Mapping[str, tuple[float, Float[np.ndarray, "3"]]]
    called: Mapping[str, str]


def into_one_frame(
    parts: Mapping[Key, Mapping[str, Float[np.ndarray, "3"]]], tied: Mapping[str, Tied]
) -> dict[Key, tuple[Key, Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]]:
    """Each part that is tied to another -> the one in whose frame it lies, where (3,), and the covariance (3, 3).

    parts: of each the anchors of its robots in its frame. The part that others lie in lies in none.
    """
    of = {robot: part for part, anchors in parts.items() for robot in anchors}
    out: dict[Key, tuple[Key, np.ndarray, np.ndarray]] = {}
    for part, anchors in parts.items():
        tie = next(((r, tied[r]) for r in anchors if r in tied and of.get(tied[r].to, part) != part), None)
        if tie is None:
            continue
        robot, found = tie
        there = of[found.to]
        T = se2.compose(se2.compose(parts[there][found.to], found.at), se2.inverse(anchors[robot]))
        if there in out:
            there, base, base_cov = out[there]
            cov = se2.composed_covariance(base, base_cov, T, found.cov)
            T = se2.compose(base, T)
        else:
            cov = found.cov
        if there == part:
            continue
        for other, (root, at, at_cov) in list(out.items()):
            if root == part:
                out[other] = there, se2.compose(T, at), se2.composed_covariance(T, cov, at, at_cov)
        out[part] = there, np.asarray(T), cov
    return out
