"""The paper's two theorems about the covariance of repeated least squares, as printed and as they are true."""

import numpy as np
import pytest

from mapweave.fusion.relative_information import RelativeLayout, measurement
from mapweave.papers.kojima import rls
from mapweave.papers.kojima.experiments import KojimaConfig, draw_worlds, run_filters, settling

INFORMATION = np.array([1e-5] * 3 + [1e3] * 16)  # the paper's initial covariance, inverted


def stationary(seed, n=5, total=8, delta=1.0):
    """A second robot's map of n of `total` landmarks, the state it is seen at and the layout."""
    rng = np.random.default_rng(seed)
    layout = RelativeLayout(2, total)
    points = rng.uniform(-1, 1, (n, 2)) + np.array([3.0, 0.0])
    A = rng.normal(size=(2 * n, 2 * n)) * 0.01
    told = measurement(1, np.arange(n), points, A @ A.T + 1e-4 * np.eye(2 * n), "paper", delta=delta)
    x = np.concatenate([np.zeros(3), points.ravel(), rng.uniform(-1, 1, 2 * (total - n))])
    return layout, told, x


def repeat_stationary(layout, prior, m, repeats):
    """Dense least squares, the same measurement every time with H held at the prior's mean, as the theorems assume."""
    e, H = m.linearise(layout, prior.x)[0], m.dense_jacobian(layout, prior.x)
    x, P = prior
    for _ in range(repeats):
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + m.R)
        x = x + K @ (e - H @ (x - prior.x))
        A = np.eye(len(x)) - K @ H
        P = A @ P @ A.T + K @ m.R @ K.T
    return rls.Estimate(x, P)


@pytest.mark.eq("Kojima12:10", "Kojima12:11", "Kojima12:12", "Kojima12:19", "Kojima12:8")
@pytest.mark.parametrize("seed", range(5))
def test_theorem_1_the_determinant_falls_strictly_with_every_update(seed, record_property):
    layout, told, x = stationary(seed)
    estimate = rls.Estimate(x, np.diag(1 / INFORMATION))
    logdet = [np.linalg.slogdet(estimate.P)[1]]
    for _ in range(60):
        estimate = rls.update(layout, estimate, told)
        sign, value = np.linalg.slogdet(estimate.P)
        assert sign > 0
        logdet.append(value)
    said = r"$\log\lvert P_k\rvert$, change at an update"
    record_property("asserted", (said, "< 0", float(np.diff(logdet).max())))
    assert (np.diff(logdet) < 0).all()


@pytest.mark.eq("Kojima12:15", "Kojima12:17", "Kojima12:28")
@pytest.mark.parametrize("seed", range(5))
def test_log_det_falls_with_log_k_at_the_rank_of_h(seed, record_property):
    layout, told, x = stationary(seed)
    H = told.dense_jacobian(layout, x)
    k = np.array([1e6, 1e7])
    logdet = [np.linalg.slogdet(rls.after(np.diag(INFORMATION), H, told.R, at))[1] for at in k]
    slope = np.diff(logdet)[0] / np.diff(np.log(k))[0]
    assert np.linalg.matrix_rank(H) == 10
    said = r"slope of $\log\lvert P_k\rvert$ in $\log k$, off $-\operatorname{rank} H$"
    record_property("asserted", (said, "< 0.01", float(abs(slope + 10))))
    assert abs(slope + 10) < 0.01


