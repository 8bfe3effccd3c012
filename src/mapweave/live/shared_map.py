"""The shared map while robots drive: their latest snapshots through the very fusion of `map`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..core.errors import EstimateError
from ..core.records import Track
from ..fusion.config import FuseConfig
from ..fusion.online import OnlineFuser
from ..fusion.result import Component
from ..landmarks.landmark_map import LocalMap, Submap
from .columns import unpack, unpack_triangle
from .inbox import Ledger
from .isolation import in_words, without_culprits
from .landmark_stream import LandmarkRecord
from .laser_team import WovenTeam
from .messages import LandmarkState, Snapshot, Tile
from .placed import ALONE, Placed
from .tiles import COARSER, TileKey


class Fused(NamedTuple):
    """What snapshots fuse to. used: robot -> message number of its snapshot; refused: in words, whose could not be."""

    fuser: OnlineFuser
    names: Mapping[str, str]
    used: Mapping[str, int]
    refused: Sequence[str]


class Fusing(NamedTuple):
    """Snapshots to be fused. Running it touches nothing but its own numbers; with a large team it takes a while.

    names: robot of a log -> what the team calls it.
    """

    fuser: OnlineFuser
    maps: Sequence[LocalMap]
    names: Mapping[str, str]
    used: Mapping[str, int]
    refused: Sequence[str]

    def run(self) -> Fused:
        """The maps joined: judged anew, or put in place of older ones; without those that can't be joined."""
        fuser, _, failed = without_culprits([m.robot for m in self.maps], self._joined)
        why = [f"{self.names[robot]}: refused, its snapshot: {error}" for robot, error in failed.items()]
        return Fused(fuser or OnlineFuser(self.fuser.cfg), self.names, self.used, [*self.refused, *why])

    def _joined(self, robots: Sequence[str]) -> OnlineFuser:
        maps = [m for m in self.maps if m.robot in robots]
        recordings = {m.robot: m.source for m in maps}
        fuser = self.fuser
        if set(fuser.latest) - set(recordings):  # who is refused by now is out of the sum
            fuser = OnlineFuser(fuser.cfg)
        fuser = replace(fuser, recordings=recordings).update(*maps)
        if not all(np.isfinite(c.map.mean).all() and np.isfinite(c.map.cov).all() for c in fuser.fusion.components):
            raise EstimateError("its map has no finite place in that of the others")
        return fuser


@dataclass(slots=True)
class SharedMap:
    """The fusion of the newest snapshots, or laser robots as they were woven last.

    used: robot -> message number of the snapshot that is in it; name: of the map process; tiles: the map that lasers
    made, its finest cells `resolution` [m] wide.
    """

    cfg: FuseConfig = field(default_factory=FuseConfig)
    placed: dict[str, Placed] = field(default_factory=dict)
    landmarks: list[LandmarkState] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    used: dict[str, int] = field(default_factory=dict)
    fused: int = 0
    fuser: OnlineFuser = field(default_factory=OnlineFuser)
    name: str = "map"
    resolution: float = 0.05
    tiles: dict[TileKey, bytes] = field(default_factory=dict)

    def fusing(self, ledgers: Iterable[Ledger]) -> Fusing | None:
        """The newest snapshots where any is fresher than those of the map; None when none is."""
        snapshots = [
            (ledger, ledger.snapshot)
            for ledger in ledgers
            if ledger.snapshot is not None and isinstance(ledger.record, LandmarkRecord) and not ledger.fault
        ]
        used = {ledger.robot: s.last for ledger, s in snapshots}
        if used.items() <= self.used.items():
            return None
        maps: dict[str, LocalMap] = {}
        refused: list[str] = []
        for ledger, snapshot in snapshots:
            if not snapshot.ids:
                continue
            try:
                maps[ledger.robot] = local_map_of(ledger, snapshot)
            except Exception as error:  # noqa: BLE001  (no number in it may cost others their map)
                refused.append(f"{ledger.robot}: refused, its snapshot: {in_words(error)}")
        names = {m.robot: name for name, m in maps.items()}
        return Fusing(replace(self.fuser, cfg=self.cfg), tuple(maps.values()), names, used, refused)

    def take_fused(self, fused: Fused) -> None:
        """Landmark robots stand as they were fused; what can't be fused is said in `decisions`."""
        self.fused += 1
        self.used, self.fuser = dict(fused.used), fused.fuser
        self.placed, self.landmarks = {}, []
        fusion = fused.fuser.fusion
        for k, component in enumerate(fusion.components, 1):
            for robot in component.robots:
                self.placed[fused.names[robot]] = _place(k, component, robot)
            cov = component.map.cov
            for i, (landmark, (x, y)) in enumerate(zip(component.map.ids, component.map.mean.tolist(), strict=True)):
                block = cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
                numbers = (float(block[0, 0]), float(block[0, 1]), float(block[1, 1]))
                self.landmarks.append(LandmarkState(id=landmark, x=x, y=y, cov=numbers, component=k))
        self.decisions = [
            *fused.refused,
            *(f"{fused.names[d.robot]}: {d.decision}, {d.reason}" for d in fusion.decisions),
            *(f"warning: {w}" for w in fusion.warnings),
        ]

    def take(self, team: WovenTeam) -> list[Tile]:
        """Laser robots stand as `team` has them; the tiles that are not as they were told last."""
        self.fused, self.placed, self.decisions = team.number, dict(team.placed), list(team.decisions)
        changed = {key: cells for key, cells in team.tiles.items() if self.tiles.get(key) != cells}
        gone = self.tiles.keys() - team.tiles.keys()
        self.tiles = dict(team.tiles)
        return [self.tile(key) for key in (*sorted(gone), *changed)]

    def tile(self, key: TileKey) -> Tile:
        """The tile as it is told; without cells where there is none any more."""
        component, level, i, j = key
        side = self.resolution * COARSER**level
        return Tile(
            map=self.name, component=component, level=level, i=i, j=j, cell=side, cells=self.tiles.get(key, b"")
        )

    def meet(self, lasers: Sequence[str]) -> bool:
        """A laser robot that is not woven yet stands in a part of its own; whether one is new."""
        new = [name for name in lasers if name not in self.placed]
        for name in new:
            self.placed[name] = Placed(max((p.component for p in self.placed.values()), default=0) + 1, *ALONE)
            self.decisions = [*self.decisions, f"{name}: in its own frame until its scans are worked in"]
        return bool(new)


def local_map_of(ledger: Ledger, snapshot: Snapshot) -> LocalMap:
    """What the robot hands over at this time; raises RefusedError when the numbers can't be those of a map.

    Its log is told from others by robot and run: two robots may call their runs alike.
    """
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
        log_hash=f"{ledger.robot} {ledger.run}",
    )


def _place(k: int, component: Component, robot: str) -> Placed:
    return Placed(k, component.frames[robot], component.frame_cov[robot], component.scales.get(robot, 1.0))
