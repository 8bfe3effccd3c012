"""Offices of 500 to 5,000 m^2 explored by 1 to 8 robots with lasers: what is mapped, how well, how long it takes.

python benchmarks/exploration_laser.py [--quick] [--areas 500 1000] [--robots 1 2] [--seeds 3] [--jobs 1] [--out FILE]
python benchmarks/exploration_laser.py --hard      # dead robots, lost messages and bad wheels, as a Markdown table
python benchmarks/exploration_laser.py --unknown-starts  # robots that find each other, as a Markdown table
python benchmarks/exploration_laser.py --tables DIR      # all offices, and what their estimates err by, as two tables
"""

import argparse
import json
import os
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from time import process_time

import numpy as np

from mapweave.core.workers import worker_pool
from mapweave.exploration.laser.config import LaserMissionConfig, LaserScenarioConfig, with_odometry_noise
from mapweave.exploration.laser.experiment import LaserMission, LaserScore, explore_laser_many

AREAS, TEAMS = (500, 1000, 2000, 5000), (1, 2, 4, 8)
SEEDS = {500: 2, 1000: 2, 2000: 2, 5000: 1}  # area -> runs of each team, for --tables
QUICK = {500: (1, 2), 1000: (4,)}
HEAD = (
    *("area", "robots", "finished", "steps", "mapped, least", "collisions", "map error", "trajectory RMSE", "NEES/dof"),
    *("loops closed / refused / false", "CPU s a run"),
)
JUDGED = (
    *("missions", "runs", "NEES/dof: mean, least, greatest", "trajectory RMSE: mean, greatest", "map error, greatest"),
    *("loops closed", "false"),
)
HARD = {  # what goes wrong -> area [m^2], robots, runs, who dies at which step, share of messages lost, wheels' factor
    "one robot dead after 100 steps, a fifth of the messages lost": (1000, 4, 3, {1: 100}, 0.2, 1.0),
    "wheels three times as bad, a fifth of the messages lost": (500, 2, 3, {}, 0.2, 3.0),
    "wheels nine times as bad": (500, 2, 4, {}, 0.0, 9.0),
}


APART = (  # area [m^2], robots, runs, wheels' factor: seeds from 300, which no setting was chosen on
    (500, 2, 8, 1.0),
    (1000, 4, 8, 1.0),
    (2000, 8, 3, 1.0),
    (5000, 4, 1, 9.0),
)
APART_HEAD = (
    *("area", "robots", "wheels", "runs with one map", "places wrongly joined", "steps, starts told", "steps"),
    *("mapped, least", "collisions", "trajectory RMSE, starts told", "trajectory RMSE", "NEES/dof"),
)


