"""How smoothing a whole team grows with robots and minutes, and the same problem beside GTSAM with calibration frozen.

    python benchmarks/team_growth.py [--sizes 2x2,5x2,10x2,10x5] [--target 100x15] [--no-gtsam] [--seed 1] [--json FILE]

Each size runs in a process of its own: processor time of filters, fusing and smoothing, the largest memory, factors and
poses. The exponents of time and memory against robots x minutes are fitted, and drawn out to the target (which is not
run). GTSAM takes the same poses, sightings and kernels, each sighting carried to its pose; errors of both are those of
landmarks beside the truth under one rigid alignment.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mapweave import simulate_landmarks
from mapweave.api.evaluate_team import read_team_truth
from mapweave.api.team import team_maps
from mapweave.core import se2
from mapweave.core.workers import keep_one_blas_thread
from mapweave.evaluation.team import score_team
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.landmarks.mapping import local_map
from mapweave.solve import SolveConfig, minimise
from mapweave.team.config import SmoothingConfig
from mapweave.team.problem import team_problem
from mapweave.team.robot_part import PARAMETERS
from mapweave.team.smooth import smooth
from mapweave.team.team_map import TeamMap

CFG = SmoothingConfig()
Row = dict[str, float]


def rmse(team: TeamMap, mean: np.ndarray, truth) -> float:
    landmarks = LandmarkMap(team.landmarks.ids, mean, team.landmarks.cov)
    return score_team([replace(team, landmarks=landmarks)], {}, truth.survey, {}).landmarks.rmse


def frozen(team: TeamMap, logs: list):
    """The team's problem with every robot's calibration held."""
    held = {p: (getattr(CFG.calibration, p), 0.0) for p in PARAMETERS}
    return team_problem(logs, team.landmarks, team.tracks, {}, {log.robot: held for log in logs}, CFG)


def with_gtsam(team: TeamMap, logs: list, truth) -> Row:
    """Seconds and errors of both on the same frozen problem, from the same start."""
    import gtsam

    whole = frozen(team, logs)
    began = time.process_time()
    ours = minimise(
        whole.problem,
        SolveConfig(max_iterations=CFG.max_iterations, damping=1e-4, step_tolerance=1e-4, cost_tolerance=5e-5),
        whole.pattern,
    )
    ours_s = time.process_time() - began
    began = time.process_time()
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    calibration = CFG.calibration
    first, key = {}, 0
    for part in whole.parts:
        first[part.robot] = key
        for k, pose in enumerate(part.instants.start):
            values.insert(key + k, gtsam.Pose2(*pose))
        key += len(part.instants.t)
    marks = {name: key + k for k, name in enumerate(team.landmarks.ids)}
    for name, p in zip(team.landmarks.ids, team.landmarks.mean, strict=True):
        values.insert(marks[name], gtsam.Point2(*p))
    graph.add(gtsam.PriorFactorPose2(0, values.atPose2(0), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    camera = CFG.camera
    sight = gtsam.noiseModel.mEstimator.Cauchy.Create(camera.outlier)
    drive = gtsam.noiseModel.mEstimator.Cauchy.Create(CFG.motion.outlier)
    for part in whole.parts:
        t, lag, a = part.instants.t, calibration.lag, first[part.robot]
        steps = part.motion.between(t, calibration.speed_scale, calibration.turn_scale, lag).step
        for k, (step, Q) in enumerate(zip(steps, part.motion.noise(t, lag, CFG.motion), strict=True)):
            noise = gtsam.noiseModel.Robust.Create(drive, gtsam.noiseModel.Gaussian.Covariance(Q))
            graph.add(gtsam.BetweenFactorPose2(a + k, a + k + 1, gtsam.Pose2(*step), noise))
        table = part.seen
        near, way = part.instants.from_nearest(table.t)
        point = table.range[:, None] * np.stack([np.cos(table.bearing), np.sin(table.bearing)], axis=-1)
        there = np.stack([se2.act(w, p[None])[0] for w, p in zip(way, point, strict=True)])
        for k, at, p in zip(table.what, near, there, strict=True):
            name = table.ids[k]
            distance, bearing = float(np.hypot(*p)), gtsam.Rot2.fromAngle(float(np.arctan2(p[1], p[0])))
            robot = name in first
            if not robot and name not in marks:
                continue
            floor, angle = (
                (camera.robot_range_floor, camera.robot_bearing) if robot else (camera.range_floor, camera.bearing)
            )
            sd = np.array([angle, np.hypot(floor, camera.range_share * distance)])
            noise = gtsam.noiseModel.Robust.Create(sight, gtsam.noiseModel.Diagonal.Sigmas(sd))
            if robot:
                other = whole.parts[[q.robot for q in whole.parts].index(name)]
                b = first[name] + int(other.instants.nearest(np.array([t[at]]))[0])
                graph.add(gtsam.BearingRangeFactorPose2(a + int(at), b, bearing, distance, noise))
            else:
                graph.add(gtsam.BearingRangeFactor2D(a + int(at), marks[name], bearing, distance, noise))
    built = time.process_time() - began
    began = time.process_time()
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    theirs_s = time.process_time() - began
    theirs = np.array([result.atPoint2(marks[name]) for name in team.landmarks.ids])
    return {
        "ours_s": ours_s,
        "gtsam_s": theirs_s,
        "gtsam_building_s": built,
        "ratio": ours_s / theirs_s,
        "ours_rmse": rmse(team, ours.x[whole.landmark_columns].reshape(-1, 2), truth),
        "gtsam_rmse": rmse(team, theirs, truth),
    }


def one(robots: int, minutes: float, seed: int, *, gtsam: bool) -> Row:
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
    return row | (with_gtsam(team, [log for log in logs if log.robot in team.robots], truth) if gtsam else {})


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
