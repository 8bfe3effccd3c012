"""Walls as segments: distance, touch, inside, the raster of places too near to them; an index for beams and robots."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..kernels.walls.segments import (
    Raster,
    distance_to_walls,
    enclosed,
    enclosed_cells,
    free_share,
    mark_near,
)
from ..kernels.walls.wall_grid import WallBuckets, cast_in_grid, drive_discs, fill_buckets, touches_wall
from . import se2
from .records import freeze, frozen

PAINT = 0.6  # reflectance of a wall of which nothing else is known


@dataclass(frozen=True, slots=True)
class Walls:
    """segments: (s, 4) as x0 y0 x1 y1 [m]; reflectance: (s,), 1 for a surface that sends all light back.

    solid: the segments close up, and what they enclose is wall too (even-odd); else they are thin.
    """

    segments: Float[np.ndarray, "s 4"]
    reflectance: Float[np.ndarray, " s"]
    solid: bool = False

    def __post_init__(self) -> None:
        freeze(self, "segments", "reflectance")

    @classmethod
    def of(cls, segments: Float[np.ndarray, "s 4"], *, solid: bool = False) -> "Walls":
        """Walls of plain paint."""
        return cls(segments, np.full(len(segments), PAINT), solid)

    def clearance(self, points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Distance [m] to the nearest wall: 0 inside a solid one, infinite where there is no wall at all."""
        out = distance_to_walls(frozen(points), self.segments)
        out[self.inside(points)] = 0.0
        return np.asarray(out)

    def inside(self, points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Which points a solid wall encloses; none when walls are thin."""
        if not self.solid:
            return np.zeros(len(points), dtype=bool)
        return np.asarray(enclosed(frozen(points), self.segments))

    def free_share(self, a: Float[np.ndarray, "2"], b: Float[np.ndarray, "2"], radius: float) -> float:
        """How much (0 to 1) of the move a -> b a disc of `radius` [m] makes before it would touch a wall."""
        return float(free_share(frozen(a), frozen(b), radius, self.segments))

    def blocked(
        self, lower: Float[np.ndarray, "2"], upper: Float[np.ndarray, "2"], cell: float, radius: float
    ) -> Bool[np.ndarray, "rows cols"]:
        """Cells of the rectangle (row 0 lowest y) whose centre is nearer than `radius` to a wall, or inside one."""
        cols, rows = (int(np.ceil((upper[k] - lower[k]) / cell - 1e-9)) for k in (0, 1))
        out, raster = np.zeros((rows, cols), dtype=bool), Raster(frozen(lower), cell)
        mark_near(out, self.segments, radius, raster)
        if self.solid:
            out |= enclosed_cells(self.segments, raster, rows, cols)
        return out


def walls_of_raster(
    occupied: Bool[np.ndarray, "rows cols"],
    origin: Float[np.ndarray, "3"],
    resolution: float,
) -> Walls:
    """Solid walls: the boundary of the occupied cells (row 0 lowest y), merged into long segments.

    origin: (3,) pose of the raster's lower left corner; resolution: cell side [m].
    """
    padded = np.pad(occupied, 1)
    upright = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)  # lines x = k, cells run along y
    level = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])  # lines y = k, cells run along x
    lines = np.vstack([upright[:, [0, 1, 0, 2]], level[:, [1, 0, 2, 0]]]) * resolution
    ends = se2.act(origin, lines.reshape(-1, 2)).reshape(-1, 4)
    return Walls.of(ends, solid=True)


def _runs(edges: Bool[np.ndarray, "lines cells"]) -> Float[np.ndarray, "s 3"]:
    """Every run of True along a line, as (line, first, one past the last)."""
    steps = np.diff(np.pad(edges, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    line, first = np.nonzero(steps == 1)
    _, last = np.nonzero(steps == -1)
    return np.column_stack([line, first, last]).astype(float)


BUCKET = 1.0  # [m]


@dataclass(frozen=True, slots=True)
class WallIndex:
    """segments: (s, 4) as x0 y0 x1 y1 [m]; the rest says which of them touch which square of `BUCKET`."""

    segments: Float[np.ndarray, "s 4"]
    corner: Float[np.ndarray, "2"]
    cols: int
    first: Int[np.ndarray, " b"]
    items: Int[np.ndarray, " k"]

    @classmethod
    def of(cls, segments: Float[np.ndarray, "s 4"]) -> "WallIndex":
        walls = frozen(np.asarray(segments, float).reshape(-1, 4))
        ends = walls.reshape(-1, 2) if len(walls) else np.zeros((1, 2))
        corner = frozen(np.floor(ends.min(axis=0)) - BUCKET)
        cols, rows = (np.floor((ends.max(axis=0) - corner) / BUCKET).astype(int) + 2).tolist()
        first, items = fill_buckets(walls, corner, BUCKET, rows, cols)
        return cls(walls, corner, cols, frozen(first, np.int64), frozen(items, np.int64))

    def cast(
        self, sensor: Float[np.ndarray, "m 3"], angles: Float[np.ndarray, " n"], discs: np.ndarray, far: float
    ) -> tuple[Float[np.ndarray, "m n"], Int[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
        """Range [m], what was hit and the cosine of incidence of every beam, as `kernels.raycast.cast` gives them."""
        return cast_in_grid(np.ascontiguousarray(sensor), angles, discs, far, self._buckets)

    def touches(self, points: Float[np.ndarray, "n 2"], radius: float) -> Bool[np.ndarray, " n"]:
        """Whether a disc around each point touches a wall."""
        return touches_wall(np.ascontiguousarray(points, dtype=float), radius, self._buckets)

    def drive(
        self, poses: Float[np.ndarray, "m 3"], commands: Float[np.ndarray, "m 2"], period: float, radius: float
    ) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """Poses after one period on arcs (v, w), and who was stopped short of a wall or of another robot."""
        return drive_discs(
            np.ascontiguousarray(poses),
            np.ascontiguousarray(commands),
            period,
            PARTS,
            radius,
            self._buckets,
        )

    @property
    def _buckets(self) -> WallBuckets:
        return WallBuckets(self.segments, self.corner, BUCKET, self.cols, self.first, self.items)


PARTS = 20  # of a period in which touching is looked for
