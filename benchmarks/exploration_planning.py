"""What planning alone can do in offices: steps of teams whose planner is told their true poses, as a Markdown table.

    python benchmarks/exploration_planning.py [--first 40]

Maps are drawn from true poses, as the tests of the planners do. Means over the seeds from --first on: four offices of
1,000 m², two of 2,000 m², one of 5,000 m². Under each planner's steps: the runs that did not end, contacts with walls
or robots, and the least share of the ground that planned ways get to which was mapped.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # the team whose poses are known is that of the tests

from tests.exploration.laser_truth import Team

from mapweave.sim.laser_worlds import office_floor

TEAMS = (1, 2, 4, 8)
MOST = 12_000  # steps
ROWS = (  # area [m²], seeds, planner, robots
    (1000, 4, "coverage", TEAMS),
    (1000, 4, "nearest", TEAMS),
    (2000, 2, "coverage", TEAMS),
    (5000, 1, "coverage", (8,)),
)


@dataclass(frozen=True, slots=True)
class Ended:
    """How one run ended."""

    done: bool
    steps: int
    contacts: int
    mapped: float


def played(area: int, seed: int, robots: int, planner: str) -> Ended:
    floor = office_floor(area, seed)
    team = Team(floor.world, floor.starts[:robots], floor.lower, floor.upper, seed=seed)
    done = team.play(planner, MOST)
    return Ended(done, team.step, int(team.sim.collisions.sum()), team.mapped())


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--first", type=int, default=40, help="the first seed")
    first = ask.parse_args().first
    print(
        f"| area, planner | seeds | {' | '.join(f'{n} robots' if n > 1 else 'steps, 1 robot' for n in TEAMS)} |", end=""
    )
    print(f" not ended | contacts | mapped, least |\n|---|---{'|---' * len(TEAMS)}|---|---|---|")
    for area, seeds, planner, teams in ROWS:
        runs = {n: [played(area, seed, n, planner) for seed in range(first, first + seeds)] for n in teams}
        every = [run for some in runs.values() for run in some]
        cells = [
            f"{area:,} m², `{planner}`",
            f"{first}–{first + seeds - 1}" if seeds > 1 else f"{first}",
            *(f"{np.mean([run.steps for run in runs[n]]):,.0f}" if n in runs else "" for n in TEAMS),
            sum(not run.done for run in every),
            sum(run.contacts for run in every),
            f"{100 * min(run.mapped for run in every):.2f} %",
        ]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


if __name__ == "__main__":
    main()
