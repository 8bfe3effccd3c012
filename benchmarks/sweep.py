"""Scanners that turn while the robot drives: an office mapped with each beam from where it was taken, and without.

python benchmarks/sweep.py
"""

from unittest.mock import patch

import numpy as np

from mapweave.core import se2
from mapweave.laser.laser_map import LaserMap
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.sim.laser import DriveConfig, LaserSimulation, Scanner
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

SEEDS = 5
ROUND = Scanner(beams=360, opening=np.radians(359.0), far=10.0)
SCANNERS = (
    ("240 degrees of 10 Hz", 0.067, Scanner()),
    ("all round, 10 Hz", 0.1, ROUND),
    ("all round, 10 Hz, clockwise", -0.1, ROUND),
    ("all round, 5 Hz", 0.2, ROUND),
    ("all round, 5 Hz, clockwise", -0.2, ROUND),
)


def error(sim: LaserSimulation, made: LaserMap) -> tuple[float, float]:
    """RMS of the poses at the scans, from the first one's [m], [degrees]."""
    true = se2.interpolate(made.scans.t, sim.truth.t, sim.truth.pose)
    off = se2.between(se2.between(true[0], true), se2.between(made.scans.pose[0], made.scans.pose))
    return float(np.sqrt(np.mean(off[:, :2] ** 2) * 2)), float(np.degrees(np.sqrt(np.mean(off[:, 2] ** 2))))


def main() -> None:
    print("| scanner | a scan takes | way round found | put right: place, heading | of one moment |")
    print("|---|---|---|---|---|")
    for name, sweep, scanner in SCANNERS:
        drive = DriveConfig(
            scan_every=0.8 * abs(sweep) * (1.5 if scanner is not ROUND else 1.0),
            odometry_every=0.04,
            speed=0.8,
            sweep=sweep,
            scanner=scanner,
            drift=OfficeConfig().drive.drift,
        )
        found, right, wrong = 0, [], []
        for seed in range(SEEDS):
            sim = simulate_office(OfficeConfig(drive=drive), seed)
            cfg = LaserConfig(feature="none")
            made = map_laser(sim.log, cfg, seed)
            told = [f.value for f in made.findings if f.code == "scans-swept"]
            found += any(isinstance(value, float) and np.sign(value) == np.sign(sweep) for value in told)
            right.append(error(sim, made))
            with patch("mapweave.mapping.laser_mapping.sweep_of", return_value=0.0):
                wrong.append(error(sim, map_laser(sim.log, cfg, seed)))
        (a, b), (c, d) = np.median(right, axis=0), np.median(wrong, axis=0)
        told_right, told_wrong = f"{a:.3f} m, {b:.2f} degrees", f"{c:.3f} m, {d:.2f} degrees"
        print(f"| {name} | {abs(sweep):g} s | {found} of {SEEDS} | {told_right} | {told_wrong} |", flush=True)


if __name__ == "__main__":
    main()
