"""How mapping a whole team grows with robots and minutes.

    python benchmarks/team_growth.py [--sizes 10x2,10x5,20x5,40x5,100x15] [--seed 1]

Each size runs in a process of its own, the filters one after the other: processor time of filters, fusing and
smoothing, the largest memory, poses estimated and errors against the truth. Prints a Markdown table; its last row is
the exponent in robots x minutes, from the first size to the last.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mapweave import simulate_landmarks
from mapweave.api.evaluate import read_team_truth
from mapweave.api.team import team_maps
from mapweave.core.workers import keep_one_blas_thread
from mapweave.evaluation.team import score_team
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.mapping import local_map
from mapweave.team.config import SmoothingConfig
from mapweave.team.smooth import smooth

CFG = SmoothingConfig()
Row = dict[str, float]
COLUMNS = {
    "tied": ("robots in one map", "d"),
    "poses": ("poses", "d"),
    "factors": ("sightings", "d"),
    "filters_s": ("filters [s]", ".1f"),
    "fuse_s": ("fusing [s]", ".1f"),
    "smooth_s": ("smoothing [s]", ".1f"),
    "total_s": ("in all [s]", ".1f"),
    "gigabytes": ("memory [GiB]", ".2f"),
    "rmse": ("landmarks [m]", ".3f"),
    "ate": ("trajectories [m]", ".3f"),
}
FITTED = ("poses", "factors", "filters_s", "fuse_s", "smooth_s", "total_s", "gigabytes")


def one(robots: int, minutes: float, seed: int) -> Row:
    keep_one_blas_thread()
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / "team"
        simulate_landmarks(where, robots=robots, minutes=minutes, seed=seed)
        logs = list(read_landmark_logs(where, None))
        truth = read_team_truth([where], [log.robot for log in logs])
    local_map(logs[0].until(logs[0].span[0] + 5.0))  # kernels compiled or loaded
    began = time.process_time()
    local = [local_map(log) for log in logs]
    filtered = time.process_time()
    fusion = fuse(local, FuseConfig())
    team = team_maps(local, fusion)[0]
    fused = time.process_time()
    done = smooth(team, logs, fusion.labels, CFG)
    end = time.process_time()
    score = score_team([done.map], {}, truth.survey, truth.robots)
    return {
        "tied": len(team.robots),
        "poses": done.poses,
        "factors": sum(done.used.values()),
        "filters_s": filtered - began,
        "fuse_s": fused - filtered,
        "smooth_s": end - fused,
        "total_s": end - began,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "rmse": score.landmarks.rmse,
        "ate": float(np.mean([robot.ate for robot in score.robots.values() if robot.ate is not None])),
    }


def _size(text: str) -> tuple[int, float]:
    robots, _, minutes = text.partition("x")
    return int(robots), float(minutes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="10x2,10x5,20x5,40x5,100x15")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--one")
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(*_size(args.one), args.seed)))
        return
    sizes = [_size(text) for text in args.sizes.split(",")]
    print(f"| robots x minutes | {' | '.join(head for head, _ in COLUMNS.values())} |")
    print("|---" * (len(COLUMNS) + 1) + "|", flush=True)
    rows: list[Row] = []
    for robots, minutes in sizes:
        command = [sys.executable, __file__, "--one", f"{robots}x{minutes}", "--seed", str(args.seed)]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        rows.append(json.loads(said.splitlines()[-1]))
        cells = [format(rows[-1][name], how) for name, (_, how) in COLUMNS.items()]
        print(f"| {robots} x {minutes:g} | {' | '.join(cells)} |", flush=True)
    if len(sizes) > 1:
        size = np.log([robots * minutes for robots, minutes in sizes])
        slopes = {name: float(np.polyfit(size, np.log([row[name] for row in rows]), 1)[0]) for name in FITTED}
        cells = [f"{slopes[name]:.2f}" if name in slopes else "" for name in COLUMNS]
        print(f"| exponent | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
