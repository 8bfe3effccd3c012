"""What the odometry gate is worth: matching alone and gated where matching fails, and every refusal judged."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.workers import Progress, no_progress
from ...laser.icp import IcpConfig
from ...laser.laser_map import LaserMap
from ...laser.scan_matching import allowed_sd
from ...laser.scan_odometry import inside
from ...mapping.config import LaserConfig
from ...mapping.laser_mapping import map_laser
from ...sim.laser import LaserSimulation
from .hard_world import HardConfig, simulate_hard
from .methods import GATED, ICP, WHEELS, score


@dataclass(frozen=True, slots=True)
class GateRow:
    """One method on S drives. farthest, nearest: [m] pairs are taken at first and at last; ate: (S,) [m]; counts: (S,).

    few: matches of too few pairs, which any of them replaces by odometry; outside: matches that the gate does not
    allow (without a gate they are taken); rightly: those of them that err more about the step than odometry does;
    slipped: matches inside the gate that err about the step by more than the gate allows.
    """

    name: str
    figure: str
    farthest: float
    nearest: float
    ate: Float[np.ndarray, " s"]
    scans: Float[np.ndarray, " s"]
    few: Float[np.ndarray, " s"]
    outside: Float[np.ndarray, " s"]
    rightly: Float[np.ndarray, " s"]
    slipped: Float[np.ndarray, " s"]


OURS, WIDE, WIDEST = (
    IcpConfig(),
    IcpConfig(gate=1.0, least_gate=0.3),
    IcpConfig(gate=2.0, gate_decay=0.9, least_gate=0.5),
)
PAIRS = (OURS, WIDE, WIDEST)  # the paper does not print how wrong pairs are kept out


def try_gate(seeds: range, hard: HardConfig | None = None, on_progress: Progress = no_progress) -> tuple[GateRow, ...]:
    """Odometry, and Intensity-ICP without and with the gate for all widths of pairing, on the hard ring."""
    measured: list[list[tuple[float, ...]]] = [[] for _ in range(1 + 2 * len(PAIRS))]
    heads = [("odometry", "Fig. 4", np.nan, np.nan)]
    for pairs in PAIRS:
        heads += [("Intensity-ICP", "Fig. 5", pairs.gate, pairs.least_gate)]
        heads += [("gated Intensity-ICP", "Fig. 6", pairs.gate, pairs.least_gate)]
    cases = [replace(cfg, icp=pairs) for pairs in PAIRS for cfg in (ICP, GATED)]
    for at, seed in enumerate(seeds):
        sim = simulate_hard(hard, seed).sim
        for row, cfg in enumerate(cases):
            on_progress("the gate", at * len(cases) + row, len(seeds) * len(cases))
            laser_map = map_laser(sim.log, cfg, seed)
            if not row and laser_map.dead_reckoning is not None:
                measured[0].append((score(laser_map.dead_reckoning, sim.truth), len(sim.log.scans), 0, 0, 0, 0))
            measured[row + 1].append(
                (score(laser_map.track, sim.truth), len(sim.log.scans), *judged(laser_map, sim, cfg))
            )
    return tuple(GateRow(*head, *np.array(rows, float).T) for head, rows in zip(heads, measured, strict=True))


def judged(laser_map: LaserMap, sim: LaserSimulation, cfg: LaserConfig) -> tuple[int, int, int, int]:
    """few, outside, rightly, slipped of one drive; see `GateRow`."""
    truth = se2.interpolate(sim.log.scan_t, sim.truth.t, sim.truth.pose)
    step = se2.between(truth[:-1], truth[1:])
    odometry = np.array([scan.odometry for scan in sim.log.scans])
    u = se2.between(odometry[:-1], odometry[1:])
    few = outside = rightly = slipped = 0
    for k in range(1, len(sim.log.scans)):
        if laser_map.scans.decision[k] not in {"matched", "odometry"}:
            continue
        if laser_map.scans.matches[k] < cfg.icp.least_pairs:
            few += 1
            continue
        eps = GATED.eps(allowed_sd(u[k - 1], WHEELS))
        innovation = laser_map.scans.innovation[k]
        wrong = se2.between(step[k - 1], se2.compose(u[k - 1], innovation))
        if inside(innovation, eps):
            slipped += not inside(wrong, eps)
            continue
        outside += 1
        rightly += bool(np.abs(wrong / eps).max() > np.abs(se2.between(step[k - 1], u[k - 1]) / eps).max())
    return few, outside, rightly, slipped
