"""The 200 m loop of Hara, Kawata, Ohya and Yuta, simulated, and every method of the paper on it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.records import Track
from ...core.workers import Progress
from ...evaluation.trajectory import align_tracks, ate
from ...laser.beam import beams
from ...laser.config import LaserConfig
from ...laser.laser_map import GridMap, LaserMap
from ...laser.mapping import map_laser
from ...laser.occupancy_mapper import render
from ...laser.scan_matching import FrontEndConfig
from ...sim.corridor import CorridorConfig, simulate_corridor
from ...sim.laser import LaserSimulation

# What a gate allows wheels like the simulated ones, which err by a few per cent: the paper's "found by experience".
WHEELS = FrontEndConfig(sd_xy=0.01, sd_xy_per_m=0.06, sd_turn=0.01, sd_turn_per_m=0.02, sd_turn_per_rad=0.05)


class Method(NamedTuple):
    """figure: of the paper, where it shows one."""

    name: str
    figure: str
    cfg: LaserConfig | None  # None: odometry alone


def methods(particles: int) -> tuple[Method, ...]:
    """In the order of the paper; matching and filtering with geometry alone and with intensity."""
    icp = LaserConfig(method="icp")
    gated = LaserConfig(method="gated", matcher="icp", front_end=WHEELS, gate_sd_xy=0.0, gate_sd_turn=0.0)
    filtered = LaserConfig(particles=particles)
    return (
        Method("odometry", "Fig. 4", None),
        Method("ICP, geometry", "", replace(icp, feature="none")),
        Method("Intensity-ICP", "Fig. 5", icp),
        Method("gated ICP, geometry", "", replace(gated, feature="none")),
        Method("gated Intensity-ICP", "Fig. 6", gated),
        Method("gated, on lines, intensity", "", LaserConfig(method="gated")),
        Method(f"RBPF-{particles}, geometry", "", replace(filtered, feature="none")),
        Method(f"RBPF-{particles}, intensity", "Fig. 7", filtered),
    )


@dataclass(frozen=True, slots=True)
class Picture:
    """One map as a figure shows it. track and truth: (n, 2) [m] in the map."""

    name: str
    figure: str
    grid: GridMap
    track: Float[np.ndarray, "n 2"]
    truth: Float[np.ndarray, "m 2"]


def score(track: Track, truth: Track) -> float:
    """ATE [m] after one rigid alignment."""
    T = align_tracks([(track, truth, True)])
    found, _ = ate(track, truth, T if T is not None else np.zeros(3), dense=True)
    return float("nan") if found is None else found


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
            made = map_laser(sim.log, method.cfg or LaserConfig(method="icp", feature="none"), seed)
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
