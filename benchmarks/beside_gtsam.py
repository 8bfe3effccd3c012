"""The team's problem beside GTSAM with calibration frozen: the same poses, sightings and kernels, the same start.

    MAPWEAVE_DATA=... python benchmarks/beside_gtsam.py [--sets 1,3,4,6] [--teams 2x2,5x2,10x2] [--seed 1]

Sets are MRCLAM's; a team is simulated, of so many robots for so many minutes. Processor time of one thread for both,
the better of two runs (compiled kernels are loaded in the first): ordering and all iterations, without making the
factors. Each sighting is carried to its pose. Errors [m] are those of landmarks beside the truth under one rigid
alignment, labels that the survey shows to be exchanged put back; `cost`: that of GTSAM's answer over ours, both in our
problem.
A robot without odometry wanders, which GTSAM is told as a step of nothing with the same noise.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np

from mapweave import simulate_landmarks
from mapweave.api.evaluate import TeamTruth, read_team_truth
from mapweave.api.team import team_maps
from mapweave.core import se2
from mapweave.core.landmark_log import LandmarkLog
from mapweave.core.workers import keep_one_blas_thread
from mapweave.evaluation.landmarks import find_exchanges
from mapweave.evaluation.team import score_team
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.landmarks.mapping import local_map
from mapweave.solve import SolveConfig, minimise
from mapweave.team.config import MOTION_NOISE_OUTLIER, UNKNOWN_MEMORY, SmoothingConfig
from mapweave.team.factors import CAMERA_NOISE_OUTLIER
from mapweave.team.problem import SMOOTHING_ITERATIONS, TeamProblem, team_problem
from mapweave.team.robot_part import PARAMETERS, RobotPart, random_walk
from mapweave.team.team_map import TeamMap

CFG = SmoothingConfig()
LIMITS = SolveConfig(max_iterations=SMOOTHING_ITERATIONS, damping=1e-4, step_tolerance=1e-4, cost_tolerance=5e-5)
Labels = Mapping[str, Mapping[str, str]]
Row = dict[str, float]


def rmse(team: TeamMap, mean: np.ndarray, truth: TeamTruth) -> float:
    moved = replace(team, landmarks=LandmarkMap(team.landmarks.ids, mean, team.landmarks.cov))
    survey = find_exchanges(moved.landmarks, truth.survey)[1]
    return score_team([moved], {}, survey, {}).landmarks.rmse


def frozen(team: TeamMap, logs: Sequence[LandmarkLog], labels: Labels) -> TeamProblem:
    """The team's problem with every robot's calibration held."""
    held = {p: (getattr(CFG.calibration, p), 0.0) for p in PARAMETERS}
    return team_problem(logs, team.landmarks, team.tracks, labels, {log.robot: held for log in logs}, CFG)


def steps_of(part: RobotPart) -> tuple[np.ndarray, np.ndarray]:
    """How the robot went from each instant to the next, and the covariances."""
    t, known = part.instants.t, CFG.calibration
    if part.motion is None:
        keeps = part.instants.gap
        if not len(part.log.sightings):
            keeps = np.maximum(keeps, UNKNOWN_MEMORY)
        return np.zeros((len(t) - 1, 3)), random_walk(t, keeps)
    moved = part.motion.between(t, known.speed_scale, known.turn_scale, known.lag)
    return moved.step, part.motion.noise(t, known.lag, CFG.motion)


def graph_of(
    whole: TeamProblem, labels: Labels, landmarks: LandmarkMap
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """GTSAM's own factors over the same poses (keys in the order of x), then landmarks, and where to start."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = {part.robot: part.start // 3 for part in whole.parts}
    parts = {part.robot: part for part in whole.parts}
    marks = {name: whole.landmark_start // 3 + k for k, name in enumerate(whole.landmarks)}
    for part in whole.parts:
        for k, pose in enumerate(part.instants.start):
            values.insert(first[part.robot] + k, gtsam.Pose2(*pose))
    for name, p in zip(landmarks.ids, landmarks.mean, strict=True):
        values.insert(marks[name], gtsam.Point2(*p))
    held = np.flatnonzero(whole.problem.fixed[: whole.landmark_start : 3])
    for k in held.tolist():
        graph.add(gtsam.PriorFactorPose2(k, values.atPose2(k), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    for part in whole.parts:
        add_steps(graph, part, first[part.robot])
        add_sightings(graph, part, parts, first, marks, labels.get(part.robot, {}))
    return graph, values


def add_steps(graph: gtsam.NonlinearFactorGraph, part: RobotPart, first: int) -> None:
    """How a robot went from pose to pose, the first of which has the key `first`."""
    drive = gtsam.noiseModel.mEstimator.Cauchy.Create(MOTION_NOISE_OUTLIER)
    for k, (step, Q) in enumerate(zip(*steps_of(part), strict=True)):
        if np.isfinite(part.instants.gap[k]):
            noise = gtsam.noiseModel.Gaussian.Covariance(Q)
            if part.motion is not None:
                noise = gtsam.noiseModel.Robust.Create(drive, noise)
            graph.add(gtsam.BetweenFactorPose2(first + k, first + k + 1, gtsam.Pose2(*step), noise))


def add_sightings(
    graph: gtsam.NonlinearFactorGraph,
    part: RobotPart,
    parts: Mapping[str, RobotPart],
    first: Mapping[str, int],
    marks: Mapping[str, int],
    labels: Mapping[str, str],
) -> None:
    """What a robot saw of others, whose first poses have the keys `first`, and of landmarks."""
    camera, table = CFG.camera, part.seen
    sight = gtsam.noiseModel.mEstimator.Cauchy.Create(CAMERA_NOISE_OUTLIER)
    near, way = part.instants.from_nearest(table.t)
    point = table.range[:, None] * np.stack([np.cos(table.bearing), np.sin(table.bearing)], axis=-1)
    there = np.stack([se2.act(w, p[None])[0] for w, p in zip(way, point, strict=True)])
    for t, k, at, p in zip(table.t, table.what, (first[part.robot] + near).tolist(), there, strict=True):
        name = table.ids[k]
        other = parts.get(name) if name != part.robot else None
        landmark = marks.get(labels.get(name, name))
        floor, angle = (
            (camera.robot_range_floor, camera.robot_bearing) if other else (camera.range_floor, camera.bearing)
        )
        distance, bearing = float(np.hypot(*p)), gtsam.Rot2.fromAngle(float(np.arctan2(p[1], p[0])))
        sd = np.array([angle, np.hypot(floor, camera.range_share * distance)])
        noise = gtsam.noiseModel.Robust.Create(sight, gtsam.noiseModel.Diagonal.Sigmas(sd))
        if other is None and landmark is not None:
            graph.add(gtsam.BearingRangeFactor2D(at, landmark, bearing, distance, noise))
        elif other is not None and other.instants.t[0] <= t <= other.instants.t[-1]:
            to = first[name] + int(other.instants.nearest(np.array([t]))[0])
            graph.add(gtsam.BearingRangeFactorPose2(at, to, bearing, distance, noise))


def with_gtsam(team: TeamMap, logs: Sequence[LandmarkLog], labels: Labels, truth: TeamTruth) -> Row:
    """Seconds and errors of both on the same frozen problem, from the same start."""
    whole = frozen(team, [log for log in logs if log.robot in team.robots], labels)
    graph, values = graph_of(whole, labels, team.landmarks)
    ours_s = theirs_s = np.inf
    for _ in range(2):
        began = time.process_time()
        ours = minimise(whole.problem, LIMITS, whole.pattern)
        ours_s = min(ours_s, time.process_time() - began)
        began = time.process_time()
        result = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
        theirs_s = min(theirs_s, time.process_time() - began)
    poses = whole.landmark_start // 3
    theirs = np.array([result.atPoint2(poses + k) for k in range(len(whole.landmarks))])
    x = ours.x.copy()
    ways = [result.atPose2(k) for k in range(poses)]
    x[: whole.landmark_start] = np.array([[p.x(), p.y(), p.theta()] for p in ways]).ravel()
    x[whole.landmark_columns] = theirs.ravel()
    return {
        "poses": poses,
        "sightings": sum(whole.used.values()),
        "ours_s": ours_s,
        "gtsam_s": theirs_s,
        "ratio": ours_s / theirs_s,
        "ours_rmse": rmse(team, ours.x[whole.landmark_columns].reshape(-1, 2), truth),
        "gtsam_rmse": rmse(team, theirs, truth),
        "cost": whole.problem.cost(x) / ours.cost,
    }


def measured(path: Path) -> Row:
    """A recording mapped robot by robot and fused, then smoothed by both."""
    logs = list(read_landmark_logs(path, None))
    local = [local_map(log) for log in logs]
    fusion = fuse(local, FuseConfig())
    truth = read_team_truth([path], [log.robot for log in logs])
    return with_gtsam(team_maps(local, fusion)[0], logs, fusion.labels, truth)


def told(name: str, row: Row) -> str:
    numbers = [f"{row['poses']}", f"{row['sightings']}", f"{row['ours_s']:.3f}", f"{row['gtsam_s']:.3f}"]
    numbers += [f"{row['ratio']:.2f}", f"{row['ours_rmse']:.4f}", f"{row['gtsam_rmse']:.4f}", f"{row['cost']:.3f}"]
    return f"| {name} | {' | '.join(numbers)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("MAPWEAVE_DATA"))
    parser.add_argument("--sets", default="1,3,4,6")
    parser.add_argument("--teams", default="2x2,5x2,10x2")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    keep_one_blas_thread()
    heads = ("problem", "poses", "sightings", "ours [s]", "GTSAM [s]", "ratio", "RMSE", "of GTSAM", "cost")
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|", flush=True)
    for name in filter(None, args.sets.split(",")):
        if args.data is None:
            parser.error("say where the real logs are: --data or MAPWEAVE_DATA")
        path = Path(args.data) / "mrclam" / f"MRCLAM_Dataset{name}.zip"
        print(told(f"set {name}", measured(path)), flush=True)
    for size in filter(None, args.teams.split(",")):
        robots, minutes = size.split("x")
        with tempfile.TemporaryDirectory() as folder:
            where = Path(folder) / "team"
            simulate_landmarks(where, robots=int(robots), minutes=float(minutes), seed=args.seed)
            print(told(f"{robots} robots, {minutes} min", measured(where)), flush=True)


if __name__ == "__main__":
    main()
