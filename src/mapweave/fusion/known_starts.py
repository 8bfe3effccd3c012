"""Maps that share too little to be tied by landmarks, tied by where a robot is known to have started."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from ..core import se2
from ..core.names import in_order
from ..landmarks.landmark_map import LandmarkMap
from .result import Component, Decision, Fusion

AGREE = 0.5  # [m] between a start given and the one found from landmarks, above which it is told


def tie_by_starts(fusion: Fusion, starts: Mapping[str, tuple[float, float, float]]) -> Fusion:
    """The fusion with every component that holds a robot of known start placed into the lowest-numbered robot's map.

    starts: robot -> first pose in `map` [m, m, rad], taken as exact. Robots tied by landmarks stay as they are: a start
    that says otherwise is told. A landmark both maps hold (one at most, or they would have been joined) keeps its
    place in the map of the lowest-numbered robot.
    """
    if not starts or not fusion.components:
        return fusion
    base = min(fusion.components, key=lambda c: min(map(in_order, c.robots)))
    warnings = list(fusion.warnings)
    for robot in sorted(set(starts) & set(base.robots), key=in_order):
        off = float(np.hypot(*(base.frames[robot][:2] - np.array(starts[robot][:2]))))
        if off > AGREE:
            warnings.append(f"{robot}: its landmarks put its start {off:.2f} m from the one given; the landmarks count")
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
    return replace(fusion, components=tuple(components), decisions=decisions, warnings=tuple(warnings))


def _placed(decision: Decision, placed: Mapping[str, str], first: str | None) -> Decision:
    if decision.robot == first:
        return replace(decision, decision="reference", reason="its first pose is the map's frame")
    if decision.robot not in placed:
        return decision
    return replace(decision, decision="merged", reason=placed[decision.robot])


def _beside(base: Component, other: Component, T: np.ndarray) -> Component:
    """Both components in the first one's frame, `T_base_other` exactly known."""
    new = [name for name in other.map.ids if name not in base.map.ids]
    moved = other.map.select(new).moved(T, base.map.frame)
    ids = (*base.map.ids, *new)
    both = LandmarkMap(ids, np.vstack([base.map.mean, moved.mean]), sla.block_diag(base.map.cov, moved.cov))
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
