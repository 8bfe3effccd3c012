"""The 200 m loop of Hara, Kawata, Ohya and Yuta, simulated, and every method of the paper on it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.workers import Progress
from ...io.kept import part
from ...laser.beam import beams
from ...laser.config import LaserConfig
from ...laser.laser_map import GridMap, LaserMap
from ...laser.mapping import map_laser
from ...laser.occupancy_mapper import render
from ...sim.corridor import CorridorConfig, simulate_corridor
from ...sim.laser import LaserSimulation
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
        for m, method in enumerate(chosen):
            on_progress("reproduce hara", s * len(chosen) + m, len(seeds) * len(chosen))
            made = part(map_laser, sim.log, method.cfg or LaserConfig(method="icp", feature="none"), seed)
            track = made.track if method.cfg else made.dead_reckoning
            errors[m, s] = score(track, sim.truth) if track is not None else np.nan
            if seed == shown:
                pictures.append(_picture(method, made, sim))
    on_progress("reproduce hara", 1, 1)
    return errors, tuple(pictures)


def _picture(method: Method, made: LaserMap, sim: LaserSimulation) -> Picture:
    grid, track = made.grid, made.track
    if method.cfg is None and made.dead_reckoning is not None:
        track = made.dead_reckoning
        at = np.searchsorted(track.t, sim.log.scan_t)
        seen = [beams(scan, "none", None, LaserConfig().beam) for scan in sim.log.scans]
        grid = render(seen, track.pose[at], np.zeros((len(at), 3)), grid.resolution, "odom")
    truth = se2.between(sim.truth.pose[0], sim.truth.pose)
    return Picture(method.name, method.figure, grid, track.pose[:, :2], truth[:, :2])
