"""Worlds that are driven with a laser: an office room by room, a ring of corridor, a long tunnel."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ..core.config import config
from ..core.errors import DataError
from ..core.records import frozen
from ..core.walls import PAINT
from .laser import (
    DriftConfig,
    DriveConfig,
    LaserSimulation,
    LaserWorld,
    Route,
    Stretch,
    WallStyle,
    WorldBuilder,
    drive,
    ring,
    stream,
    through,
)

FLOOR_ASPECT = 1.5  # aspect
FLOOR_CORRIDOR = 2.0  # corridor
FLOOR_WALL = 0.1  # wall
FLOOR_DOOR = 1.0  # door
ROOM_DEPTH = 4.2  # room depth
ROOM_WIDTH = (3.2, 6.0)  # room width
FLOOR_BLOCK = (13.0, 9.0)  # between corridors, about
TWO_ROWS = 6.5  # a block at least as deep has rooms on both sides
HALL_SHARE = 0.25  # of blocks are one open-plan hall
THROUGH_SHARE = 0.15  # of neighbouring rooms have a door between them
POCKET_AREA = 2000.0  # [m^2] of floor a pocket, on average
FLOOR_SLIT = 0.25  # a pocket's door, when it has one: too narrow for a robot, wide enough for a beam
FLOOR_APART = 1.5  # between the robots' starts, along a corridor
CONCRETE = 0.35  # reflectance of a tunnel's walls
MARK_GAP, MARK_WIDTH = (1.0, 4.0), (0.1, 0.4)  # [m] between marks on one side, and of one, from, to
GLASS_SHOWN = 0.95  # cosine of incidence from which on a pane returns light
MARK = (0.85, 1.0)  # reflectance of a mark, from, to


@config
class CorridorConfig:
    """The ring of [Hara07]'s kind: two long legs that are flush, two short ones with recessed doors."""

    long_leg: float = 60.0  # [m] along the middle of a long side of the ring
    short_leg: float = 30.0  # [m] along the middle of a short side of the ring
    width: float = 2.5  # [m] from wall to wall
    recess: float = 0.12  # [m] doors of the short legs stand back
    distance: float = 200.0  # [m] driven
    corner: float = 1.2  # [m] radius of the driven corners
    start: float = 15.0  # [m] after the first corner of a long leg, where the drive begins
    drive: DriveConfig = field(default_factory=DriveConfig)


def corridor_world(cfg: CorridorConfig, seed: int) -> LaserWorld:
    """The walls, in the frame of the robot's first pose."""
    build = WorldBuilder("corridor", WallStyle(), stream(seed, "walls"))
    half = 0.5 * cfg.width
    for side in (half, -half):  # the outer wall runs round to the left, the inner one to the right
        x0, y0, x1, y1 = -cfg.start - side, -side, cfg.long_leg - cfg.start + side, cfg.short_leg + side
        corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
        if side < 0:
            corners.reverse()
        for a, b in pairwise(corners):
            build.wall(a, b, recess=0.0 if a[1] == b[1] else cfg.recess)
    return build.world()


def simulate_corridor(cfg: CorridorConfig | None = None, seed: int = 0) -> LaserSimulation:
    """One drive round the ring and on, over the place where it began."""
    cfg = cfg or CorridorConfig()
    route = ring(cfg.long_leg, cfg.short_leg, cfg.corner, cfg.distance, cfg.start)
    return drive(corridor_world(cfg, seed), route, cfg.drive, seed)


@config
class TunnelConfig:
    """A long tunnel without features but reflective marks on its walls, driven down and back."""

    length: float = 80.0  # [m] from end to end
    width: float = 3.0  # [m] from wall to wall
    drive: DriveConfig = field(default_factory=lambda: DriveConfig(drift=DriftConfig(end_error=(3.0, 6.0))))


def tunnel_world(cfg: TunnelConfig, seed: int) -> LaserWorld:
    """The walls along x from -2 m on, the ends closed but out of sight for most of the way."""
    rng = stream(seed, "walls")
    build = WorldBuilder("tunnel", WallStyle(paint=CONCRETE, mottle=0.02), rng)
    half, x0, x1 = 0.5 * cfg.width, -2.0, cfg.length - 2.0
    build.marked((x0, -half), (x1, -half), _marks(cfg.length, rng))
    build.plain((x1, -half), (x1, half))
    build.marked((x1, half), (x0, half), _marks(cfg.length, rng))
    build.plain((x0, half), (x0, -half))
    return build.world()


