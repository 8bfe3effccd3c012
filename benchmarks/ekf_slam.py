"""EKF-SLAM time a step at 50, 200, 500 and 1,000 landmarks, beside GTSAM's ISAM2 on the same problem.

    python benchmarks/ekf_slam.py [--landmarks 50,200,500,1000] [--steps 200] [--no-gtsam] [--json FILE]

The robot drives loops among landmarks, five odometry rows and one camera frame of the nearest six a step. All
landmarks are in the map before the clock starts. A step of ours is `landmarks.ekf_slam.step` of both events, what it
copies included; one of ISAM2's is the update with the new factors and the estimate of the new pose.
"""

import argparse
import json
import platform
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Event, Odometry, Sightings
from mapweave.landmarks import ekf_slam
from mapweave.landmarks.config import EkfSlamConfig

ROWS, H, V, W = 5, 0.05, 0.5, 0.15  # odometry rows a step, [s], [m/s], [rad/s]
SIGMA_R, SIGMA_B = 0.05, 0.014  # [m], [rad]
CFG = EkfSlamConfig(
    range_floor=SIGMA_R, range_share=0.0, bearing=SIGMA_B, range_inflation=1.0, bearing_inflation=1.0, gate=1e9,
    agree=1, turn_scale=1.0, turn_scale_sd=0.0, lag=0.0, lag_sd=0.0, bearing_bias_sd=0.0, range_scale_sd=0.0,
    noise_along=0.02, noise_across=0.01, noise_drift=0.02, noise_turn=0.02,
)  # fmt: skip


def driven(pose):
    """The pose after one odometry row: an arc of radius V / W."""
    end = pose[2] + W * H
    x, y = pose[:2] + V / W * np.array([np.sin(end) - np.sin(pose[2]), np.cos(pose[2]) - np.cos(end)])
    return np.array([x, y, se2.wrap_angle(end)])


def world(landmarks, steps, seed=0):
    """Points, odometry noise included in the drive, and (step) -> ids, ranges, bearings; step 0 sees everything."""
    rng = np.random.default_rng(seed)
    side = 1.2 * np.sqrt(landmarks)
    points = rng.uniform(-side / 2, side / 2, (landmarks, 2)) + np.array([0.0, V / W])
    pose, poses, frames = np.zeros(3), [], []
    for step in range(steps + 1):
        if step:
            for _ in range(ROWS):
                pose = driven(pose)
                pose = se2.compose(pose, rng.normal(size=3) * [0.003, 0.0015, 0.005])
        ahead = se2.act(se2.inverse(pose), points)
        z = np.stack([np.hypot(*ahead.T), np.arctan2(ahead[:, 1], ahead[:, 0])], axis=1)
        near = np.arange(landmarks) if step == 0 else np.argsort(z[:, 0])[:6]
        noisy = z[near] + rng.normal(size=(len(near), 2)) * [SIGMA_R, SIGMA_B]
        poses.append(pose)
        frames.append((near, noisy))
    return points, np.array(poses), frames


def ours(points, frames):
    """Milliseconds a step, and the final landmark error [m]."""
    rng = np.random.default_rng(0)
    state = ekf_slam.init("robot1", CFG, rng)
    times = []
    for step, (near, z) in enumerate(frames):
        end = step * ROWS * H
        ids = tuple(str(k) for k in near)
        seen = Event(end, "robot1", Sightings(ids, z[:, 0].copy(), z[:, 1].copy()))
        t = end - H * np.arange(ROWS, 0, -1) if step else np.zeros(1)
        rows = Event(t[-1], "robot1", Odometry(t, np.full(len(t), V), np.full(len(t), W)))
        start = time.perf_counter()
        if step:
            state, _ = ekf_slam.step(state, rows, CFG, rng)
        state, _ = ekf_slam.step(state, seen, CFG, rng)
        times.append(time.perf_counter() - start)
    submap = state.submap
    truth = points[[int(name) for name in submap.ids]]
    return times[2:], float(np.sqrt(((submap.mean - truth) ** 2).sum(axis=1).mean()))


def isam(points, frames):
    """The same for ISAM2."""
    import gtsam

    see = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_B, SIGMA_R]))
    drive = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.007, 0.0035, 0.012]))
    step_pose = np.zeros(3)
    for _ in range(ROWS):
        step_pose = driven(step_pose)
    isam2 = gtsam.ISAM2()
    estimate, times = gtsam.Pose2(0.0, 0.0, 0.0), []
    for step, (near, z) in enumerate(frames):
        start = time.perf_counter()
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if step == 0:
            graph.add(gtsam.PriorFactorPose2(0, estimate, gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
        else:
            moved = gtsam.Pose2(*step_pose)
            graph.add(gtsam.BetweenFactorPose2(step - 1, step, moved, drive))
            estimate = estimate.compose(moved)
        values.insert(step, estimate)
        for k, (r, b) in zip(near, z, strict=True):
            graph.add(gtsam.BearingRangeFactor2D(step, gtsam.symbol("l", int(k)), gtsam.Rot2(b), r, see))
            if step == 0:
                values.insert(gtsam.symbol("l", int(k)), r * np.array([np.cos(b), np.sin(b)]))
        isam2.update(graph, values)
        estimate = isam2.calculateEstimatePose2(step)
        times.append(time.perf_counter() - start)
    mean = np.array([isam2.calculateEstimatePoint2(gtsam.symbol("l", k)) for k in range(len(points))])
    return times[2:], float(np.sqrt(((mean - points) ** 2).sum(axis=1).mean()))


def summary(times, rmse):
    ms = 1e3 * np.array(times)
    return {"median_ms": float(np.median(ms)), "mean_ms": float(ms.mean()), "worst_ms": float(ms.max()), "rmse_m": rmse}


def line(row):
    return f"{row['median_ms']:9.3f} {row['mean_ms']:7.3f} {row['worst_ms']:7.2f} {row['rmse_m']:7.4f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--landmarks", default="50,200,500,1000")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--no-gtsam", action="store_true")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    rows = []
    head = f"{'landmarks':>9} {'ms a step':>9} {'mean':>7} {'worst':>7} {'RMSE m':>7}"
    print(f"{head}   {'ISAM2 ms':>9} {'mean':>7} {'worst':>7} {'RMSE m':>7} {'ratio':>6}")
    for n in map(int, args.landmarks.split(",")):
        points, _, frames = world(n, args.steps)
        ours(points, frames[:4])  # compile
        times, rmse = ours(points, frames)
        row = {"landmarks": n, "mapweave": summary(times, rmse)}
        told = f"{n:9d} {line(row['mapweave'])}"
        if not args.no_gtsam:
            row["isam2"] = summary(*isam(points, frames))
            row["isam2_over_mapweave"] = row["isam2"]["median_ms"] / row["mapweave"]["median_ms"]
            told += f"   {line(row['isam2'])} {row['isam2_over_mapweave']:6.2f}"
        rows.append(row)
        print(told, flush=True)
    told = {"python": platform.python_version(), "numpy": version("numpy"), "numba": version("numba"), "rows": rows}
    if not args.no_gtsam:
        told["gtsam"] = version("gtsam")
    print(json.dumps(told))
    if args.json:
        args.json.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
