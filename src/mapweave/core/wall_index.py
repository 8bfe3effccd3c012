"""Walls of a whole building, asked by beams and by robots: where a beam ends, whether a disc touches."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..kernels.walls.wall_grid import WallBuckets, cast_in_grid, drive_discs, fill_buckets, touches_wall
from .arrays import frozen

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
