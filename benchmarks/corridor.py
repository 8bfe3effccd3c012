"""The statements about the 200 m loop, whole: six seeds, 512 and 128 particles, the true and the found calibration.

    python benchmarks/corridor.py [--seeds 6] [--json FILE]

A Markdown table, and what is asked of its numbers. Errors are root mean square positions [m] after one rigid alignment
to the truth.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mapweave.laser import particle_slam
from mapweave.laser.beam import IntensityCalibration, beams
from mapweave.laser.laser_map import ScanInfos
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import choose_feature, finish, map_laser
from mapweave.papers.hara.experiments import score
from mapweave.sim.laser import SECOND_LAW, DriveConfig
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

KNOTS = np.linspace(0.0, 6.0, 31)
TRUE = IntensityCalibration(KNOTS, -np.log1p((KNOTS / 1.5) ** 2), 1.0, 40000 * 0.9, 0.0, 1)
METHODS = {
    "ICP, geometry": LaserConfig(method="icp", feature="none"),
    "Intensity-ICP": LaserConfig(method="icp"),
    "RBPF-512, geometry": LaserConfig(particles=512, feature="none"),
    "RBPF-512, raw": LaserConfig(particles=512, feature="raw"),
    "RBPF-512, normalised": LaserConfig(particles=512),
    "RBPF-128, normalised": LaserConfig(particles=128),
}

TOLD = {  # how the table names what is a Rao-Blackwellized particle filter
    "RBPF-512, geometry": "particle filter, 512, geometry",
    "RBPF-512, raw": "particle filter, 512, raw intensity",
    "RBPF-512, normalised": "particle filter, 512, intensity",
    "RBPF-128, normalised": "particle filter, 128, intensity",
    "RBPF-128, true law": "the same, with the law of reflectance the simulator uses instead of the one found",
    "RBPF-128, another law": "the same, under a second law of reflectance nobody told it",
}


def with_true_law(sim, cfg, seed):
    """RBPF with the law the simulator used instead of the one found from the log."""
    feature = replace(choose_feature(sim.log, cfg), calibration=TRUE)
    rng = np.random.default_rng(seed)
    state = particle_slam.init("1", cfg, rng, feature="normalised", calibration=TRUE)
    infos = ScanInfos()
    for event in sim.log.events():
        state, info = particle_slam.step(state, event, cfg, rng)
        if info is not None:
            infos.append(info)
    return finish(sim.log, cfg, feature, particle_slam.trajectory(state), infos)


def correlation(sim) -> float:
    """Of the self-calibrated feature with the true reflectance."""
    feature = choose_feature(sim.log, LaserConfig())
    made = [beams(s, "normalised", feature.calibration, LaserConfig().beam) for s in sim.log.scans]
    q = np.concatenate([b.q for b in made])
    rho = np.concatenate([sim.reflectance[k][b.beam] for k, b in enumerate(made)])
    return float(np.corrcoef(q, rho)[0, 1])


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--seeds", type=int, default=6)
    ask.add_argument("--json", type=Path)
    said = ask.parse_args()
    names = ["odometry", *METHODS, "RBPF-128, true law", "RBPF-128, another law"]
    errors: dict[str, list[float]] = {name: [] for name in names}
    alike = []
    for seed in range(said.seeds):
        sim = simulate_corridor(seed=seed)
        for name, cfg in METHODS.items():
            made = map_laser(sim.log, cfg, seed)
            errors[name].append(score(made.track, sim.truth))
        errors["odometry"].append(score(made.dead_reckoning, sim.truth))
        errors["RBPF-128, true law"].append(
            score(with_true_law(sim, LaserConfig(particles=128), seed).track, sim.truth)
        )
        other = simulate_corridor(CorridorConfig(drive=DriveConfig(law=SECOND_LAW)), seed)
        made = map_laser(other.log, LaserConfig(particles=128), seed)
        errors["RBPF-128, another law"].append(score(made.track, other.truth))
        alike.append(correlation(sim))
        print(f"seed {seed}: " + ", ".join(f"{n} {e[-1]:.3f}" for n, e in errors.items()), flush=True)
    mean = {name: float(np.mean(e)) for name, e in errors.items()}
    best = errors["RBPF-512, normalised"]
    checks = {
        "RBPF-512 normalised / geometry (<= 0.40)": mean["RBPF-512, normalised"] / mean["RBPF-512, geometry"],
        "RBPF-512 normalised / odometry (<= 0.05)": mean["RBPF-512, normalised"] / mean["odometry"],
        "RBPF-512 normalised, worst seed [m] (<= 0.30)": max(best),
        "Intensity-ICP / ICP (<= 0.75)": mean["Intensity-ICP"] / mean["ICP, geometry"],
        "RBPF-128 / RBPF-512 (<= 2)": mean["RBPF-128, normalised"] / mean["RBPF-512, normalised"],
        "self-calibration, correlation (>= 0.90)": float(np.min(alike)),
        "self-calibrated / true law (<= 1.5)": mean["RBPF-128, normalised"] / mean["RBPF-128, true law"],
    }
    print("| | mean | worst |\n|---|---|---|")
    for name in names:
        print(f"| {TOLD.get(name, name)} | {mean[name]:.3f} m | {max(errors[name]):.3f} m |")
    for name, value in checks.items():
        print(f"{name:48s} {value:.3f}")
    if said.json:
        said.json.write_text(json.dumps({"errors": errors, "checks": checks}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
