"""The shared map while robots drive: their latest snapshots through the very fusion of `map`."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import EstimateError
from ..core.records import Track
from ..fusion.config import FuseConfig
from ..fusion.online import MOST, OnlineFuser
from ..fusion.result import Component
from ..landmarks.landmark_map import LocalMap, Submap
from ..team.relative_frame import UNMOVED
from .inbox import Ledger
from .isolation import in_words, without_culprits
from .joined import Joined, SightedAt, into_one_frame
from .landmark_stream import LandmarkRecord
from .laser_team import WovenTeam
from .messages import LandmarkState, Snapshot, Tile, unpack, unpack_triangle
from .range_stream import RangedTeam
from .tiles import COARSER, TileKey
from .weaving import ALONE, Placed

LASER, LANDMARKS = "laser", "landmarks"
Part = tuple[str, int]  # the kind of its robots, and its number among those of that kind


class Fused(NamedTuple):
    """What snapshots fuse to. used: robot -> message number of its snapshot; refused: in words, whose could not be."""

    fuser: OnlineFuser
    names: Mapping[str, str]
    used: Mapping[str, int]
    refused: Sequence[str]


class Fusing(NamedTuple):
    """Snapshots to be fused. Running it touches nothing but its own numbers; with a large team it takes a while.

    names: robot of a log -> what the team calls it; judged: maps of some time ago, `judged` meanwhile.
    """

    fuser: OnlineFuser
    maps: Sequence[LocalMap]
    names: Mapping[str, str]
    used: Mapping[str, int]
    refused: Sequence[str]
    judged: OnlineFuser | None = None

    def run(self) -> Fused:
        """The maps put in place of older ones, without those that can't be joined; whether to judge all is `due`."""
        fuser, _, failed = without_culprits([m.robot for m in self.maps], self._joined)
        why = [f"{self.names[robot]}: refused, its snapshot: {error}" for robot, error in failed.items()]
        return Fused(fuser or OnlineFuser(self.fuser.cfg), self.names, self.used, [*self.refused, *why])

    def _joined(self, robots: Sequence[str]) -> OnlineFuser:
        maps = [m for m in self.maps if m.robot in robots]
        recordings = {m.robot: m.source for m in maps}
        fuser = self.fuser if self.judged is None else self.judged.caught_up(self.fuser)
        fuser = fuser.without(set(fuser.latest) - set(recordings))  # who is refused by now is out of the sum
        return _finite(replace(fuser, recordings=recordings).grown(*maps))


def judged(fuser: OnlineFuser) -> OnlineFuser:
    """All maps of the fuser judged anew, without those that can't be; touches nothing but its own numbers."""

    def of(robots: Sequence[str]) -> OnlineFuser:
        return _finite(fuser.without(set(fuser.latest) - set(robots)).converged())

    return without_culprits(list(fuser.latest), of)[0] or OnlineFuser(fuser.cfg)


def _finite(fuser: OnlineFuser) -> OnlineFuser:
    if not all(np.isfinite(c.map.mean).all() and np.isfinite(c.map.cov).all() for c in fuser.fusion.components):
        raise EstimateError("its map has no finite place in that of the others")
    return fuser