def _marks(length: float, rng: np.random.Generator) -> list[Stretch]:
    out: list[Stretch] = []
    at = float(rng.uniform(*MARK_GAP))
    while (end := at + float(rng.uniform(*MARK_WIDTH))) < length:
        out.append((at, end, float(rng.uniform(*MARK)), 0.0))
        at = end + float(rng.uniform(*MARK_GAP))
    return out


def tunnel_route(cfg: TunnelConfig) -> Route:
    """Down the tunnel, round at its end, and back past the start's marks."""
    turn = 0.3 * cfg.width
    straight = cfg.length - 4.0 - turn
    arc = (np.pi * turn, 1.0 / turn)
    start = np.array([0.0, -turn, 0.0])
    return Route(start, np.array([straight, arc[0], straight]), np.array([0.0, arc[1], 0.0]))


def simulate_tunnel(cfg: TunnelConfig | None = None, seed: int = 0) -> LaserSimulation:
    """There and back."""
    cfg = cfg or TunnelConfig()
    return drive(tunnel_world(cfg, seed), tunnel_route(cfg), cfg.drive, seed)


DOORWAY = 1.0  # [m]


OFFICE_STYLE = WallStyle(gap=(0.6, 2.0))


@config
class OfficeConfig:
    """An office floor to drive through with a laser: a corridor, rooms on either side, some of them visited."""

    rooms: int = 4  # on each side of the corridor
    room_width: float = 5.0  # [m] along the corridor
    room_depth: float = 4.5  # [m] away from it
    corridor: float = 2.2  # [m]
    visited: int = 5  # rooms driven into, at most all
    glazed: float = 0.0  # share of the rooms whose wall to the corridor is glass
    drive: DriveConfig = field(default_factory=lambda: DriveConfig(drift=DriftConfig(end_error=(2.0, 4.0))))


def office_world(cfg: OfficeConfig, seed: int) -> LaserWorld:
    """The walls; the corridor runs along x with its middle on y = 0, the first room begins at x = 0."""
    rng = stream(seed, "walls")
    panes = stream(seed, "glass").random((2, cfg.rooms)) < cfg.glazed
    build = WorldBuilder("office", OFFICE_STYLE, rng)
    half, length, far = 0.5 * cfg.corridor, cfg.rooms * cfg.room_width, 0.5 * cfg.corridor + cfg.room_depth
    build.wall((0.0, half), (0.0, -half))
    build.wall((length, -half), (length, half))
    for side in (1.0, -1.0):
        for k in range(cfg.rooms):
            x0, x1 = k * cfg.room_width, (k + 1) * cfg.room_width
            door = 0.5 * (x0 + x1)
            build.shown = GLASS_SHOWN if panes[int(side > 0.0), k] else 0.0
            for a, b in ((x0, door - 0.5 * DOORWAY), (door + 0.5 * DOORWAY, x1)):
                for y in (half, half + 0.1):
                    build.wall((a, side * y), (b, side * y))
            build.shown = 0.0
            for jamb in (door - 0.5 * DOORWAY, door + 0.5 * DOORWAY):
                build.plain((jamb, side * half), (jamb, side * (half + 0.1)), 0.4)
            build.wall((x0, side * (half + 0.1)), (x0, side * far))
            build.wall((x1, side * (half + 0.1)), (x1, side * far))
            build.wall((x0, side * far), (x1, side * far))
            _furnish(build, rng, x0, side, far, cfg)
    return build.world()


def _furnish(
    build: WorldBuilder, rng: np.random.Generator, x0: float, side: float, far: float, cfg: OfficeConfig
) -> None:
    """Desks along the far wall and a cabinet by the side, clear of where the robot goes."""
    for x in (x0 + 0.1, x0 + cfg.room_width - 1.5):
        if rng.random() < 0.8:
            deep = float(rng.uniform(0.5, 0.8))
            build.box(x, min(side * far, side * (far - deep)), 1.4, deep, float(rng.uniform(0.2, 0.7)))
    if rng.random() < 0.7:
        y = side * (far - float(rng.uniform(1.6, 2.2)))
        build.box(x0 + 0.02, y, 0.4, 0.5, float(rng.uniform(0.1, 0.9)))


