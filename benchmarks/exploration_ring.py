"""Two laser robots round a bare ring of corridors, one each way, with loops closed and without, as a Markdown table.

    python benchmarks/exploration_ring.py [--drives 10]

The ring and the drives are those of the tests of the team's estimator (`tests/laser/buildings.py`), seeds from 0.
"""

import argparse
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # the ring is that of the tests

from tests.laser.buildings import drive, errors, estimate, lap, ring, wall_distance

from mapweave.mapping import laser_team


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--drives", type=int, default=10)
    drives = ask.parse_args().drives
    there, back = lap(), lap(backwards=True)
    told: dict[str, list[tuple[float, float, float]]] = {"closed": [], "not closed": []}
    for seed in range(drives):
        run = drive(ring(seed=seed), [(*there[0], 0.0), (*back[0], np.pi)], [there[1:], back[1:]], seed)
        for name, tries in zip(told, (laser_team.CLOSURE_TRIES, 0), strict=True):
            with patch.object(laser_team, "CLOSURE_TRIES", tries):
                team = estimate(run)
            e, nees = errors(team, run)
            told[name].append(
                (float(np.sqrt(np.mean(e[:, 0] ** 2 + e[:, 1] ** 2))), float(wall_distance(team, run).mean()), nees)
            )
    print("| loops | drives | RMSE of keyframes, mean, greatest | occupied cells to the wall, mean | NEES/dof, mean |")
    print("|---|---|---|---|---|")
    for name, rows in told.items():
        rmse, wall, nees = np.array(rows).T
        print(
            f"| {name} | {drives} | {rmse.mean():.3f}, {rmse.max():.3f} m | {wall.mean():.3f} m | {nees.mean():.2f} |"
        )


if __name__ == "__main__":
    main()
