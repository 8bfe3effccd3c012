"""How smoothing a whole team grows with robots and minutes, and the same problem beside GTSAM (`beside_gtsam.py`).

    python benchmarks/team_growth.py [--sizes 2x2,5x2,10x2,10x5] [--target 100x15] [--no-gtsam] [--seed 1] [--json FILE]

Each size runs in a process of its own: processor time of filters, fusing and smoothing, the largest memory, factors and
poses. The exponents of time and memory against robots x minutes are fitted, and drawn out to the target (which is not
run).
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
from mapweave.api.evaluate_team import read_team_truth
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


def one(robots: int, minutes: float, seed: int, *, gtsam: bool) -> Row:
    keep_one_blas_thread()
    if gtsam:
        from beside_gtsam import with_gtsam
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
    row = {
        "robots": robots,
        "minutes": minutes,
        "tied": len(team.robots),
        "poses": done.poses,
        "factors": sum(done.used.values()),
        "filters_s": filtered - began,
        "fuse_s": fused - filtered,
        "smooth_s": end - fused,
        "total_s": end - began,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "rmse": score_team([done.map], {}, truth.survey, {}).landmarks.rmse,
    }
    return row | (with_gtsam(team, logs, fusion.labels, truth) if gtsam else {})


def fitted(size: np.ndarray, values: np.ndarray, target: float) -> tuple[float, float]:
    """The exponent against size, and what it draws out to at the target."""
    slope, level = np.polyfit(np.log(size), np.log(values), 1)
    return float(slope), float(np.exp(level + slope * np.log(target)))


def _size(text: str) -> tuple[int, float]:
    robots, _, minutes = text.partition("x")
    return int(robots), float(minutes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", default="2x2,5x2,10x2,10x5")
    parser.add_argument("--target", default="100x15")
    parser.add_argument("--no-gtsam", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one")
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(*_size(args.one), args.seed, gtsam=not args.no_gtsam)))
        return
    rows = []
    names = (
        "robots",
        "minutes",
        "tied",
        "poses",
        "factors",
        "filters_s",
        "fuse_s",
        "smooth_s",
        "total_s",
        "gigabytes",
        "rmse",
    )
    more = () if args.no_gtsam else ("ours_s", "gtsam_s", "ratio", "ours_rmse", "gtsam_rmse")
    print(" ".join(f"{n:>10}" for n in (*names, *more)), flush=True)
    for size in args.sizes.split(","):
        command = [sys.executable, __file__, "--one", size, "--seed", str(args.seed)]
        command += ["--no-gtsam"] if args.no_gtsam else []
        rows.append(
            json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1])
        )
        print(" ".join(f"{rows[-1][n]:>10.4g}" for n in (*names, *more)), flush=True)
    robots, minutes = _size(args.target)
    size = np.array([row["robots"] * row["minutes"] for row in rows])
    fits = {
        n: fitted(size, np.array([row[n] for row in rows]), robots * minutes)
        for n in ("total_s", "smooth_s", "gigabytes")
    }
    for name, (slope, there) in fits.items():
        print(f"{name} grows with robots x minutes to the power {slope:.2f}; drawn out to {args.target}: {there:.3g}")
    if args.json:
        args.json.write_text(json.dumps({"rows": rows, "fits": fits}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