def office_route(cfg: OfficeConfig, seed: int) -> Route:
    """Along the corridor, into `visited` rooms chosen by chance, round in each, and back to the start."""
    rng = stream(seed, "rooms")
    every = [(k, side) for k in range(cfg.rooms) for side in (1, -1)]
    chosen = sorted(rng.choice(len(every), min(cfg.visited, len(every)), replace=False).tolist())
    half = 0.5 * cfg.corridor
    points = [(0.8, 0.0)]
    for k, side in (every[c] for c in chosen):
        x = (k + 0.5) * cfg.room_width
        near, far, wide = half + 0.8, half + cfg.room_depth - 1.7, 0.5 * cfg.room_width - 1.2
        inside = [
            (x, near),
            (x + wide, near),
            (x + wide, far),
            (x - wide, far),
            (x - wide, near + 0.5),
            (x - 0.3, near),
        ]
        points += [
            (x - 0.3, 0.1 * side),
            *((px, side * py) for px, py in inside),
            (x - 0.3, 0.3 * side),
            (x + 0.4, 0.0),
        ]
    end = cfg.rooms * cfg.room_width - 0.8
    points += [(end, -0.4), (end, 0.4), (0.8, 0.3)]
    return through(points, 0.35)


def simulate_office(cfg: OfficeConfig | None = None, seed: int = 0) -> LaserSimulation:
    """One round through the office, there and back along the corridor."""
    cfg = cfg or OfficeConfig()
    return drive(office_world(cfg, seed), office_route(cfg, seed), cfg.drive, seed)


Box = tuple[float, float, float, float]  # x0 y0 x1 y1 [m]
LEAST, GREATEST = 150.0, 20_000.0  # [m^2]
SOLID, FREE, DESK = 0, 1, 2
OUTSIDE = 5.0  # [m] of solid all round the building
FLOOR_STYLE = WallStyle(gap=(0.6, 2.5))
LEAST_GAP = 1.1  # [m] between pieces of furniture, where there is one


@dataclass(frozen=True, slots=True)
class OfficeFloor:
    """world: its walls; lower, upper: (2,) its outer corners [m]; starts: (k, 3) where robots may begin, all clear of
    walls and of each other; rooms: (n, 4) boxes of every room and hall; pockets: (p, 4) those no robot can enter.
    """

    world: LaserWorld
    lower: Float[np.ndarray, "2"]
    upper: Float[np.ndarray, "2"]
    starts: Float[np.ndarray, "k 3"]
    rooms: Float[np.ndarray, "n 4"]
    pockets: Float[np.ndarray, "p 4"]


def office_floor(area: float, seed: int) -> OfficeFloor:
    """A floor of `area` [m^2] outside, the same for the same seed. Raises DataError for an area that cannot be."""
    if not LEAST <= area <= GREATEST:
        raise DataError(f"an office of {area:g} m^2: expected {LEAST:g} to {GREATEST:g}")
    plan = _Plan(area, stream(seed, "floor"))
    world = plan.walls(f"office-{area:g}", stream(seed, "walls"))
    boxes = [np.array(b, dtype=float).reshape(-1, 4) for b in (plan.rooms, plan.pockets)]
    return OfficeFloor(
        world, frozen(np.zeros(2)), frozen(plan.size), frozen(plan.starts()), frozen(boxes[0]), frozen(boxes[1])
    )


