"""Walls that are known before anybody drives, as the map of a robot that drove among them and never erred.

Scans are cast from places all over the free space, one a metre; what they hit are the walls alone, for where the map
ends nothing is known to stand. Other robots are then found in it, and it holds them, as any robot's map does.
"""

import hashlib
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from ..core import se2
from ..core.errors import DataError
from ..core.records import Scan, Track
from ..core.walls import WallIndex, walls_of_raster
from ..laser.beam import BeamConfig, Beams, beams
from ..laser.laser_map import FREE_BELOW, OCCUPIED_ABOVE, GridMap, LaserMap, ScanRecords
from ..laser.robot_graph import RobotGraph

ROBOT = "0"  # before all others, so that its frame is the map's
APART = 1.0  # [m] between places that scans are cast from
CLEAR = 0.25  # [m] of them from walls and from what is not known
BEAMS, FAR = 720, 15.0  # of a scan cast, and [m] how far it sees
GREY = 0.3  # [m] of what is not known that may lie before a wall: its cells that were hit now and then
SD = np.array([1e-3, 1e-3, 1e-4])  # [m, m, rad] of a step: what is known does not bend
NO_DISCS = np.zeros((1, 0, 3))


def known_map(grid: GridMap, source: str) -> LaserMap:
    """The map `grid` as that of robot `ROBOT`, in the frame of the grid. Raises DataError for one without free places
    beside walls.
    """
    places, path = _survey(grid, source)
    pose = np.column_stack([places, np.zeros(len(places))])
    seen = list(_cast(grid, pose))
    kept = [k for k, b in enumerate(seen) if len(b.q)]
    if not kept:
        raise DataError(f"{source}: no wall is seen from a free place")
    pose, seen, path = pose[kept], [seen[k] for k in kept], path[kept]
    n = len(kept)
    t, cov = np.arange(n, dtype=float), np.tile(np.diag(SD**2), (n, 1, 1))
    told = hashlib.sha256(np.concatenate([b.s for b in seen]).tobytes()).hexdigest()
    graph = RobotGraph(
        robot=ROBOT,
        t=t,
        pose=pose,
        cov=cov,
        path=path,
        step=se2.between(pose[:-1], pose[1:]),
        step_information=np.tile(np.diag(SD**-2.0), (n - 1, 1, 1)),
        closures=(),
        start=np.cumsum([0, *(len(b.q) for b in seen)]),
        points=np.concatenate([b.s for b in seen]),
        normals=np.concatenate([b.normal for b in seen]),
        q=None,
        lined=np.concatenate([b.support for b in seen]) >= 3,
        sensor=np.zeros((n, 2)),
        source=source,
        log_hash=told,
    )
    count = np.array([len(b.q) for b in seen])
    scans = ScanRecords(
        t,
        ("",) * n,
        pose,
        np.zeros((n, 3)),
        count,
        count,
        ("first", *("matched",) * (n - 1)),
        np.full(n, np.nan),
        np.zeros(n, bool),
    )
    return LaserMap(
        robot=ROBOT,
        method="graph",
        feature="none",
        track=Track(t, pose, cov, frame=f"local_{ROBOT}"),
        grid=grid,
        scans=scans,
        source=source,
        log_hash=told,
        graph=graph,
        scan_hash=told,
    )


def _survey(grid: GridMap, source: str) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Places all over the free space, each the clearest of its square, in the order of a drive, and the way to each."""
    clear = distance_transform_edt(np.pad(grid.occupancy() < FREE_BELOW, 1))[1:-1, 1:-1] * grid.resolution
    rows, cols = np.nonzero(clear >= CLEAR)
    if not len(rows):
        raise DataError(f"{source}: the map has no free place a robot could be in")
    side = max(1, round(APART / grid.resolution))
    square = np.column_stack([rows // side, cols // side])
    order = np.lexsort([-clear[rows, cols], square[:, 1], square[:, 0]])
    _, first = np.unique(square[order], axis=0, return_index=True)
    best = order[first]
    places = grid.origin + grid.resolution * (np.column_stack([cols[best], rows[best]]) + 0.5)
    at = {(int(r), int(c)): k for k, (r, c) in enumerate(square[best])}
    drive, path = [], []
    for k, way in _driven(at, places):
        drive.append(k)
        path.append(way)
    return places[drive], np.array(path)


def _driven(at: dict[tuple[int, int], int], places: Float[np.ndarray, "n 2"]) -> Iterator[tuple[int, float]]:
    """Every square once, neighbours after each other where that can be, and the way driven so far [m]."""
    way, last, left = 0.0, None, dict(at)
    while left:
        todo = [next(iter(left))]
        while todo:
            here = todo.pop()
            k = left.pop(here, None)
            if k is None:
                continue
            way += 0.0 if last is None else float(np.hypot(*(places[k] - places[last])))
            last = k
            yield k, way
            todo += [near for d in (-1, 1) for near in ((here[0] + d, here[1]), (here[0], here[1] + d)) if near in left]


def _cast(grid: GridMap, pose: Float[np.ndarray, "n 3"]) -> Iterator[Beams]:
    """What a scanner would see from each pose of the walls of `grid`: where a beam leaves what is known, nothing."""
    p, corner = grid.occupancy(), np.append(grid.origin, 0.0)
    ends, walls = (
        WallIndex.of(walls_of_raster(there, corner, grid.resolution).segments)
        for there in (p >= FREE_BELOW, p > OCCUPIED_ABOVE)
    )
    step = 2 * np.pi / BEAMS
    angles = -np.pi + step * np.arange(BEAMS)
    for one in pose:
        known, wall = (index.cast(one[None], angles, NO_DISCS, FAR)[0][0] for index in (ends, walls))
        hit = np.isfinite(wall) & (np.where(np.isfinite(wall), wall, 0.0) - np.minimum(known, FAR) <= GREY)
        ranges = np.where(hit, wall + 0.5 * grid.resolution, FAR + 1.0)
        yield beams(Scan(ranges, hit, None, -np.pi, step, FAR + 1.0), "none", None, BeamConfig())
