"""Offices of 500 to 5,000 m^2 explored by 1 to 8 robots with lasers: what is mapped, how well, how long it takes.

python benchmarks/exploration_laser.py [--quick] [--areas 500 1000] [--robots 1 2] [--seeds 3] [--jobs 1] [--out FILE]
python benchmarks/exploration_laser.py --hard      # dead robots, lost messages and bad wheels, as a Markdown table
"""

import argparse
import json
import os
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mapweave.core.workers import worker_pool
from mapweave.exploration.laser.config import LaserMissionConfig, with_odometry_noise
from mapweave.exploration.laser.experiment import LaserMission, explore_laser_many
from mapweave.exploration.laser.scenario import LaserScenarioConfig
from mapweave.exploration.laser.score import LaserScore

AREAS, TEAMS = (500, 1000, 2000, 5000), (1, 2, 4, 8)
QUICK = {500: (1, 2), 1000: (4,)}
HEAD = (
    "area",
    "robots",
    "finished",
    "steps",
    "mapped, least",
    "collisions",
    "map error",
    "trajectory RMSE",
    "NEES/dof",
)
HEAD = (*HEAD, "loops closed / refused / false", "s a run")
HARD = {  # what goes wrong -> area [m^2], robots, runs, who dies at which step, share of messages lost, wheels' factor
    "one robot dead after 100 steps, a fifth of the messages lost": (1000, 4, 3, {1: 100}, 0.2, 1.0),
    "wheels three times as bad, a fifth of the messages lost": (500, 2, 3, {}, 0.2, 3.0),
    "wheels nine times as bad": (500, 2, 4, {}, 0.0, 9.0),
}


def hard() -> None:
    """The missions of HARD on seeds from 0: of steps and errors the least and the largest."""
    print("| what goes wrong | area | robots | finished | steps | mapped, least | collisions | map error | RMSE |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, (area, robots, seeds, kills, drop, factor) in HARD.items():
        cfg = with_odometry_noise(LaserMissionConfig(), factor)
        mission = LaserMission(LaserScenarioConfig(office=area), robots, kills=kills, drop=drop, cfg=cfg)
        runs = explore_laser_many(mission, seeds, 0, None)
        cells = [
            f"{area:,} m²",
            robots,
            f"{sum(r.finished for r in runs)} of {len(runs)}",
            "{:.0f} to {:.0f}".format(*span(runs, "steps")),
            f"{100 * min(r.area_mapped for r in runs):.2f} %",
            sum(r.collisions for r in runs),
            "{:.3f} to {:.3f} m".format(*span(runs, "map_error")),
            "{:.3f} to {:.3f} m".format(*span(runs, "trajectory_rmse")),
        ]
        print(f"| {name} | {' | '.join(map(str, cells))} |", flush=True)


def span(runs: list[LaserScore], name: str) -> tuple[float, float]:
    values = [getattr(r, name) for r in runs]
    return min(values), max(values)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="one seed of three small offices")
    parser.add_argument("--hard", action="store_true", help="a few offices in which something goes wrong")
    parser.add_argument("--areas", type=int, nargs="+", default=AREAS, help="[m^2]")
    parser.add_argument("--robots", type=int, nargs="+", default=TEAMS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--planner", default="coverage")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.hard:
        hard()
        return
    plan = QUICK if args.quick else dict.fromkeys(args.areas, args.robots)
    seeds = 1 if args.quick else args.seeds
    machine = {name: version(name) for name in ("mapweave", "numpy", "scipy", "numba")}
    machine |= {"python": platform.python_version(), "cores": str(os.cpu_count()), "processor": platform.machine()}
    print(", ".join(f"{k} {v}" for k, v in machine.items()))
    print(f"| {' | '.join(HEAD)} |\n{'|---' * len(HEAD)}|")
    told = []
    with worker_pool(args.jobs, max(seeds, 3)) as pool:
        for area, teams in plan.items():
            for robots in teams:
                mission = LaserMission(LaserScenarioConfig(office=area), robots, args.planner)
                runs = explore_laser_many(mission, seeds, args.first, pool)
                told += [{"area": area, "planner": args.planner, **asdict(r)} for r in runs]
                print(f"| {' | '.join(row(area, robots, runs))} |", flush=True)
    if args.out:
        args.out.write_text(json.dumps({"machine": machine, "runs": told}, indent=1), encoding="utf-8")


def row(area: int, robots: int, runs: list[LaserScore]) -> list[str]:
    """Means over the seeds; of what is mapped the least, of collisions the sum."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(r, name) for r in runs if getattr(r, name) is not None]))

    return [
        f"{area:,} m²",
        str(robots),
        f"{sum(r.finished for r in runs)} of {len(runs)}",
        f"{mean('steps'):,.0f}",
        f"{100 * min(r.area_mapped for r in runs):.2f} %",
        str(sum(r.collisions for r in runs)),
        f"{mean('map_error'):.3f} m",
        f"{mean('trajectory_rmse'):.3f} m",
        f"{mean('nees_per_dof'):.2f}",
        f"{mean('closures'):.0f} / {mean('refused'):.0f} / {sum(r.misassociations for r in runs)}",
        f"{mean('seconds'):.0f}",
    ]


if __name__ == "__main__":
    main()
