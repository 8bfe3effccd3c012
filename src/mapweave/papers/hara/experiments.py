"""The 200 m loop of Hara, Kawata, Ohya and Yuta, simulated, and every method of the paper on it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.laser_log import LaserLog
from ...core.records import Track
from ...core.workers import Progress
from ...io.kept import part
from ...laser.beam import Beams, beams
from ...laser.laser_map import GridMap, LaserMap
from ...laser.occupancy_mapper import render
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import map_laser
from ...sim.corridor import CorridorConfig, simulate_corridor
from ...sim.laser import LaserSimulation
from .light_edges import sharpened
from .methods import Method, score


@dataclass(frozen=True, slots=True)
class Picture:
    """One map as a figure shows it. track and truth: (n, 2) [m] in the map."""

    name: str
    figure: str
    grid: GridMap
    track: Float[np.ndarray, "n 2"]
    truth: Float[np.ndarray, "m 2"]


def compare(
    chosen: tuple[Method, ...], seeds: range, shown: int, on_progress: Progress, loop: CorridorConfig | None = None
) -> tuple[Float[np.ndarray, "m s"], tuple[Picture, ...]]:
    """ATE [m] of every method at every seed, and the maps of the seed `shown`."""
    errors = np.zeros((len(chosen), len(seeds)))
    pictures: list[Picture] = []
    for s, seed in enumerate(seeds):
        sim = simulate_corridor(loop, seed)
        known: dict[LaserConfig, LaserMap] = {}
        for m, method in enumerate(chosen):
            on_progress("reproduce hara", s * len(chosen) + m, len(seeds) * len(chosen))
            cfg = method.cfg or LaserConfig(method="icp", feature="none")
            if cfg not in known:
                known[cfg] = part(map_laser, sim.log, cfg, seed)
            laser_map = known[cfg]
            track = laser_map.track if method.cfg else laser_map.dead_reckoning
            if method.rims:
                track = on_rims(sim.log, laser_map)
            errors[m, s] = score(track, sim.truth) if track is not None else np.nan
            if seed == shown and track is not None:
                pictures.append(_picture(method, laser_map, sim, track))
    on_progress("reproduce hara", 1, 1)
    return errors, tuple(pictures)


def on_rims(log: LaserLog, laser_map: LaserMap) -> Track:
    """The poses of `laser_map` at the scans of its `log`, moved until walls and rims are seen in one place each."""
    poses = laser_map.track.pose[np.searchsorted(laser_map.track.t, log.scan_t)]
    noise = 0.0 if laser_map.calibration is None else laser_map.calibration.residual
    return Track(log.scan_t, sharpened(seen_scans(log, laser_map), poses, noise), frame=laser_map.track.frame)


def seen_scans(log: LaserLog, laser_map: LaserMap) -> list[Beams]:
    """The returns of all scans, their light as `laser_map` reckons it."""
    feature = "none" if laser_map.calibration is None else "normalised"
    return [beams(scan, feature, laser_map.calibration, LaserConfig().beam) for scan in log.scans]


def _picture(method: Method, laser_map: LaserMap, sim: LaserSimulation, track: Track) -> Picture:
    """The map as it was made, or laid anew along a `track` that is not its own."""
    grid = laser_map.grid
    if track is not laser_map.track:
        at = np.searchsorted(track.t, sim.log.scan_t)
        grid = render(
            seen_scans(sim.log, laser_map), track.pose[at], np.zeros((len(at), 3)), grid.resolution, track.frame
        )
    truth = se2.between(sim.truth.pose[0], sim.truth.pose)
    return Picture(method.name, method.figure, grid, track.pose[:, :2], truth[:, :2])
