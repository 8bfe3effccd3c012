"""Robust location of swarms with wrong sightings: what they cost beyond the bound of the right ones.

`python benchmarks/swarm_outliers.py [--robots 100] [--draws 15] [--seed 0]`

Robots in the plane, each pair sighted from both ends or not at all, 1 degree. RMSE over the Cramer-Rao bound of the
same sightings without the wrong ones, at the truth; corners known.
"""

import argparse

import numpy as np
from swarm_trust import network

from mapweave.sim.swarm import SwarmScene
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate

SHARES = (0.0, 0.05, 0.1, 0.2)


def over_the_bound(scene: SwarmScene, seed: int) -> tuple[float, bool]:
    """RMSE over the bound, and whether the answer is called reliable."""
    net, truth, wild = network(scene, seed)
    found = locate(net, SwarmConfig(method="robust"))
    clean = locate(net.select(~wild), SwarmConfig(max_iterations=0), initial=truth)
    both = found.localisable & ~found.anchor & clean.localisable
    rmse = np.sqrt(np.square(found.position - truth)[both].sum(axis=1).mean())
    bound = np.sqrt(np.trace(np.asarray(clean.cov)[both], axis1=1, axis2=2).mean())
    return float(rmse / bound), found.reliable


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--draws", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("| wrong sightings | RMSE / bound, median | worst | called reliable |\n|---|---|---|---|")
    for share in SHARES:
        scene = SwarmScene(robots=args.robots, visibility="mutual", outliers=share)
        drawn = [over_the_bound(scene, args.seed + k) for k in range(args.draws)]
        ratio = np.array([one for one, _ in drawn])
        sure = sum(reliable for _, reliable in drawn)
        print(f"| {share:.0%} | {np.median(ratio):.2f} | {ratio.max():.2f} | {sure} of {len(drawn)} |", flush=True)


if __name__ == "__main__":
    main()
