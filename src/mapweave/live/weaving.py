"""The graph of all laser robots of a team, solved by what is decided on pairs, beside everything else.

And where each robot's own frame stands in the shared map for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..core import se2
from ..core.errors import EstimateError
from ..laser.joint_pass import JointPassConfig
from ..laser.robot_graph import RobotGraph
from ..mapping.merge import Merge
from ..mapping.merge_search import MergeConfig
from ..mapping.weave import Woven, weave
from .isolation import without_culprits
from .messages import Correction, listed, triangle
from .pair_search import UNTRIED
from .tile_mapper import Standing

ALONE = (np.zeros(3), np.zeros((3, 3)), 1.0)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a robot's own frame stands in the shared map: `T_map_local`, its covariance, the scale of its lengths.

    own: whether the covariance a robot tells of its pose comes on top; a woven robot's frame has it in already, as it
    counts where the robot is now.
    """

    component: int
    frame: Float[np.ndarray, "3"]
    frame_cov: Float[np.ndarray, "3 3"]
    scale: float
    own: bool = True

    def carry(
        self, pose: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """`T_map_robot` of a `T_local_robot`, and its covariance."""
        shrink = np.diag([1 / self.scale, 1 / self.scale, 1.0])
        small = shrink @ pose
        P = se2.composed_covariance(self.frame, self.frame_cov, small, shrink @ (cov * self.own) @ shrink)
        return se2.compose(self.frame, small), 0.5 * (P + P.T)

    def correction(self, name: str, robot: str) -> Correction:
        """What map process `name` tells `robot`."""
        return Correction(
            map=name, robot=robot, pose=listed(self.frame), cov=triangle(self.frame_cov), scale=self.scale
        )


UNTOUCHED = JointPassConfig(widths=())  # keyframes stay as the joint graph has them: the last pass is left to the end
MOST_TOLD = 60  # pairs of robots


class Weaving(NamedTuple):
    """The robots' graphs, to be solved together. Running it touches nothing but its own numbers.

    ids: what each robot's keyframes are known by; known: by two robots' places what was decided on them; unsure: times
    the graph's covariances are those told.
    """

    graphs: Sequence[RobotGraph]
    ids: Sequence[Int[np.ndarray, " _"]]
    known: Mapping[tuple[int, int], Merge]
    cfg: MergeConfig
    unsure: float

    def run(self) -> "WovenGraphs":
        """The graph of all robots solved; of those with whom it can be, where it can't be of all."""
        every = [graph.robot for graph in self.graphs]
        woven, _, failed = without_culprits(every, lambda names: self._of(names)._woven())  # noqa: SLF001
        return (woven or WovenGraphs({}, {}, []))._replace(failed=failed)

    def _of(self, names: Sequence[str]) -> "Weaving":
        """The same of these robots alone."""
        at = [k for k, graph in enumerate(self.graphs) if graph.robot in names]
        known = {(at.index(i), at.index(j)): merge for (i, j), merge in self.known.items() if i in at and j in at}
        return self._replace(graphs=[self.graphs[k] for k in at], ids=[self.ids[k] for k in at], known=known)

    def _woven(self) -> "WovenGraphs":
        woven = weave(self.graphs, self.cfg, known=self.known, last=UNTOUCHED)
        if not all(np.isfinite(pose).all() for pose in woven.pose):
            raise EstimateError("the graph has no finite solution")
        names = [graph.robot for graph in self.graphs]
        placed = _placed(names, self.graphs, woven, self.unsure)
        standing = {name: Standing(*one) for name, *one in zip(names, self.ids, woven.pose, strict=True)}
        return WovenGraphs(placed, standing, _decisions(names, woven.merges, placed))


class WovenGraphs(NamedTuple):
    """placed: where each robot's frame stands; standing: its keyframes in the map of their part; decisions: words.

    failed: why robots are not among them.
    """

    placed: dict[str, Placed]
    standing: dict[str, Standing]
    decisions: list[str]
    failed: Mapping[str, str] = MappingProxyType({})


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
    """What was decided on pairs, but for those refused or not tried that are connected by others.

    Of more than `MOST_TOLD` those that are tied.
    """
    merges = [m for m in merges if m.merged or placed[m.a].component != placed[m.b].component]
    tried = [m for m in merges if m.reason != UNTRIED]
    tied = [m for m in tried if m.merged]
    lines = [
        f"{m.a} and {m.b}: {m.reason if m.merged else f'not merged, {m.reason}'}"
        for m in (tried if len(tried) <= MOST_TOLD else tied)
    ]
    if len(tried) > MOST_TOLD:
        lines.append(f"{len(tried) - len(tied)} pairs not merged")
    if len(tried) < len(merges):
        lines.append(f"{len(merges) - len(tried)} pairs {UNTRIED}")
    parts = len({p.component for p in placed.values()})
    if len(names) == 1:
        return [f"{names[0]}: the only one so far"]
    return lines if parts == 1 else [*lines, f"{parts} parts that nothing ties"]
