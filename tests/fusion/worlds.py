"""Teams of local maps with known truth: each robot's map is drawn from the very covariance it states."""

from dataclasses import replace

import numpy as np

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.landmarks.landmark_map import LocalMap, Submap


def local_map(robot, ids, mean, cov, **more):
    """A LocalMap from its landmarks alone: the robot still at its first pose."""
    full = np.zeros((3 + 2 * len(ids), 3 + 2 * len(ids)))
    full[:3, :3] = 1e-6 * np.eye(3)
    full[3:, 3:] = cov
    submap = Submap(robot, np.zeros(3), tuple(ids), np.asarray(mean, float).reshape(-1, 2), full, f"local_{robot}")
    track = Track(np.array([0.0]), np.zeros((1, 3)), np.zeros((1, 3, 3)), f"local_{robot}")
    return LocalMap(robot, submap, track, dict.fromkeys(ids, 1), **more)


def covariance(rng, points, sigma=(0.01, 0.05), heading=0.01):
    """What a filter leaves: a part of each landmark's own, a shared drift in heading and place, some correlation."""
    n = len(points)
    own = np.repeat(np.exp(rng.uniform(*np.log(sigma), n)), 2)
    mixed = rng.normal(size=(2 * n, 3)) * np.median(own) * 0.5
    turn = heading * np.stack([-points[:, 1], points[:, 0]], axis=1).ravel()
    return np.diag(own**2) + mixed @ mixed.T + np.outer(turn, turn)


def team(rng, robots=4, landmarks=15, seen=11, size=10.0, sigma=(0.01, 0.05), scale_sigma=0.0, truth=None):
    """Maps of `seen` landmarks each, and the truth in the frame of robot 1: points, frames, scales."""
    points = rng.uniform(-size / 2, size / 2, (landmarks, 2)) if truth is None else truth
    frames = np.column_stack([rng.uniform(-size / 2, size / 2, (robots, 2)), rng.uniform(-np.pi, np.pi, robots)])
    scales = 1 + scale_sigma * rng.normal(size=robots)
    maps = []
    for k in range(robots):
        which = np.sort(rng.choice(len(points), min(seen, len(points)), replace=False))
        local = se2.act(se2.inverse(frames[k]), points[which])
        P = covariance(rng, local, sigma)
        z = scales[k] * local + (np.linalg.cholesky(P) @ rng.normal(size=2 * len(which))).reshape(-1, 2)
        maps.append(local_map(f"robot{k + 1}", [str(100 + i) for i in which], z, P))
    T = se2.inverse(frames[0])
    return maps, se2.act(T, points), se2.compose(T, frames), scales


def with_landmarks(m, ids=None, mean=None, cov=None):
    """`m` with its landmarks' labels, places or covariance replaced."""
    submap = m.submap
    full = np.array(submap.cov)
    if cov is not None:
        full[3:, 3:] = cov
    new = Submap(
        submap.robot,
        submap.pose,
        submap.ids if ids is None else tuple(ids),
        submap.mean if mean is None else mean,
        full,
        submap.frame,
    )
    return replace(m, submap=new)


def true_points(component, points):
    return np.array([points[int(name) - 100] for name in component.map.ids])


def nees(component, points):
    """e^T P^-1 e of the landmarks and its degrees of freedom, in the frame that truth is given in."""
    e = (component.map.mean - true_points(component, points)).ravel()
    return float(e @ np.linalg.solve(component.map.cov, e)), len(e)


def rmse(component, points):
    e = component.map.mean - true_points(component, points)
    return float(np.sqrt(np.mean(np.sum(e**2, axis=1))))