@pytest.mark.eq("Kojima12:12", "Kojima12:28")
def test_k_updates_in_joseph_form_are_k_times_the_information():
    layout, told, x = stationary(7)
    H = told.dense_jacobian(layout, x)
    information = np.diag(np.r_[np.full(3, 1.0), np.full(16, 1e3)])
    estimate = repeat_stationary(layout, rls.Estimate(x, np.linalg.inv(information)), told, 100)
    wanted = rls.after(information, H, told.R, 100.0)
    assert np.abs(estimate.P - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.eq("Kojima12:23")
@pytest.mark.parametrize("seed", range(5))
def test_theorem_2_corrected_k_times_the_error_is_constant_within_1_percent(seed, record_property):
    layout, told, x = stationary(seed)
    H = told.dense_jacobian(layout, x)
    information = np.diag(np.r_[np.full(3, 1.0), np.full(16, 10.0)])
    P_inf = rls.limit(information, H)
    k = [100.0, 300.0, 1000.0, 3000.0, 10000.0]
    scaled = np.array([at * np.linalg.norm(rls.after(information, H, told.R, at) - P_inf) for at in k])
    said = r"$k \lVert P_k - P_\infty\rVert$ for k = 100 .. 10,000: spread over mean"
    record_property("asserted", (said, "< 0.01", float(np.ptp(scaled) / scaled.mean())))
    assert np.ptp(scaled) < 0.01 * scaled.mean()
    assert np.linalg.matrix_rank(P_inf, tol=1e-9) == layout.size - 10


@pytest.mark.eq("Kojima12:23")
def test_under_the_papers_own_prior_the_error_falls_as_1_over_k_at_once_and_with_delta_80_only_later():
    cfg = KojimaConfig()
    worlds = draw_worlds(10, np.random.default_rng(11))
    local = next(run_filters(cfg, worlds, np.random.default_rng(12)))
    x = np.concatenate([worlds.start[:, 1], worlds.landmarks.reshape(10, -1)], axis=1)
    by = {(t.maps, t.delta): t for t in settling(cfg, local, x, np.random.default_rng(13))}
    assert by["the experiment's", 1.0].early.max() < 0.01
    assert 0.005 < by["the experiment's", 80.0].early.max() < 0.04
    assert np.median(by["less certain", 80.0].early) > 0.05
    assert np.median(by["less certain", 80.0].late) < 0.05
    assert 0 < by["the experiment's", 80.0].left.max() < 0.03


@pytest.mark.eq("Kojima12:22", "Kojima12:24", "Kojima12:25", "Kojima12:26", "Kojima12:27")
@pytest.mark.parametrize("seed", range(5))
def test_the_printed_limit_is_exact_when_the_map_holds_every_landmark_and_wrong_otherwise(seed, record_property):
    for total, exact in ((5, True), (8, False)):
        layout, told, x = stationary(seed, total=total)
        H = told.dense_jacobian(layout, x)
        information = np.diag(np.r_[np.full(3, 1.0), np.full(2 * total, 1e3)])
        printed = rls.printed_limit(information[:3, :3], information[3:, 3:], H[:, :3], H[:, 3:])
        true = rls.limit(information, H)
        error = np.abs(printed - true).max() / np.abs(true).max()
        said, least = ("$N = n$", "< 1e-9") if exact else ("$N > n$", "> 1e-3")
        record_property("asserted", (f"eq. 24-27 against the limit, {said}, relative", least, float(error)))
        assert error < 1e-9 if exact else error > 1e-3


def test_repeating_one_stationary_measurement_k_times_is_overconfident_by_k_and_delta_k_undoes_it():
    layout, told, x = stationary(3)
    rng = np.random.default_rng(0)
    start = rls.Estimate(x + 1e-3 * rng.normal(size=layout.size), np.diag(np.r_[np.full(3, 1e2), np.full(16, 1.0)]))
    once = repeat_stationary(layout, start, told, 1)
    cautious = stationary(3, delta=50.0)[1]
    undone = repeat_stationary(layout, start, cautious, 50)
    assert np.abs(undone.x - once.x).max() < 1e-10
    assert np.abs(undone.P - once.P).max() < 1e-10
    many = repeat_stationary(layout, start, told, 50)
    gained_once, gained_many = (np.linalg.inv(e.P) - np.linalg.inv(start.P) for e in (once, many))
    assert np.abs(gained_many - 50 * gained_once).max() < 1e-6 * np.abs(gained_many).max()


def test_many_worlds_updated_at_once_are_the_same_as_one_by_one():
    told, states = [], []
    for seed in range(4):
        layout, m, x = stationary(seed)
        told.append(m)
        states.append(x)
    whole = measurement(
        1, told[0].landmarks, np.stack([s[3:13].reshape(5, 2) for s in states]), np.tile(1e-4 * np.eye(10), (4, 1, 1))
    )
    P = np.tile(np.diag(1 / INFORMATION), (4, 1, 1))
    batch = rls.repeat(layout, rls.Estimate(np.stack(states), P), [whole], 3)
    for k in range(4):
        one = measurement(1, told[0].landmarks, states[k][3:13].reshape(5, 2), 1e-4 * np.eye(10))
        alone = rls.repeat(layout, rls.Estimate(states[k], P[k]), [one], 3)
        assert np.allclose(batch.x[k], alone.x, atol=1e-10)
        assert np.allclose(batch.P[k], alone.P, rtol=1e-6, atol=1e-10)