@dataclass(slots=True)
class SharedMap:
    """The fusion of the newest snapshots and laser robots as they were woven last, in one frame where they are tied.

    used: robot -> message number of the snapshot that is in it; name: of the map process; tiles: the map that lasers
    made, its finest cells `resolution` [m] wide. Of a mixed team the part of most robots is number 1.
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
    joined: Joined = field(default_factory=Joined)
    ranged: RangedTeam = field(default_factory=RangedTeam)
    _met: list[str] = field(default_factory=list)
    _woven: WovenTeam | None = None
    _fused: Fused | None = None
    _fusions: int = 0
    _rangings: int = 0
    _judged: OnlineFuser | None = None

    def fusing(self, ledgers: Iterable[Ledger]) -> Fusing | None:
        """The newest snapshots where any is fresher than those of the map; None when none is."""
        snapshots = [
            (ledger, ledger.snapshot)
            for ledger in ledgers
            if ledger.snapshot is not None and isinstance(ledger.record, LandmarkRecord) and not ledger.fault
        ]
        used = {ledger.robot: s.last for ledger, s in snapshots}
        if used.items() <= self.used.items() and self._judged is None:
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
        for name in beyond(maps, MOST):
            del maps[name]
            refused.append(f"{name}: refused, its snapshot: over {MOST} landmarks are fused at the end alone")
        names = {m.robot: name for name, m in maps.items()}
        fuser = replace(self.fuser, cfg=self.cfg)
        return Fusing(fuser, tuple(maps.values()), names, used, refused, self._judged)

    def take_fused(self, fused: Fused) -> list[Tile]:
        """Landmark robots stand as they were fused; what can't be fused is said in `decisions`.

        The tiles that are not as they were told last, for a part may have another number.
        """
        self._fusions += 1
        self.used, self.fuser, self._fused, self._judged = dict(fused.used), fused.fuser, fused, None
        return self._laid_out()

    def take_judged(self, fuser: OnlineFuser) -> None:
        """All maps of some time ago, judged; those that came since are put in place of theirs when next it is fused."""
        self._judged = fuser

    def take(self, team: WovenTeam) -> list[Tile]:
        """Laser robots stand as `team` has them; the tiles that are not as they were told last."""
        self._woven = team
        return self._laid_out()

    def take_joined(self, joined: Joined) -> list[Tile]:
        """Parts lie to each other as `joined` has them; the tiles that are not as they were told last."""
        self.joined = joined
        return self._laid_out()

    def take_ranged(self, found: RangedTeam) -> list[Tile]:
        """Robots that range stand as they were `found`, in parts of their own; the tiles that others have then."""
        self.ranged, self._rangings = found, self._rangings + 1
        return self._laid_out()

    def _laid_out(self) -> list[Tile]:
        """Everybody placed anew: both kinds of parts, those that are tied in one frame and with one number."""
        woven, fused = self._woven, self._fused
        lasers = {} if woven is None else woven.placed
        components = [] if fused is None else list(fused.fuser.fusion.components)
        names = {} if fused is None else fused.names
        parts: dict[Part, dict[str, Float[np.ndarray, 3]]] = {}
        for name, placed in lasers.items():
            anchor = placed.frame if woven is None else woven.anchors.get(name, placed.frame)
            parts.setdefault((LASER, placed.component), {})[name] = anchor
        for k, component in enumerate(components, 1):
            parts[LANDMARKS, k] = {names[robot]: component.frames[robot] for robot in component.robots}
        lies = into_one_frame(parts, self.joined.tied)
        sighted = {
            name: s for name, s in self.joined.sighted.items() if any(s.to in anchors for anchors in parts.values())
        }
        number = _numbered(parts, {part: root for part, (root, _, _) in lies.items()}, sighted)
        self.placed, self.landmarks = {}, []
        for name, placed in lasers.items():
            self.placed[name] = replace(placed, component=number[LASER, placed.component])
        for k, component in enumerate(components, 1):
            _, T, cov = lies.get((LANDMARKS, k), (None, *UNMOVED))
            for robot in component.robots:
                if names[robot] not in sighted:
                    self.placed[names[robot]] = _place(number[LANDMARKS, k], component, robot, T, cov)
            if not parts[LANDMARKS, k].keys() <= sighted.keys():
                self.landmarks += _told(component, number[LANDMARKS, k], T, cov)
        for name, one in sighted.items():
            part = next(part for part, anchors in parts.items() if one.to in anchors)
            _, T, cov = lies.get(part, (None, *UNMOVED))
            self.placed[name] = _stands(number[part], one, np.asarray(se2.compose(T, parts[part][one.to])), cov)
        most = max((placed.component for placed in self.placed.values()), default=0)
        for name, placed in self.ranged.placed.items():
            self.placed[name] = replace(placed, component=most + placed.component)
        self.landmarks += [msgspec.structs.replace(b, component=most + b.component) for b in self.ranged.beacons]
        said = (*self.joined.decisions, *self.ranged.decisions)
        self.decisions = [*([] if woven is None else woven.decisions), *self._said(fused), *said]
        self.fused = self._fusions + self._rangings + (0 if woven is None else woven.number)
        self.meet(self._met)
        before, tiles = self.tiles, {} if woven is None else woven.tiles
        self.tiles = {(number.get((LASER, key[0]), key[0]), *key[1:]): cells for key, cells in tiles.items()}
        changed = [key for key, cells in self.tiles.items() if before.get(key) != cells]
        return [self.tile(key) for key in (*sorted(before.keys() - self.tiles.keys()), *changed)]

    @staticmethod
    def _said(fused: Fused | None) -> list[str]:
        if fused is None:
            return []
        fusion = fused.fuser.fusion
        return [
            *fused.refused,
            *(f"{fused.names[d.robot]}: {d.decision}, {d.reason}" for d in fusion.decisions),
            *(f"warning: {w}" for w in fusion.warnings),
        ]

    def tile(self, key: TileKey) -> Tile:
        """The tile as it is told; without cells where there is none any more."""
        component, level, i, j = key
        side = self.resolution * COARSER**level
        return Tile(
            map=self.name, component=component, level=level, i=i, j=j, cell=side, cells=self.tiles.get(key, b"")
        )

    def meet(self, lasers: Sequence[str]) -> bool:
        """A laser robot that is not woven yet stands in a part of its own; whether one is new."""
        self._met = list(lasers)
        new = [name for name in lasers if name not in self.placed]
        for name in new:
            self.placed[name] = Placed(max((p.component for p in self.placed.values()), default=0) + 1, *ALONE)
            self.decisions = [*self.decisions, f"{name}: in its own frame until its scans are worked in"]
        return bool(new)


def beyond(maps: Mapping[str, LocalMap], most: int) -> list[str]:
    """Whose maps are to be left out so that at most so many landmarks remain: those with most that nobody else has."""
    held = Counter(name for m in maps.values() for name in m.submap.ids)
    out: list[str] = []
    while len(held) > most:
        alone = {r: sum(held[name] == 1 for name in m.submap.ids) for r, m in maps.items() if r not in out}
        out.append(max(alone, key=lambda robot: (alone[robot], robot)))
        held -= Counter(maps[out[-1]].submap.ids)
    return out


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


def _numbered(
    parts: Mapping[Part, Mapping[str, object]], roots: Mapping[Part, Part], sighted: Mapping[str, SightedAt]
) -> dict[Part, int]:
    """The number of each part, that of most robots first; parts of one kind alone keep theirs."""
    if len({kind for kind, _ in parts}) < 2:
        return {part: part[1] for part in parts}
    size = Counter(roots.get(part, part) for part, anchors in parts.items() for name in anchors if name not in sighted)
    size.update(roots.get(p, p) for s in sighted.values() for p, anchors in parts.items() if s.to in anchors)
    order = sorted((part for part in parts if part not in roots), key=lambda part: -size[part])
    number = {part: k for k, part in enumerate(order, 1)}
    return {part: number[roots.get(part, part)] for part in parts}


def _place(
    number: int, component: Component, robot: str, T: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
) -> Placed:
    """Where a robot's frame stands, its component lying at `T` with covariance `cov`."""
    frame = component.frames[robot]
    whole = se2.composed_covariance(T, cov, frame, component.frame_cov[robot])
    return Placed(number, np.asarray(se2.compose(T, frame)), whole, component.scales.get(robot, 1.0))


