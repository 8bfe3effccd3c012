"""Small problems the solver tests share: a pose graph with landmarks seen in range and bearing."""

import numpy as np

from mapweave.core import se2
from mapweave.solve import Factor, Problem, wrapping


def pose_landmark_world(rng, poses=8, landmarks=6):
    """A drive around a room: true poses and landmarks, noisy relative poses and range-bearing sightings."""
    step = np.array([1.0, 0.0, 2 * np.pi / poses])
    truth = [se2.pose(0.0, 0.0, 0.0)]
    for _ in range(poses - 1):
        truth.append(se2.compose(truth[-1], step))
    truth = np.array(truth)
    points = rng.uniform(-3, 3, (landmarks, 2)) + truth[:, :2].mean(axis=0)
    i = np.arange(poses)
    j = (i + 1) % poses
    between = se2.compose(se2.between(truth[i], truth[j]), rng.normal(0, [0.05, 0.05, 0.02], (poses, 3)))
    a, b = np.repeat(i, landmarks), np.tile(np.arange(landmarks), poses)
    d = points[b] - truth[a, :2]
    seen = np.stack([np.hypot(*d.T), se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - truth[a, 2])], axis=1)
    seen += rng.normal(0, [0.1, 0.03], seen.shape)
    return truth, points, (i, j, between), (a, b, seen)


def as_problem(truth, points, odometry, sightings, rng, kernel=None, start_noise=0.1):
    n = len(truth)
    i, j, between = odometry
    a, b, seen = sightings
    x0 = np.concatenate([truth.ravel(), points.ravel()])
    x0 = x0 + rng.normal(0, start_noise, len(x0))
    x0[:3] = truth[0]
    angles = 3 * np.arange(n) + 2

    def poses(x):
        return x[: 3 * n].reshape(n, 3)

    def odometry_residual(x):
        r = se2.between(poses(x)[i], poses(x)[j]) - between
        r[:, 2] = se2.wrap_angle(r[:, 2])
        return r

    def odometry_jacobian(x):
        p, q = poses(x)[i], poses(x)[j]
        c, s = np.cos(p[:, 2]), np.sin(p[:, 2])
        d = q[:, :2] - p[:, :2]
        J = np.zeros((len(i), 3, 6))
        J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] = -c, -s, s, -c
        J[:, 0, 2], J[:, 1, 2] = -s * d[:, 0] + c * d[:, 1], -c * d[:, 0] - s * d[:, 1]
        J[:, 2, 2], J[:, 2, 5] = -1, 1
        J[:, 0, 3], J[:, 0, 4], J[:, 1, 3], J[:, 1, 4] = c, s, -s, c
        return J

    def sighting_residual(x):
        p, m = poses(x)[a], x[3 * n :].reshape(-1, 2)[b]
        d = m - p[:, :2]
        angle = se2.wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - p[:, 2] - seen[:, 1])
        return np.stack([np.hypot(d[:, 0], d[:, 1]) - seen[:, 0], angle], axis=1)

    def sighting_jacobian(x):
        p, m = poses(x)[a], x[3 * n :].reshape(-1, 2)[b]
        d = m - p[:, :2]
        r = np.hypot(d[:, 0], d[:, 1])
        J = np.zeros((len(a), 2, 5))
        J[:, 0, 3:], J[:, 0, :2] = d / r[:, None], -d / r[:, None]
        g = np.stack([-d[:, 1], d[:, 0]], axis=1) / (r**2)[:, None]
        J[:, 1, 3:], J[:, 1, :2], J[:, 1, 2] = g, -g, -1
        return J

    fixed = np.zeros(len(x0), dtype=bool)
    fixed[:3] = True
    factors = [
        Factor(
            columns=np.concatenate([3 * i[:, None] + np.arange(3), 3 * j[:, None] + np.arange(3)], axis=1),
            residual=odometry_residual,
            jacobian=odometry_jacobian,
            rows=3,
            sqrt_info=1 / np.array([[0.05, 0.05, 0.02]]),
        ),
        Factor(
            columns=np.concatenate([3 * a[:, None] + np.arange(3), 3 * n + 2 * b[:, None] + np.arange(2)], axis=1),
            residual=sighting_residual,
            jacobian=sighting_jacobian,
            rows=2,
            sqrt_info=1 / np.array([[0.1, 0.03]]),
            kernel=kernel,
        ),
    ]
    return Problem(x0=x0, terms=factors, fixed=fixed, retract=wrapping(angles))
