"""Everything one laser robot hands over: where it drove, what every scan did to the estimate, its map.

A map is a grid whose cells hold their mean point and mean feature.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from ..core.errors import UsageError
from ..core.findings import Finding, Unused
from ..core.fixes import Fixes
from ..core.records import Track, freeze, frozen
from ..core.rows import RowBuffer
from .beam import IntensityCalibration
from .odometry_calibration import OdometryCalibration
from .robot_graph import RobotGraph
from .scan_odometry import ScanInfo

if TYPE_CHECKING:
    from xarray import Dataset

__all__ = ["GridMap", "IntensityCalibration"]

OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.196  # probabilities of a wall, as ROS navigation's own thresholds are

FAR = 1e4  # [m] from the frame's origin, beyond which four bytes round points to more than half a millimetre


@dataclass(frozen=True, slots=True)
class GridMap:
    """Occupancy and intensity over one rectangle of square cells, row 0 lowest y, column 0 lowest x.

    resolution: cell side [m]; origin: (2,) lower-left corner [m] in `frame`; hits, passes: (rows, cols), returns in a
    cell and beams through it; mean: (rows, cols, 2), mean point of the returns [m]; feature: (rows, cols), their mean
    q; weight: (rows, cols), summed insertion weight, 0 where nothing was ever returned.
    """

    resolution: float
    origin: Float[np.ndarray, "2"]
    hits: Int[np.ndarray, "rows cols"]
    passes: Int[np.ndarray, "rows cols"]
    mean: Float[np.ndarray, "rows cols 2"]
    feature: Float[np.ndarray, "rows cols"]
    weight: Float[np.ndarray, "rows cols"]
    frame: str = "map"
    writer: ClassVar["Callable[[GridMap, Path], None]"]  # given by the room that writes files

    def __post_init__(self) -> None:
        freeze(self, "origin")
        freeze(self, "hits", "passes", dtype=np.int32)
        freeze(self, "feature", "weight", dtype=np.float32)
        far = np.abs(self.origin).max() > FAR
        object.__setattr__(self, "mean", frozen(self.mean, np.float64 if far else np.float32))

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols = self.hits.shape
        return int(rows), int(cols)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x min, x max, y min, y max) [m], as a plotter wants it with row 0 lowest."""
        rows, cols = self.shape
        x, y = float(self.origin[0]), float(self.origin[1])
        return x, x + cols * self.resolution, y, y + rows * self.resolution

    def occupancy(self) -> Float[np.ndarray, "rows cols"]:
        """Probability that a cell is occupied: the mean of a beta prior (1/2, 1/2) after its beams; unseen: 0.5."""
        hits, passes = self.hits.astype(float), self.passes.astype(float)
        return np.asarray((hits + 0.5) / (hits + passes + 1.0))

    def to_numpy(self) -> Int8[np.ndarray, "rows cols"]:
        """What a planner needs of every cell: 0 free, 100 occupied, -1 unknown, as ROS navigation holds it."""
        p = self.occupancy()
        return np.where(p < FREE_BELOW, 0, np.where(p > OCCUPIED_ABOVE, 100, -1)).astype(np.int8)

    def to_xarray(self) -> "Dataset":
        """Cells as xarray holds them, over `y` and `x`, their centres [m]: `occupancy`, the probability of a wall, NaN
        where nobody looked, `hits` and `passes`. Needs the extra `[xarray]`; raises UsageError without it.
        """
        try:
            from xarray import Dataset  # noqa: PLC0415  (only who asks for it needs it)
        except ModuleNotFoundError:
            raise UsageError("to_xarray needs xarray: install mapweave with the extra [xarray]") from None
        seen = np.where(self.hits + self.passes > 0, self.occupancy(), np.nan)
        cells = {"occupancy": seen, "hits": self.hits, "passes": self.passes}
        x, y = (o + self.resolution * (np.arange(n) + 0.5) for o, n in zip(self.origin, self.shape[::-1], strict=True))
        metres = {"units": "m"}
        coords = {"y": ("y", y, metres), "x": ("x", x, metres)}
        told = {"resolution": self.resolution, "frame": self.frame}
        return Dataset({name: (("y", "x"), values) for name, values in cells.items()}, coords, told)

    def save(self, path: Path | str) -> None:
        """`path`, as `map.yaml`, and the picture `map.pgm` beside it hold the map as ROS navigation reads it."""
        GridMap.writer(self, Path(path))

    def cells(self) -> Float[np.ndarray, "n 4"]:
        """Every cell with a return as (x, y, q, W), in row order."""
        rows, cols = np.nonzero(self.weight > 0)
        return np.column_stack(
            [self.mean[rows, cols].astype(float), self.feature[rows, cols], self.weight[rows, cols]]
        ).astype(float)

    def free_cells(self, least_passes: int) -> Float[np.ndarray, "n 2"]:
        """Centres [m] of the cells that beams went through, `least_passes` at least, and (nearly) none ended in."""
        rows, cols = np.nonzero((self.passes >= least_passes) & (self.passes > 5 * self.hits))
        return np.asarray(self.origin + self.resolution * (np.column_stack([cols, rows]) + 0.5))