@dataclass(slots=True)
class _Plan:
    """Free boxes (corridors, rooms, doorways) and desks, laid out when it is made."""

    area: float
    rng: np.random.Generator
    size: np.ndarray = field(init=False)
    corridors: list[Box] = field(default_factory=list)
    rooms: list[Box] = field(default_factory=list)
    pockets: list[Box] = field(default_factory=list)
    doors: list[Box] = field(default_factory=list)
    desks: list[Box] = field(default_factory=list)

    def __post_init__(self) -> None:
        wide = float(np.round(np.sqrt(FLOOR_ASPECT * self.area), 2))
        high = float(np.round(self.area / wide, 2))
        self.size = np.array([wide, high])
        lanes = max(
            1 if high < 2 * ROOM_DEPTH + 2 * FLOOR_CORRIDOR + 3 else 2,
            round((high - 2 * ROOM_DEPTH + FLOOR_BLOCK[1]) / (FLOOR_BLOCK[1] + FLOOR_CORRIDOR)),
        )
        depth = ROOM_DEPTH if lanes > 1 else 0.5 * (high - FLOOR_CORRIDOR)
        ys = np.linspace(depth, high - depth - FLOOR_CORRIDOR, lanes)
        cross = 0 if lanes == 1 else max(2, round((wide - FLOOR_BLOCK[0]) / (FLOOR_BLOCK[0] + FLOOR_CORRIDOR)))
        block = (wide - cross * FLOOR_CORRIDOR) / (cross + 1)
        xs = block * np.arange(1, cross + 1) + FLOOR_CORRIDOR * np.arange(cross)
        self.corridors = [(0.0, float(y), wide, float(y) + FLOOR_CORRIDOR) for y in ys]
        self.corridors += [(float(x), float(ys[0]), float(x) + FLOOR_CORRIDOR, float(ys[-1])) for x in xs]
        self._row(0.0, wide, float(ys[-1]) + FLOOR_CORRIDOR + FLOOR_WALL, high, door_below=True)
        self._row(0.0, wide, 0.0, float(ys[0]) - FLOOR_WALL, door_below=False)
        left = np.concatenate([[0.0], xs + FLOOR_CORRIDOR + FLOOR_WALL])
        right = np.concatenate([xs - FLOOR_WALL, [wide]])
        for y0, y1 in zip(ys[:-1] + FLOOR_CORRIDOR + FLOOR_WALL, ys[1:] - FLOOR_WALL, strict=True):
            for x0, x1 in zip(left, right, strict=True):
                self._block(float(x0), float(x1), float(y0), float(y1))

    def _block(self, x0: float, x1: float, y0: float, y1: float) -> None:
        if self.rng.random() < HALL_SHARE:
            self._hall((x0, y0, x1, y1))
        elif y1 - y0 >= TWO_ROWS:
            middle = y0 + float(self.rng.uniform(0.42, 0.58)) * (y1 - y0)
            self._row(x0, x1, y0, middle - 0.5 * FLOOR_WALL, door_below=True)
            self._row(x0, x1, middle + 0.5 * FLOOR_WALL, y1, door_below=False)
        else:
            self._row(x0, x1, y0, y1, door_below=bool(self.rng.random() < 0.5))

    def _row(self, x0: float, x1: float, y0: float, y1: float, *, door_below: bool) -> None:
        """Rooms side by side, each with a door to the corridor below or above, or with none: a pocket."""
        rng = self.rng
        count = max(1, round((x1 - x0) / float(rng.uniform(*ROOM_WIDTH))))
        share = rng.uniform(0.8, 1.25, count)
        cuts = x0 + (x1 - x0) * np.concatenate([[0.0], np.cumsum(share) / share.sum()])
        last = False
        for k in range(count):
            box = (
                float(cuts[k]) + 0.5 * FLOOR_WALL * (k > 0),
                y0,
                float(cuts[k + 1]) - 0.5 * FLOOR_WALL * (k < count - 1),
                y1,
            )
            shut = (
                rng.random() < (box[2] - box[0]) * (y1 - y0) / POCKET_AREA * 1.4
            )  # 1.4: of a floor seven tenths are rooms
            width = FLOOR_DOOR if not shut else FLOOR_SLIT if rng.random() < 0.5 else 0.0
            at = float(rng.uniform(box[0] + 0.4, box[2] - 0.4 - FLOOR_DOOR))
            if width:
                self.doors.append(
                    (at, y0 - FLOOR_WALL, at + width, y0) if door_below else (at, y1, at + width, y1 + FLOOR_WALL)
                )
            if shut:
                self.pockets.append(box)
            else:
                self._furnish(box, door_below=door_below)
            if k and not shut and not last and rng.random() < THROUGH_SHARE:
                y = y0 + 0.7 if door_below else y1 - 0.7 - FLOOR_DOOR
                self.doors.append((box[0] - FLOOR_WALL, y, box[0], y + FLOOR_DOOR))
            last = bool(shut)
            self.rooms.append(box)

    def _furnish(self, box: Box, *, door_below: bool) -> None:
        """Desks along the wall across from the door and perhaps a cabinet in its corner, flush with their walls.

        Between them is room for a robot or no room at all.
        """
        rng, (x0, y0, x1, y1) = self.rng, box
        deep, at, end = float(rng.uniform(0.6, 0.8)), x0, x1
        if rng.random() < 0.5 and y1 - y0 > 3.4:
            tall, left = float(rng.uniform(0.8, 1.2)), bool(rng.random() < 0.5)
            at, end = (x0 + 0.45, x1) if left else (x0, x1 - 0.45)
            x = x0 if left else end
            self.desks.append((x, y1 - tall, x + 0.45, y1) if door_below else (x, y0, x + 0.45, y0 + tall))
        while at + 1.4 <= end:
            if rng.random() < 0.7:
                to = at + 1.4 if end - at - 1.4 > LEAST_GAP else end
                self.desks.append((at, y1 - deep, to, y1) if door_below else (at, y0, to, y0 + deep))
                at = to + (0.0 if rng.random() < 0.5 else LEAST_GAP)
            else:
                at += LEAST_GAP

    def _hall(self, box: Box) -> None:
        """An open-plan hall: islands of desks, two doors below and two above."""
        rng, (x0, y0, x1, y1) = self.rng, box
        for y in (y0 - FLOOR_WALL, y1):
            for share in (0.25, 0.75):
                at = x0 + share * (x1 - x0) - 0.5 * FLOOR_DOOR + float(rng.uniform(-0.8, 0.8))
                self.doors.append((at, y, at + FLOOR_DOOR, y + FLOOR_WALL))
        nx, ny = int((x1 - x0 - 1.3) / 3.0), int((y1 - y0 - 1.3) / 2.9)
        gx, gy = ((x1 - x0) - 1.6 * nx) / (nx + 1), ((y1 - y0) - 1.4 * ny) / (ny + 1)
        for i in range(nx):
            for k in range(ny):
                if rng.random() < 0.8:
                    x, y = x0 + gx + i * (1.6 + gx), y0 + gy + k * (1.4 + gy)
                    self.desks.append((x, y, x + 1.6, y + 1.4))
        self.rooms.append(box)

    def starts(self) -> np.ndarray:
        """Poses along the lowest corridor from its middle outwards, facing away from it by turns."""
        wide, _ = self.size
        x0, y0, x1, y1 = self.corridors[0]
        places = int((x1 - x0 - 1.5) / FLOOR_APART)
        side = [(k + 1) // 2 * (1 if k % 2 else -1) for k in range(places)]
        return np.array([(0.5 * wide + FLOOR_APART * s, 0.5 * (y0 + y1), 0.0 if s > 0 else np.pi) for s in side])

    def walls(self, name: str, rng: np.random.Generator) -> LaserWorld:
        """The borders of what is free, painted; a desk has one shade all round. All that is not free is solid."""
        build = WorldBuilder(name, FLOOR_STYLE, rng)
        desk_light = rng.uniform(0.2, 0.8, len(self.desks))
        free = [*self.corridors, *self.rooms, *self.doors]
        edges = np.round(np.array([*free, *self.desks, (0.0, 0.0, *self.size)]), 6)
        xs, ys = np.unique(edges[:, [0, 2]]), np.unique(edges[:, [1, 3]])
        kind = np.full((len(ys) + 1, len(xs) + 1), SOLID)  # one row and column of outside all round
        for k, (x0, y0, x1, y1) in enumerate(edges[: len(free) + len(self.desks)]):
            c0, c1 = np.searchsorted(xs, [x0, x1]) + 1
            r0, r1 = np.searchsorted(ys, [y0, y1]) + 1
            kind[r0:r1, c0:c1] = FREE if k < len(free) else DESK + k - len(free)
        for a, b, what in _borders(kind, xs, ys):
            if what == SOLID:
                build.wall(a, b)
            else:
                build.plain(a, b, float(desk_light[what - DESK]))
        wide, high = self.size
        build.box(-OUTSIDE, -OUTSIDE, wide + 2 * OUTSIDE, high + 2 * OUTSIDE, PAINT)  # what lies between is solid
        return replace(build.world(), solid=True)


def _borders(
    kind: np.ndarray, xs: np.ndarray, ys: np.ndarray
) -> list[tuple[tuple[float, float], tuple[float, float], int]]:
    """Where free cells meet others, as (from, to, kind of the other) with the free side on the left."""
    out = []
    for swapped, grid, across, along in ((False, kind, ys, xs), (True, kind.T, xs, ys)):
        for k in range(grid.shape[0] - 1):
            low, high = grid[k], grid[k + 1]
            for free_above in (True, False):
                inside, other = (high, low) if free_above else (low, high)
                runs = np.where((inside == FREE) & (other != FREE), other, -1)
                for start, end in _runs(runs):
                    a, b = float(along[start - 1]), float(along[end - 1])
                    ends = ((a, float(across[k])), (b, float(across[k])))
                    if swapped:
                        ends = ((ends[0][1], ends[0][0]), (ends[1][1], ends[1][0]))
                    if free_above == swapped:
                        ends = (ends[1], ends[0])
                    out.append((*ends, int(runs[start])))
    return out


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Stretches [start, end) of one value that is not -1."""
    cuts = np.flatnonzero(np.diff(values)) + 1
    bounds = np.concatenate([[0], cuts, [len(values)]])
    return [(a, b) for a, b in pairwise(bounds.tolist()) if values[a] != -1]