def unknown_starts() -> None:
    """The missions of APART with starts that are told to all robots and to none: means, of `mapped` the least."""
    print(f"| {' | '.join(APART_HEAD)} |\n{'|---' * len(APART_HEAD)}|")
    for area, robots, seeds, factor in APART:
        cfg = with_odometry_noise(LaserMissionConfig(), factor)
        told, apart = (
            explore_laser_many(LaserMission(LaserScenarioConfig(office=area), robots, cfg=cfg, apart=a), seeds, 300)
            for a in (False, True)
        )
        cells = [
            f"{area:,} m²",
            robots,
            "calibrated" if factor == 1.0 else f"{factor:g} times as bad",
            f"{sum(r.maps == 1 for r in apart)} of {seeds}",
            sum(r.misassociations for r in apart),
            *(f"{np.mean([r.steps for r in runs]):,.0f}" for runs in (told, apart)),
            f"{100 * min(r.area_mapped for r in apart):.2f} %",
            sum(r.collisions for r in apart),
            *(f"{np.mean([r.trajectory_rmse for r in runs]):.3f} m" for runs in (told, apart)),
            f"{np.mean([r.nees_per_dof for r in apart]):.2f}",
        ]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def hard() -> None:
    """The missions of HARD on seeds from 0: of steps and errors the least and the largest."""
    print("| what goes wrong | area | robots | finished | steps | mapped, least | collisions | map error | RMSE |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, (area, robots, *_) in HARD.items():
        runs = hard_runs(name)
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


def hard_runs(name: str) -> list[LaserScore]:
    area, robots, seeds, kills, drop, factor = HARD[name]
    cfg = with_odometry_noise(LaserMissionConfig(), factor)
    mission = LaserMission(LaserScenarioConfig(office=area), robots, kills=kills, drop=drop, cfg=cfg)
    return explore_laser_many(mission, seeds, 0, None)


def tables(folder: Path) -> None:
    """Writes `exploration.md`, a row an area and team, and `missions.md`, what all of them and HARD's err by."""
    rows, runs = [], {}
    explore_laser_many(LaserMission(LaserScenarioConfig(office=AREAS[0]), 2, until=5), 1, 0, None)  # kernels compiled
    for area in AREAS:
        for robots in TEAMS:
            begun = process_time()
            made = explore_laser_many(LaserMission(LaserScenarioConfig(office=area), robots), SEEDS[area], 0, None)
            rows.append(row(area, robots, made, (process_time() - begun) / len(made)))
            runs.setdefault("500 to 2,000 m²" if area <= 2000 else f"{area:,} m²", []).extend(made)
            print(" ".join(rows[-1]), flush=True)
    groups = {f"{name}, 1 to 8 robots": made for name, made in runs.items()} | {name: hard_runs(name) for name in HARD}
    groups["all"] = [r for made in groups.values() for r in made]
    folder.mkdir(parents=True, exist_ok=True)
    for name, head, lines in (
        ("exploration", HEAD, rows),
        ("missions", JUDGED, [judged(name, made) for name, made in groups.items()]),
    ):
        text = "".join(f"| {' | '.join(line)} |\n" for line in (head, ["---"] * len(head), *lines))
        (folder / f"{name}.md").write_text(text, encoding="utf-8")


def judged(name: str, runs: list[LaserScore]) -> list[str]:
    """By how much the estimates of these runs err, and whether their covariances say so."""
    nees, rmse = ([getattr(r, what) for r in runs] for what in ("nees_per_dof", "trajectory_rmse"))
    return [
        name,
        str(len(runs)),
        f"{np.mean(nees):.2f}, {min(nees):.2f}, {max(nees):.2f}",
        f"{np.mean(rmse):.3f}, {max(rmse):.3f} m",
        f"{max(r.map_error for r in runs):.3f} m",
        f"{sum(r.closures for r in runs):,}",
        str(sum(r.misassociations for r in runs)),
    ]


def span(runs: list[LaserScore], name: str) -> tuple[float, float]:
    values = [getattr(r, name) for r in runs]
    return min(values), max(values)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="one seed of three small offices")
    parser.add_argument("--hard", action="store_true", help="a few offices in which something goes wrong")
    parser.add_argument("--unknown-starts", action="store_true", help="robots that do not know where the others start")
    parser.add_argument("--areas", type=int, nargs="+", default=AREAS, help="[m^2]")
    parser.add_argument("--robots", type=int, nargs="+", default=TEAMS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--planner", default="coverage")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--tables", type=Path, metavar="DIR", help="write the two tables of the documentation there")
    args = parser.parse_args()
    if args.tables:
        tables(args.tables)
        return
    if args.hard or args.unknown_starts:
        (hard if args.hard else unknown_starts)()
        return
    plan = QUICK if args.quick else dict.fromkeys(args.areas, args.robots)
    seeds = 1 if args.quick else args.seeds
    machine = {name: version(name) for name in ("mapweave", "numpy", "scipy", "numba")}
    machine |= {"python": platform.python_version(), "cores": str(os.cpu_count()), "processor": platform.machine()}
    print(", ".join(f"{k} {v}" for k, v in machine.items()))
    print(f"| {' | '.join((*HEAD[:-1], 's a run'))} |\n{'|---' * len(HEAD)}|")
    told = []
    with worker_pool(args.jobs, max(seeds, 3)) as pool:
        for area, teams in plan.items():
            for robots in teams:
                mission = LaserMission(LaserScenarioConfig(office=area), robots, args.planner)
                runs = explore_laser_many(mission, seeds, args.first, pool)
                told += [{"area": area, "planner": args.planner, **asdict(r)} for r in runs]
                took = float(np.mean([r.seconds for r in runs]))
                print(f"| {' | '.join(row(area, robots, runs, took))} |", flush=True)
    if args.out:
        args.out.write_text(json.dumps({"machine": machine, "runs": told}, indent=1), encoding="utf-8")


def row(area: int, robots: int, runs: list[LaserScore], seconds: float) -> list[str]:
    """Means over the seeds; of what is mapped the least, of collisions the sum. seconds: a run."""

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
        f"{seconds:.0f}",
    ]


if __name__ == "__main__":
    main()