@dataclass(frozen=True, slots=True)
class ScanRecords:
    """One row a scan, in the order the scans came.

    t: (n,) [s]; host: who wrote it; pose: (n, 3) in the track's frame; innovation: (n, 3), matched pose seen from the
    pose odometry predicted [m, m, rad]; beams: returns in the scan; matches: returns that found a partner;
    decision: "first", "matched", "odometry" (the gate or too few matches refused the match), "skipped" (the robot
    had hardly moved), "unseen" (it looked elsewhere than before, so that odometry was taken) or "empty" (no returns);
    n_eff: effective number of particles, NaN where no weights changed; resampled: (n,); information: (n, 3, 3), of each
    pose seen from the one before [1/m^2, 1/rad^2], where the method gives it (row 0 tells nothing).
    """

    t: Float[np.ndarray, " n"]
    host: tuple[str, ...]
    pose: Float[np.ndarray, "n 3"]
    innovation: Float[np.ndarray, "n 3"]
    beams: Int[np.ndarray, " n"]
    matches: Int[np.ndarray, " n"]
    decision: tuple[str, ...]
    n_eff: Float[np.ndarray, " n"]
    resampled: Bool[np.ndarray, " n"]
    information: Float[np.ndarray, "n 3 3"] | None = None

    def __post_init__(self) -> None:
        freeze(self, "information", "t", "pose", "innovation", "n_eff")
        freeze(self, "beams", "matches", dtype=np.int64)
        freeze(self, "resampled", dtype=np.bool_)

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, slots=True)
class LaserMap:
    """One robot's laser map in `local_k` (its first pose), as an estimator leaves it.

    method: "graph", "particle", "gated" or "icp"; feature: the one really used (`none` when the log's intensity says
    nothing); odometry: "poses" or "none"; dead_reckoning: odometry alone at the same stamps, None without odometry;
    graph: keyframes, steps and closures, None of the other methods; called: the robot's name in its recording, empty
    where it has none; scan_hash: of the stamps and ranges of all scans; odometry_calibration: what the log tells of its
    wheels and its scanner's mounting, and what of that the map was made with (stamps of late scans are those of the
    wheels' clock then), None where it tells nothing and of the other methods; unused: what was recorded beside and no
    reader took; fixes: where the robot was, as something outside it tells.
    """

    robot: str
    method: str
    feature: str
    track: Track
    grid: GridMap
    scans: ScanRecords
    odometry: str = "poses"
    dead_reckoning: Track | None = None
    calibration: IntensityCalibration | None = None
    particles: int = 1
    source: str = ""
    log_hash: str = ""
    dropped: Mapping[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
    graph: RobotGraph | None = None
    called: str = ""
    scan_hash: str = ""
    odometry_calibration: OdometryCalibration | None = None
    unused: tuple[Unused, ...] = ()
    fixes: Fixes | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings' texts."""
        return tuple(f.text for f in self.findings)


DECISIONS = ("first", "empty", "odometry", "matched", "skipped", "unseen")


class ScanInfos:
    """The `ScanInfo` of every scan, 119 bytes of each. `append` and `clear` change it."""

    def __init__(self) -> None:
        self._rows = RowBuffer(
            dtype=[
                ("innovation", np.float64, 3),
                ("information", np.float64, (3, 3)),
                ("n_eff", np.float64),
                ("beams", np.int32),
                ("matches", np.int32),
                ("decision", np.uint8),
                ("resampled", np.bool_),
                ("informed", np.bool_),
            ]
        )

    def __len__(self) -> int:
        return len(self._rows)

    def append(self, info: ScanInfo) -> None:
        """Add what the next scan did."""
        informed = info.information is not None
        self._rows.append(
            (
                info.innovation,
                info.information if informed else 0.0,
                info.n_eff,
                info.beams,
                info.matches,
                DECISIONS.index(info.decision),
                info.resampled,
                informed,
            )
        )

    def clear(self) -> None:
        """Remove all rows."""
        self._rows.clear()

    def records(self, t: Float[np.ndarray, " m"], host: tuple[str, ...], pose: Float[np.ndarray, "m 3"]) -> ScanRecords:
        """The per-scan record of scans with these stamps, hosts and poses."""
        rows = self._rows.array
        return ScanRecords(
            t,
            host,
            pose,
            rows["innovation"],
            rows["beams"].astype(np.int64),
            rows["matches"].astype(np.int64),
            tuple(DECISIONS[k] for k in rows["decision"].tolist()),
            rows["n_eff"],
            rows["resampled"],
            rows["information"] if len(rows) and rows["informed"].all() else None,
        )
