"""A corridor in which matching fails as in the paper: flush walls, glass, sparse returns, quick turns, passers-by."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Int

from ...core import se2
from ...core.config import config
from ...core.records import Scan, frozen
from ...sim.corridor import CorridorConfig, corridor_world
from ...sim.laser import DriveConfig, LaserSimulation, drive, stream
from ...sim.route import ring

GLASS = 0.001  # reflectance by which a pane is known


@config
class HardConfig:
    """The ring of the other experiments, made hard."""

    corridor: CorridorConfig = field(
        default_factory=lambda: CorridorConfig(recess=0.0, corner=0.3, drive=DriveConfig(people=3))
    )
    glass_share: float = 0.25  # of the wall pieces
    glass_returns: float = 0.1  # share of the beams on glass that come back
    sparse_every: float = 24.0  # [m] driven between stretches of
    sparse_length: float = 6.0  # [m] in which
    sparse_returns: float = 0.12  # this share of the beams comes back
    quick_turn: float = 0.15  # [rad] between scans; in turns that are quicker no scan is kept


@dataclass(frozen=True, slots=True)
class HardDrive:
    """sim: the drive as logged, scans of quick turns left out. kept: their numbers among those taken."""

    sim: LaserSimulation
    kept: Int[np.ndarray, " k"]


def simulate_hard(cfg: HardConfig | None = None, seed: int = 0) -> HardDrive:
    """One drive, the same for the same seed."""
    cfg = cfg or HardConfig()
    c = cfg.corridor
    rng = stream(seed, "hard")
    world = corridor_world(c, seed)
    glass = rng.random(len(world.reflectance)) < cfg.glass_share
    world = replace(world, reflectance=frozen(np.where(glass, GLASS, world.reflectance)))
    sim = drive(world, ring(c.long_leg, c.short_leg, c.corner, c.distance, c.start), c.drive, seed)
    log = sim.log
    truth = se2.interpolate(log.scan_t, sim.truth.t, sim.truth.pose)
    step = se2.between(truth[:-1], truth[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    sparse = (way % cfg.sparse_every) > cfg.sparse_every - cfg.sparse_length
    turn = np.abs(np.concatenate([[0.0], step[:, 2]]))
    inside = (turn > cfg.quick_turn) & np.roll(turn > cfg.quick_turn, -1)
    kept = np.flatnonzero(~inside)
    scans = []
    for k in kept.tolist():
        draw = rng.random((2, len(log.scans[k].ranges)))
        lost = (sim.reflectance[k] == GLASS) & (draw[0] > cfg.glass_returns)
        lost |= sparse[k] & (draw[1] > cfg.sparse_returns)
        scans.append(_without(log.scans[k], lost))
    log = replace(log, scan_t=frozen(log.scan_t[kept]), scans=tuple(scans))
    return HardDrive(replace(sim, log=log, reflectance=frozen(sim.reflectance[kept])), kept)


def _without(scan: Scan, lost: Bool[np.ndarray, " n"]) -> Scan:
    """The scan as if the `lost` beams had not come back."""
    light = np.zeros(len(scan.ranges)) if scan.intensities is None else scan.intensities
    return replace(
        scan,
        ranges=frozen(np.where(lost, scan.range_max, scan.ranges)),
        hit=frozen(scan.hit & ~lost, dtype=bool),
        intensities=frozen(np.where(lost, 0.0, light)),
    )
