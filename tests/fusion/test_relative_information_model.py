"""Relative information: a frame does not change it, its Jacobians are right, its noise is the propagated one."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion import relative, relative_information

JACOBIANS = "Jacobians against central differences"


def numeric(f, x, wrap_rows, step=2e-6):
    J = np.zeros((len(f(x)), len(x)))
    for k in range(len(x)):
        d = np.zeros(len(x))
        d[k] = step

        # fourth-order central differences: their own error stays far below 1e-8
        def diff(s, d=d):
            e = f(x + s * d) - f(x - s * d)
            e[wrap_rows] = se2.wrap_angle(e[wrap_rows])
            return e

        J[:, k] = (8 * diff(1.0) - diff(2.0)) / (12 * step)
    return J


@pytest.fixture
def worlds():
    rng = np.random.default_rng(0)
    frame = rng.uniform(-3, 3, (30, 3))
    return frame, rng.uniform(-3, 3, (30, 7, 2))


@pytest.mark.eq("Kojima12:3", "Kojima12:4", "Kojima12:5", "Kojima12:9")
def test_the_map_predicts_what_the_local_map_measures_in_whatever_frame(worlds):
    frame, local = worlds
    moved = np.stack([se2.act(T, p) for T, p in zip(frame, local, strict=True)])
    assert (
        np.abs(
            relative_information.residual(
                relative_information.measure(local), relative_information.predict(frame, moved)
            )
        ).max()
        < 1e-12
    )


@pytest.mark.eq("Kojima12:3")
def test_relative_information_is_written_as_in_the_paper(worlds):
    p = worlds[1][0]
    beta = np.arctan2(*(p[1] - p[0])[::-1])
    wanted = [np.arctan2(*(-p[0])[::-1]) - beta, np.hypot(*p[0]), beta, np.hypot(*(p[1] - p[0]))]
    for q in p[2:]:
        wanted += [np.arctan2(*(q - p[0])[::-1]) - beta, np.hypot(*(q - p[0]))]
    wanted[::2] = se2.wrap_angle(np.array(wanted[::2]))
    assert np.allclose(relative_information.measure(p), wanted, atol=1e-14)


@pytest.mark.eq("Kojima12:5")
def test_jacobians_agree_with_central_differences_below_1e_8(record_property):
    rng = np.random.default_rng(1)
    angles = np.arange(14) % 2 == 0
    for _ in range(20):
        frame, points = rng.uniform(-3, 3, 3), _spread(rng, 7)
        H = relative_information.jacobian(frame, points)
        x = np.concatenate([frame, points.ravel()])
        N = numeric(lambda v: relative_information.predict(v[:3], v[3:].reshape(-1, 2)), x, angles, 1e-4)
        worst = np.abs(H - N).max()
        record_property("asserted", (JACOBIANS, "< 1e-8", float(worst)))
        assert worst < 1e-8


def test_sighting_jacobians_agree_with_central_differences_below_1e_8(record_property):
    rng = np.random.default_rng(2)
    for _ in range(20):
        x = rng.uniform(-2, 2, 12)
        x[6:8] += 6.0
        N = numeric(lambda v: relative.predict(*v.reshape(4, 3)), x, np.array([False, True]), 1e-4)
        worst = np.abs(relative.by_poses(*x.reshape(4, 3)) - N).max()
        record_property("asserted", (JACOBIANS, "< 1e-8", float(worst)))
        assert worst < 1e-8


def test_many_maps_at_once_give_what_each_gives_alone(worlds):
    frame, points = worlds
    H = relative_information.jacobian(frame, points)
    for k in range(len(frame)):
        assert np.array_equal(H[k], relative_information.jacobian(frame[k], points[k]))


@pytest.mark.eq("Kojima12:13", "Kojima12:14")
def test_weights_are_the_propagated_covariance_and_its_reductions():
    rng = np.random.default_rng(3)
    points = _spread(rng, 5)
    A = rng.normal(size=(10, 10)) * 0.01
    P = A @ A.T + 1e-5 * np.eye(10)
    angles = np.arange(10) % 2 == 0
    J = numeric(lambda v: relative_information.measure(v.reshape(-1, 2)), points.ravel(), angles, 1e-4)
    full = relative_information.noise(points, P, "full", delta=3.0)
    assert np.allclose(full, 3.0 * J @ P @ J.T, rtol=1e-6, atol=1e-10)
    assert np.allclose(
        relative_information.noise(points, P, "diagonal"), np.diag(np.diag(J @ P @ J.T)), rtol=1e-6, atol=1e-10
    )
    eq14 = [sum(J[i, j] ** 2 * P[j, j] for j in range(10)) for i in range(10)]
    assert np.allclose(
        relative_information.noise(points, P, "paper", delta=80.0), 80 * np.diag(eq14), rtol=1e-6, atol=1e-10
    )
    assert np.array_equal(relative_information.noise(points, P, "constant", variance=1e-3), 1e-3 * np.eye(10))


def test_the_baseline_is_the_most_certain_pair_with_the_surer_landmark_first():
    mean = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 10.0], [3.0, 0.0]])
    sigma = np.array([0.02, 0.01, 5.0, 0.01])  # the far one is worthless; 0-3 and 1-3 compete
    cov = np.diag(np.repeat(sigma**2, 2))
    quality = {
        (i, j): np.sum((mean[i] - mean[j]) ** 2) / (2 * (sigma[i] ** 2 + sigma[j] ** 2))
        for i in range(4)
        for j in range(i)
    }
    assert set(relative_information.baseline_pair(mean, cov)) == set(max(quality, key=quality.get))
    assert relative_information.baseline_pair(mean, cov, np.array([0, 1])) == (1, 0)


def _spread(rng, n):
    """n points at least 1 m from each other and from every frame origin in use: no derivative blows up."""
    while True:
        p = rng.uniform(-6, 6, (n, 2))
        d = np.linalg.norm(p[:, None] - p[None], axis=-1) + 9 * np.eye(n)
        if d.min() > 1.0 and np.linalg.norm(p[0]) > 5.3:
            return p
