"""The planners in the paper's field on other seeds than the paper's and those of `reproduce yuan`, as a Markdown table.

    python benchmarks/exploration_seeds.py [--jobs 1]

Two robots, calibrated noise, identities known, until every landmark has been seen, unless a row says otherwise. Its
seeds from 100 on are those that nothing was chosen on; from 1000 on the constants of `loop` and `joint` were chosen.
"""

import argparse
from dataclasses import dataclass, replace

import numpy as np

from mapweave.core.workers import worker_pool
from mapweave.exploration.landmarks.experiment import LandmarkMission, LandmarkRunScore, explore_many
from mapweave.papers.yuan.experiments import run

UNSEEN, CHOSEN = 100, 1000


@dataclass(frozen=True, slots=True)
class Row:
    name: str
    mission: LandmarkMission
    first: int = UNSEEN
    runs: int = 30


ROWS = (
    Row("`loop`", run(planner="loop"), CHOSEN, 40),
    Row("`joint`", run(planner="joint"), CHOSEN, 60),
    Row("`loop`, 296 steps", run(planner="loop", until=296)),
    Row("`coverage`, robot 2 of 4 dead at 40", replace(run(planner="coverage", robots=4), kills={1: 40})),
    Row("`paper`, one robot", run(robots=1)),
    Row("`loop`, one robot", run(planner="loop", robots=1)),
    Row("`paper`, printed noise, 1,000 steps", run(1.0)),
)


def cells(row: Row, runs: list[LandmarkRunScore]) -> list[str]:
    def mean(what: str) -> float:
        return float(np.mean([v for r in runs if (v := getattr(r, what)) is not None]))

    steps = [r.steps for r in runs]
    return [
        row.name,
        f"{row.first}–{row.first + row.runs - 1}",
        f"{sum(bool(r.finished) for r in runs)} of {row.runs}",
        f"{min(steps)} / {max(steps)} / {mean('steps'):.0f}",
        f"{mean('map_error'):.3f} m",
        f"{mean('c_per_n'):.3f} m²",
        f"{mean('nees_per_dof'):.2f}",
    ]


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--jobs", type=int, default=1)
    asked = ask.parse_args()
    print("| two robots, calibrated noise | seeds | finished | steps min / max / mean | map error | C/N | NEES/dof |")
    print("|---|---|---|---|---|---|---|")
    with worker_pool(asked.jobs, max(row.runs for row in ROWS)) as pool:
        for row in ROWS:
            runs = explore_many(row.mission, row.runs, row.first, pool)
            print(f"| {' | '.join(cells(row, runs))} |", flush=True)


if __name__ == "__main__":
    main()
