"""The shared map while robots drive: their latest snapshots through the very fusion of `map`."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import MapweaveError
from ..core.records import Track
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..fusion.result import Component
from ..landmarks.landmark_map import LocalMap, Submap
from .columns import unpack, unpack_triangle
from .inbox import Ledger
from .messages import Correction, LandmarkState, RefusedError, Snapshot

TRIANGLE = np.triu_indices(3)
ALONE = (np.zeros(3), np.zeros((3, 3)), 1.0)


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a robot's own frame stands in the shared map: `T_map_local`, its covariance, the scale of its lengths."""

    component: int
    frame: Float[np.ndarray, "3"]
    frame_cov: Float[np.ndarray, "3 3"]
    scale: float

    def carry(
        self, pose: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """`T_map_robot` of a `T_local_robot`, and its covariance."""
        shrink = np.diag([1 / self.scale, 1 / self.scale, 1.0])
        small = shrink @ pose
        P = se2.composed_covariance(self.frame, self.frame_cov, small, shrink @ cov @ shrink)
        return se2.compose(self.frame, small), 0.5 * (P + P.T)

    def correction(self, name: str, robot: str) -> Correction:
        """What map process `name` tells `robot`."""
        return Correction(
            map=name, robot=robot, pose=listed(self.frame), cov=triangle(self.frame_cov), scale=self.scale
        )


@dataclass(slots=True)
class SharedMap:
    """The fusion of the newest snapshots. used: robot -> message number of the snapshot that is in it."""

    cfg: FuseConfig = field(default_factory=FuseConfig)
    placed: dict[str, Placed] = field(default_factory=dict)
    landmarks: list[LandmarkState] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    used: dict[str, int] = field(default_factory=dict)
    fused: int = 0
    fuser: OnlineFuser = field(default_factory=OnlineFuser)

    def update(self, ledgers: Iterable[Ledger]) -> bool:
        """Whether there was anything fresher, which is fused now; what can't be fused is said in `decisions`."""
        self._lasers(ledgers := list(ledgers))
        told = [(ledger, ledger.snapshot) for ledger in ledgers if ledger.snapshot is not None and not ledger.fault]
        if all(self.used.get(ledger.robot) == s.last for ledger, s in told):
            return False
        self.used = {ledger.robot: s.last for ledger, s in told}
        maps: dict[str, LocalMap] = {}
        refused: list[str] = []
        for ledger, snapshot in told:
            if ledger.record is None or not snapshot.ids:
                continue
            try:
                maps[ledger.robot] = local_map_of(ledger, snapshot)
            except (RefusedError, ValueError) as error:
                refused.append(f"{ledger.robot}: refused, its snapshot: {error}")
        self._fuse(maps, refused)
        return True

    def _lasers(self, ledgers: Sequence[Ledger]) -> None:
        """Laser robots stand each in a part of its own until their logs are woven at the end."""
        lasers = [x.robot for x in ledgers if x.record is not None and x.record.header.sensor == "laser"]
        if lasers:
            self.placed = {name: Placed(k, *ALONE) for k, name in enumerate(lasers, 1)}
            self.decisions = [
                f"{name}: in its own frame; the maps are woven when the logs are whole" for name in lasers
            ]

    def _fuse(self, maps: dict[str, LocalMap], refused: list[str]) -> None:
        self.fused += 1
        name_of = {m.robot: name for name, m in maps.items()}
        try:
            recordings = {m.robot: m.source for m in maps.values()}
            if set(self.fuser.latest) - set(recordings):  # who is refused by now is out of the sum
                self.fuser = OnlineFuser(self.cfg)
            self.fuser = replace(self.fuser, cfg=self.cfg, recordings=recordings).update(*maps.values())
            fusion = self.fuser.fusion
        except (MapweaveError, np.linalg.LinAlgError) as error:
            self.decisions = [*refused, f"not fused: {error}"]
            return
        self.placed, self.landmarks = {}, []
        for k, component in enumerate(fusion.components, 1):
            for robot in component.robots:
                name = name_of[robot]
                self.placed[name] = _place(k, component, robot)
            cov = component.map.cov
            for i, (landmark, (x, y)) in enumerate(zip(component.map.ids, component.map.mean.tolist(), strict=True)):
                block = cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
                numbers = (float(block[0, 0]), float(block[0, 1]), float(block[1, 1]))
                self.landmarks.append(LandmarkState(id=landmark, x=x, y=y, cov=numbers, component=k))
        self.decisions = [
            *refused,
            *(f"{name_of[d.robot]}: {d.decision}, {d.reason}" for d in fusion.decisions),
            *(f"warning: {w}" for w in fusion.warnings),
        ]


def local_map_of(ledger: Ledger, snapshot: Snapshot) -> LocalMap:
    """What the robot hands over at this time; raises RefusedError when the numbers can't be those of a map."""
    assert ledger.record is not None  # noqa: S101  (seen to by the caller)
    header = ledger.record.header
    n = len(snapshot.ids)
    cov = unpack_triangle(snapshot.cov, 3 + 2 * n)
    mean = unpack(snapshot.mean, 2).T
    frame = f"local_{header.log_robot.removeprefix('robot')}"
    pose = np.array(snapshot.pose)
    submap = Submap(header.log_robot, pose, tuple(snapshot.ids), np.ascontiguousarray(mean), cov, frame)
    return LocalMap(
        robot=header.log_robot,
        submap=submap,
        track=Track(np.array([snapshot.t]), pose[None], cov[None, :3, :3], frame),
        sightings=dict(zip(snapshot.ids, snapshot.counts, strict=True)),
        source=header.source,
        log_hash=ledger.run,
    )


def _place(k: int, component: Component, robot: str) -> Placed:
    return Placed(k, component.frames[robot], component.frame_cov[robot], component.scales.get(robot, 1.0))


def listed(pose: Float[np.ndarray, "3"]) -> tuple[float, ...]:
    return tuple(float(x) for x in pose)


def triangle(P: Float[np.ndarray, "3 3"]) -> tuple[float, ...]:
    """xx, xy, xt, yy, yt, tt."""
    return tuple(float(x) for x in P[TRIANGLE])


def square(numbers: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The symmetric matrix of which `triangle` gives the numbers; zero of none."""
    P = np.zeros((3, 3))
    P[TRIANGLE] = numbers or 0.0
    return P + np.triu(P, 1).T
