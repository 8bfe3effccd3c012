"""What fusing gives: one map for each component, and a plain reason for every merge made or refused.

Components that share too little to be tied by landmarks are tied by where a robot is known to have started.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg as sla
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding
from ..core.names import in_order
from ..landmarks.landmark_map import LandmarkMap

APART = ": left in its own component"  # the end of a reason


@dataclass(frozen=True, slots=True)
class Decision:
    """Why one robot's map was merged or not.

    shared: landmarks in common with the rest; scale: the multiplicative scale found for its map; variance_factor:
    what its covariance was multiplied by, found from the join's own residuals.
    """

    robot: str
    shared: int
    decision: str  # "reference", "merged" or "refused"
    reason: str
    scale: float | None = None
    variance_factor: float | None = None


@dataclass(frozen=True, slots=True)
class Component:
    """Robots tied together and their one map. `frames[k]` is `T_map_local_k`; `frame_cov[k]`: over x, y, theta.

    widened[robot][landmark]: variance [m^2] added to where that robot's map puts a landmark that is doubted.
    """

    robots: tuple[str, ...]
    map: LandmarkMap
    frames: Mapping[str, Float[np.ndarray, "3"]]
    frame_cov: Mapping[str, Float[np.ndarray, "3 3"]]
    members: Mapping[str, tuple[str, ...]]  # landmark id -> robots that saw it
    scales: Mapping[str, float] = field(default_factory=dict)
    widened: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Fusion:
    """All components, the largest first, and a decision for every robot.

    labels[robot]: own landmark name -> name in the map, where they differ (exchanged labels, unknown identities).
    """

    components: tuple[Component, ...]
    decisions: tuple[Decision, ...]
    findings: tuple[Finding, ...] = ()
    labels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def own_name(self, robot: str, name: str) -> str:
        """What `robot` calls the landmark that is `name` in the map."""
        return next((own for own, common in self.labels.get(robot, {}).items() if common == name), name)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' sentences, each with its robot."""
        return tuple(f.told for f in self.findings)


def tie_by_starts(fusion: Fusion, starts: Mapping[str, tuple[float, float, float]], tolerance: float) -> Fusion:
    """The fusion with every component that holds a robot of known start placed into the lowest-numbered robot's map.

    starts: robot -> first pose in `map` [m, m, rad], taken as exact. Robots tied by landmarks stay as they are: a start
    that says otherwise is told. A landmark both maps hold (one at most, or they would have been joined) keeps its
    place in the map of the lowest-numbered robot.
    """
    if not starts or not fusion.components:
        return fusion
    base = min(fusion.components, key=lambda c: min(map(in_order, c.robots)))
    findings = list(fusion.findings)
    for robot in sorted(set(starts) & set(base.robots), key=in_order):
        off = float(np.hypot(*(base.frames[robot][:2] - np.array(starts[robot][:2]))))
        if off > tolerance:
            findings.append(Finding("start-contradicted", robot, value=off, action="the landmarks count"))
    tied, others = base, list[Component]()
    placed: dict[str, str] = {}
    for component in fusion.components:
        known = sorted(set(component.robots) & set(starts), key=in_order)
        if component is base:
            continue
        if not known:
            others.append(component)
            continue
        T = se2.compose(np.array(starts[known[0]]), se2.inverse(component.frames[known[0]]))
        tied = _beside(tied, component, T)
        placed |= dict.fromkeys(component.robots, f"placed by the start given for {known[0]}")
    first = base.robots[0] if placed else None
    decisions = tuple(_placed(d, placed, first) for d in fusion.decisions)
    components = sorted([tied, *others], key=lambda c: -len(c.robots))
    return replace(fusion, components=tuple(components), decisions=decisions, findings=tuple(findings))


def placed_by(fusion: Fusion, what: str, before: Sequence[Sequence[str]], after: Sequence[Sequence[str]]) -> Fusion:
    """The fusion with every refused robot merged that a later step tied to others, by `what`.

    before, after: the robots of each map, before that step and after it.
    """
    old = {robot: set(robots) for robots in before for robot in robots}
    tied = {r for robots in after for r in robots if len(robots) > 1 and set(robots) - old.get(r, {r})}
    why = {
        d.robot: f"{d.reason.removesuffix(APART)}; placed by {what}"
        for d in fusion.decisions
        if d.decision == "refused" and d.robot in tied
    }
    return replace(fusion, decisions=tuple(_placed(d, why, None) for d in fusion.decisions))


def _placed(decision: Decision, placed: Mapping[str, str], first: str | None) -> Decision:
    if decision.robot == first:
        return replace(decision, decision="reference", reason="its first pose is the map's frame")
    if decision.robot not in placed:
        return decision
    return replace(decision, decision="merged", reason=placed[decision.robot])


def _beside(base: Component, other: Component, T: np.ndarray) -> Component:
    """Both components in the first one's frame, `T_base_other` exactly known."""
    new = [name for name in other.map.ids if name not in base.map.ids]
    aligned = other.map.select(new).moved(T, base.map.frame)
    ids = (*base.map.ids, *new)
    both = LandmarkMap(ids, np.vstack([base.map.mean, aligned.mean]), sla.block_diag(base.map.cov, aligned.cov))
    members = {**{n: other.members[n] for n in other.map.ids}, **base.members}
    for name in set(base.members) & set(other.members):
        members[name] = tuple(sorted({*base.members[name], *other.members[name]}, key=in_order))
    order = sorted(ids, key=in_order)
    return Component(
        robots=tuple(sorted((*base.robots, *other.robots), key=in_order)),
        map=both.select(order),
        frames={**base.frames, **{r: se2.compose(T, pose) for r, pose in other.frames.items()}},
        frame_cov={**base.frame_cov, **{r: se2.turned_covariance(T[2], P) for r, P in other.frame_cov.items()}},
        members={name: members[name] for name in order},
        scales={**base.scales, **other.scales},
    )
