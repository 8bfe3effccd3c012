"""Robots and beacons placed by ranges from no guess, beside GTSAM's batch that starts at the truth, in one run.

    MAPWEAVE_DATA=.. python benchmarks/ranges.py

GTSAM has the very factors of the file. ATE: one rigid transform for the whole team, all poses. Turtlebots: motion
capture is the truth, read after the estimate; relative position: where each robot lies as seen from the first.
Simulated: five robots and four beacons, a minute and a half, seeds 0 to 15, the mean of all; NEES of the beacons, frame
free.
"""

import os
import sys
from pathlib import Path
from time import process_time

import gtsam
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # logs are made as those of the tests

from tests.ranges.worlds import log_of

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.core.truth import Survey
from mapweave.evaluation.landmarks import score_landmarks
from mapweave.io.bag import open_bag
from mapweave.io.pyfg import PyfgFile, read_pyfg
from mapweave.io.range_bags import read_range_bag
from mapweave.io.transforms import planar, rigid
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.ranges.estimate import PlacedPart, RangeEstimate, estimate
from mapweave.ranges.network import RangeNetwork, network_of
from mapweave.sim.mixed_team import MixedWorld, simulate_mixed

SEEDS, MINUTES, BEACONS = range(16), 1.5, 4
RADIOS = {"n_7": "turtle01", "n_3": "turtle03", "n_4": "turtle04", "n_5": "turtle05"}


def row(name: str, net: RangeNetwork, far: object, ate: float, relative: str, nees: str, cpu: float) -> None:
    cells = [name, len(net.robots), len(net.beacons), len(net.ranges), far, f"{ate:.4f}", relative, nees, f"{cpu:.1f}"]
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def timed(net: RangeNetwork) -> tuple[RangeEstimate, float]:
    cpu = process_time()
    return estimate(net), process_time() - cpu


def ate_of(pose: np.ndarray, truth: np.ndarray) -> float:
    T = se2.align(pose[:, :2], truth[:, :2])
    return float(np.sqrt(np.square(se2.act(T, pose[:, :2]) - truth[:, :2]).sum(axis=1).mean()))


def by_gtsam(file: PyfgFile) -> tuple[np.ndarray, float]:
    """Poses of the batch optimum near the truth, and CPU seconds."""
    net, factors, values = file.network, gtsam.NonlinearFactorGraph(), gtsam.Values()
    beacon = net.is_beacon
    for k, pose in enumerate(file.places.tolist()):
        values.insert(k, gtsam.Point2(*pose[:2]) if beacon[k] else gtsam.Pose2(*pose))
    m, r = net.motions, net.ranges
    for i, j, z, cov in zip(m.first.tolist(), m.second.tolist(), m.z.tolist(), m.cov, strict=True):
        noise = gtsam.noiseModel.Gaussian.Covariance(cov)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z), noise))
    for a, b, z, sd in zip(r.a.tolist(), r.b.tolist(), r.z.tolist(), r.sd.tolist(), strict=True):
        kind = gtsam.RangeFactor2D if beacon[b] else gtsam.RangeFactorPose2
        factors.add(kind(a, b, z, gtsam.noiseModel.Isotropic.Sigma(1, sd)))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*file.places[0].tolist())))
    cpu = process_time()
    found = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    cpu = process_time() - cpu
    poses = [found.atPose2(k) for k in np.flatnonzero(~beacon).tolist()]
    return np.array([[p.x(), p.y(), p.theta()] for p in poses]), cpu


def tiers(folder: Path) -> None:
    file = read_pyfg(folder / "tiers.pyfg.gz")
    net, driven = file.network, ~file.network.is_beacon
    found, cpu = timed(net)
    row("tiers", net, int(found.far.sum()), ate_of(found.parts[0].pose[driven], file.places[driven]), "", "", cpu)
    poses, cpu = by_gtsam(file)
    row("tiers, GTSAM from the truth", net, "", ate_of(poses, file.places[driven]), "", "", cpu)


