"""Laser worlds in which the planner knows where its robots are: the map is drawn from their true poses."""

import numpy as np
from scipy import ndimage

from mapweave.core import se2
from mapweave.core.walls import WallIndex
from mapweave.exploration.laser.config import OCCUPIED_SHARE, LaserPlan
from mapweave.exploration.laser.mission import LaserBelief
from mapweave.exploration.planner_interface import find_planner
from mapweave.kernels.laser.scan_laying import CellCounts, lay_scan
from mapweave.laser.occupancy_mapper import FREE, OCCUPIED, Occupancy, from_counts
from mapweave.sim.laser import LaserWorld
from mapweave.sim.laser_team import LaserTeamSim


def world_of(*segments: tuple[float, float, float, float]) -> LaserWorld:
    return LaserWorld(np.array(segments, float), np.full(len(segments), 0.6))


def room(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def known_map(world: LaserWorld, lower, upper, cell: float = 0.2) -> Occupancy:
    """The true map: cells that a wall crosses are occupied, all others free."""
    cols, rows = np.round((np.array(upper) - lower) / cell).astype(int)
    at = np.array(lower) + cell * (np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1) + 0.5)
    walls = WallIndex.of(world.segments).touches(at.reshape(-1, 2), 0.5 * cell).reshape(rows, cols)
    return Occupancy(cell, np.array(lower, float), np.where(walls, OCCUPIED, FREE))


class Team:
    """A simulated team, the map it has drawn so far, and its planner's memory."""

    def __init__(self, world, starts, lower, upper, cfg: LaserPlan | None = None, seed: int = 0) -> None:
        self.cfg = cfg or LaserPlan()
        self.sim = LaserTeamSim(world, np.array(starts, float), seed=seed)
        M = len(self.sim.true_poses)
        self.alive, self.memory, self.step = np.ones(M, dtype=bool), {}, 0
        self.low = np.floor((np.array(lower, float) - 1.0) / self.cfg.resolution + 1e-9).astype(np.int64)
        self.corner = self.low * self.cfg.resolution
        cols, rows = np.ceil((np.array(upper) + 1.0 - self.corner) / self.cfg.resolution).astype(int)
        self.hits, self.passes = np.zeros((rows, cols), np.int32), np.zeros((rows, cols), np.int32)
        self.given: Occupancy | None = None

    def grid(self) -> Occupancy:
        return self.given or from_counts(self.cfg.resolution, self.corner, self.hits, self.passes, OCCUPIED_SHARE)

    def look(self, j: int) -> np.ndarray:
        """Robot j's scan is drawn into the map, other robots left out; its points in the robot's frame."""
        scan, pose = self.sim.scan(j), self.sim.true_poses[j]
        angles = self.sim.cfg.scanner.angles()
        points = np.asarray(scan.ranges)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        there = se2.act(pose, points)
        others = [p[:2] for k, p in enumerate(self.sim.true_poses) if k != j and self.alive[k]]
        wall = scan.hit & np.all([np.hypot(*(there - o).T) > 0.45 for o in others] or [scan.hit], axis=0)
        far, sums = np.zeros_like(self.hits), np.zeros((*self.hits.shape, 4), np.int64)
        light = np.tile([0.0, 1.0], (int(wall.sum()), 1))
        counts = CellCounts(self.hits, far, self.passes, sums, self.low, self.cfg.resolution)
        lay_scan(counts, pose[:2], there[wall], light, there[~scan.hit], np.inf, 1)
        return points[scan.hit]

    def belief(self) -> LaserBelief:
        scans = tuple(self.look(j) if a else np.zeros((0, 2)) for j, a in enumerate(self.alive))
        names = tuple(f"robot{j + 1}" for j in range(len(scans)))
        stalled = np.zeros(len(scans), int)
        return LaserBelief(
            step=self.step,
            robots=names,
            alive=self.alive,
            stalled=stalled,
            memory=self.memory,
            grid=self.grid(),
            scans=scans,
            moving=(np.zeros((0, 2)),) * len(scans),
        )

    def play(self, planner, most: int) -> bool:
        """Steps until the planner says that all is done, or `most`; whether it did."""
        choose = find_planner(planner, "laser") if isinstance(planner, str) else planner
        while self.step < most:
            commands = choose(self.belief(), self.sim.true_poses.copy(), self.cfg)
            if self.memory.get("finished"):
                return True
            commands[~self.alive] = 0.0
            self.sim.step(commands)
            self.step += 1
        return False

    def mapped(self) -> float:
        """Share of the area that the discs get to from their starts which is known to be free."""
        grid = self.grid()
        cells = np.argwhere(np.ones(grid.state.shape, dtype=bool))
        keep = self.cfg.radius + self.cfg.margin
        fits = ~self.sim.walls.touches(grid.centres(cells), keep).reshape(grid.state.shape)
        regions = ndimage.label(fits)[0]
        starts = regions[tuple(grid.cells(self.sim.starts[:, :2]).T)]
        reachable = np.isin(regions, starts[starts > 0])
        return float((grid.free & reachable).sum() / reachable.sum())