def _stands(number: int, sighted: SightedAt, anchor: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]) -> Placed:
    """Where the frame stands of a robot that was sighted from `anchor`, whose part lies with covariance `cov`."""
    pose = np.asarray(se2.compose(anchor, sighted.at))
    frame = np.asarray(se2.compose(pose, se2.inverse(sighted.told)))
    lever = np.linalg.inv(se2.compose_jacobians(frame, sighted.told)[0])
    spread = se2.turned_covariance(float(anchor[2]), sighted.cov) + cov
    return Placed(number, frame, lever @ spread @ lever.T, 1.0, own=False)


def _told(
    component: Component, number: int, T: Float[np.ndarray, "3"], cov: Float[np.ndarray, "3 3"]
) -> list[LandmarkState]:
    """The landmarks of a component that lies at `T` with covariance `cov`."""
    out = []
    R, own = se2.rotation(T[2]), component.map.cov
    for i, (name, place) in enumerate(zip(component.map.ids, component.map.mean, strict=True)):
        J = se2.compose_jacobians(T, np.append(place, 0.0))[0][:2]
        block = R @ own[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] @ R.T + J @ cov @ J.T
        x, y = se2.act(T, place).tolist()
        numbers = (float(block[0, 0]), float(block[0, 1]), float(block[1, 1]))
        out.append(LandmarkState(id=name, x=x, y=y, cov=numbers, component=number))
    return out
