"""The ring corridor under the light of real scanners: the default beside geometry alone.

python benchmarks/light_simulated.py [--seeds 2]

Root mean square position [m] after one rigid alignment. `feature`: what steered by default; weight: what its light gets
of what the settings give it.
"""

import argparse
from dataclasses import replace

from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.papers.hara.experiments import score
from mapweave.sim.laser import LAWS
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    args = parser.parse_args()
    cfg = LaserConfig(method="graph")
    print("| law of light | seed | feature | weight | default | geometry | wheels |")
    print("|---|---|---|---|---|---|---|")
    for name in ("lds01", "neato"):
        for seed in range(args.seeds):
            world = CorridorConfig()
            sim = simulate_corridor(replace(world, drive=replace(world.drive, law=LAWS[name])), seed=seed)
            made, bare = (map_laser(sim.log, replace(cfg, feature=feature), 0) for feature in (cfg.feature, "none"))
            errors = " | ".join(f"{score(t, sim.truth):.2f} m" for t in (made.track, bare.track, made.dead_reckoning))
            weight = made.calibration.weight if made.calibration else 0.0
            print(f"| {name} | {seed} | {made.feature} | {weight:.2f} | {errors} |", flush=True)


if __name__ == "__main__":
    main()