def captured(path: Path, clock: int) -> dict[str, Track]:
    """Motion capture of every robot; clock: 0 by the headers, 1 by when it was recorded."""
    bag, rows = open_bag(path, ()), {}
    for topic, ns, message in bag.messages({t for t in bag.kinds if "turtlebot" in t and "_cap" in t}):
        stamp = message.header.stamp
        t = (stamp.sec + stamp.nanosec * 1e-9, ns * 1e-9)[clock]
        name = f"turtle{int(topic.split('turtlebot')[1].split('_')[0]):02d}"
        rows.setdefault(name, []).append((t, *planar(rigid(message.pose.position, message.pose.orientation))))
    tracks = {}
    for name, values in rows.items():
        table = np.array(values)
        table = table[np.append(np.diff(table[:, 0]) > 0, True)]
        tracks[name] = Track(table[:, 0], table[:, 1:])
    return tracks


def beside_truth(net: RangeNetwork, part: PlacedPart, truth: dict[str, Track]) -> tuple[float, str]:
    """ATE of the team, and where the second robot lies as seen from the first: position [m], bearing [deg]."""
    mine, true, seen = [], [], []
    full = np.full((len(net.owner), 3), np.nan)
    full[part.nodes] = part.pose
    tracks = {name: net.track(k, full) for k, name in enumerate(net.robots)}
    for name, track in tracks.items():
        if name not in truth or not len(track.t):
            continue
        inside = (track.t >= truth[name].t[0]) & (track.t <= truth[name].t[-1])
        mine.append(track.pose[inside])
        true.append(se2.interpolate(track.t[inside], truth[name].t, truth[name].pose))
    if len(tracks) == 2:
        (a, one), (b, two) = tracks.items()
        t = one.t[(one.t >= two.t[0]) & (one.t <= two.t[-1])]
        for source in (tracks, truth):
            p, q = (se2.interpolate(t, source[name].t, source[name].pose) for name in (a, b))
            seen.append(se2.between(p, q))
        off = np.hypot(*(seen[0] - seen[1])[:, :2].T)
        turned = np.arctan2(seen[0][:, 1], seen[0][:, 0]) - np.arctan2(seen[1][:, 1], seen[1][:, 0])
        degrees = np.degrees(np.sqrt(np.square(se2.wrap_angle(turned)).mean()))
        return ate_of(
            np.concatenate(mine), np.concatenate(true)
        ), f"{np.sqrt(np.square(off).mean()):.3f}, {degrees:.1f}"
    return ate_of(np.concatenate(mine), np.concatenate(true)), ""


def turtlebots(folder: Path) -> None:
    for name, radios, clock in (("two", None, 0), ("four", RADIOS, 1)):
        path = folder / f"{name}-turtlebots.db3"
        net = network_of(read_range_bag(path, radios))
        found, cpu = timed(net)
        ate, relative = beside_truth(net, found.parts[0], captured(path, clock))
        row(f"{name} turtlebots", net, int(found.far.sum()), ate, relative, "", cpu)


def simulated(nlos: float) -> None:
    ates, nees, cpus, far, net = [], [], [], [], None
    for seed in SEEDS:
        team = simulate_mixed(MixedWorld(ranges=True, beacons=BEACONS, nlos=nlos, minutes=MINUTES), seed)
        net = network_of(log_of(team))
        found, cpu = timed(net)
        part = found.parts[0]
        ates.append(beside_truth(net, part, {r.name: r.truth for r in team.robots})[0])
        at = np.flatnonzero(net.is_beacon[part.nodes])
        held = LandmarkMap(net.beacons, part.pose[at, :2], part.beacon_cov)
        survey = Survey(tuple(team.landmarks), np.array(list(team.landmarks.values())))
        nees.append(score_landmarks(held, survey).nees_per_dof)
        cpus.append(cpu)
        far.append(int(found.far.sum()))
    name = f"simulated, {nlos:.0%} round something"
    row(name, net, round(np.mean(far)), float(np.mean(ates)), "", f"{np.mean(nees):.2f}", float(np.mean(cpus)))


def main() -> None:
    folder = Path(os.environ["MAPWEAVE_DATA"]) / "uwb"
    scored = "ATE [m] | relative position [m], bearing [deg] | NEES / dof | CPU [s]"
    print(f"| log | robots | beacons | ranges | rejected | {scored} |")
    print("|---|---|---|---|---|---|---|---|---|")
    tiers(folder)
    turtlebots(folder)
    for nlos in (0.0, 0.2):
        simulated(nlos)


if __name__ == "__main__":
    main()
