"""Robots that move: positions over time, with a covariance that is honest, from files and from tables."""

import csv
import json

import numpy as np
import pytest

import mapweave
from mapweave.cli import _run
from mapweave.core import se2
from mapweave.core.errors import DataError
from mapweave.core.records import Odometry
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm import posterior
from mapweave.swarm.moving.poses import odometry_factor, odometry_steps, sighting_factor, velocity_factor
from mapweave.swarm.moving.result import TrackConfig
from mapweave.swarm.moving.smooth import filtered, smooth, smooth_driving
from mapweave.swarm.start import relative_odometry_frame

from ..differences import assert_derivative

DRIVING = TrackConfig(slip_floor=0.02, slip=0.05, turn_floor=0.02, turn=0.05)


def made(seed, **more):
    swarm = simulate_swarm(SwarmScene(sigma=np.deg2rad(1.0), **more), np.random.default_rng(seed))
    return swarm, {c: swarm.position[0][c] for c in swarm.corners}


def odometry_of(swarm):
    return {
        k: Odometry(swarm.t, swarm.odometry[:, k, 0], swarm.odometry[:, k, 1])
        for k in range(len(swarm.table.ids))
        if k not in swarm.corners
    }


def scored(swarm, track):
    """RMSE [m] and mean NEES a degree of freedom over all positions of robots that move."""
    errors, values = [], []
    for k, one in track.tracks.items():
        if k in swarm.corners:
            continue
        e = one.position - swarm.position[np.searchsorted(swarm.t, one.t - 1e-6), k]
        errors.append(e)
        values.append(np.einsum("ka,ka->k", e, np.linalg.solve(one.cov, e[..., None])[..., 0]))
    e = np.concatenate(errors)
    return float(np.sqrt(np.mean(np.sum(e * e, axis=1)))), float(np.concatenate(values).mean() / e.shape[1])


@pytest.mark.parametrize(("dim", "robots"), [(2, 16), (3, 18)])
def test_smoothing_moving_robots_has_an_honest_covariance(dim, robots):
    found = []
    for seed in range(12):
        swarm, known = made(seed, robots=robots, dim=dim, steps=20)
        track = smooth(swarm.table, known)
        assert track.converged
        assert track.chi2 / track.dof == pytest.approx(1.0, abs=0.12)
        found.append(scored(swarm, track))
    assert np.median([rmse for rmse, _ in found]) < 0.2
    assert np.mean([nees for _, nees in found]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize(("dim", "robots"), [(2, 16), (3, 18)])
def test_filtering_moving_robots_has_an_honest_covariance_and_smoothing_is_no_worse(dim, robots):
    filters, smoothers = [], []
    for seed in range(12):
        swarm, known = made(seed, robots=robots, dim=dim, steps=15)
        track = filtered(swarm.table, known)
        assert track.chi2 / track.dof == pytest.approx(1.0, abs=0.12)
        filters.append(scored(swarm, track))
        smoothers.append(scored(swarm, smooth(swarm.table, known))[0])
    assert np.mean([nees for _, nees in filters]) == pytest.approx(1.0, abs=0.12)
    assert np.median(smoothers) < np.median([rmse for rmse, _ in filters])


def test_the_filter_never_looks_ahead():
    swarm, known = made(0, robots=9, steps=12)
    whole = filtered(swarm.table, known)
    part = filtered(swarm.table.rows(swarm.table.t < 8.0), known)
    for k, one in part.tracks.items():
        assert np.array_equal(one.position, whole.tracks[k].position[: len(one.t)])


def test_a_filter_of_too_few_instants_is_refused():
    swarm, known = made(0, robots=9, steps=3)
    with pytest.raises(DataError, match="more than 3 instants"):
        filtered(swarm.table, known)


def test_smoothing_beats_each_instant_by_itself():
    swarm, known = made(1, robots=16, steps=20)
    rmse, _ = scored(swarm, smooth(swarm.table, known))
    errors = []
    for k, t in enumerate(swarm.t):
        rows = swarm.table.rows(swarm.table.t == t)
        alone = mapweave.locate(type(rows)(rows.ids, rows.observer, rows.target, rows.direction, rows.sigma),
                                anchors={rows.ids[c]: p for c, p in known.items()})  # fmt: skip
        free = ~alone.estimate.anchor & alone.estimate.localisable
        errors.append((alone.estimate.position - swarm.position[k])[free])
    assert rmse < 0.8 * np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)))


@pytest.mark.parametrize("axis", [True, False])
def test_driving_robots_are_found_from_bearings_and_odometry_without_a_guess(axis):
    found = []
    for seed in range(4):
        swarm, known = made(seed, robots=9, steps=40, drive=True, axis=axis)
        track = smooth_driving(swarm.table, odometry_of(swarm), known, DRIVING)
        assert track.converged
        assert track.gauge == ""
        found.append(scored(swarm, track))
    assert max(rmse for rmse, _ in found) < 0.2
    # Odometry is modelled with some slip to the side that the simulated robots have not: errors are never larger.
    assert 0.5 < np.mean([nees for _, nees in found]) < 1.1


def test_driving_robots_without_axis_and_anchors_are_found_up_to_a_frame():
    swarm, _ = made(0, robots=9, steps=40, drive=True, axis=False)
    track = smooth_driving(swarm.table, odometry_of(swarm), {}, DRIVING)
    assert "first pose of robot" in track.gauge
    p = np.concatenate([one.position for one in track.tracks.values() if len(one.t) > 1])
    q = np.concatenate(
        [swarm.position[np.searchsorted(swarm.t, one.t - 1e-6), k] for k, one in track.tracks.items() if len(one.t) > 1]
    )
    assert np.sqrt(np.mean(np.sum((se2.act(se2.align(p, q), p) - q) ** 2, axis=1))) < 0.3


def test_gross_outliers_are_left_out_when_asked_for():
    swarm, known = made(0, robots=16, steps=15, outliers=0.05)
    plain, robust = smooth(swarm.table, known), smooth(swarm.table, known, TrackConfig(kernel=2.0))
    assert scored(swarm, robust)[0] < 0.3 * scored(swarm, plain)[0]
    assert np.mean(robust.outlier) == pytest.approx(0.05, abs=0.02)
    assert robust.chi2 / robust.dof < 1.2


@pytest.mark.slow
def test_moving_robots_are_judged_as_standing_ones_are(monkeypatch):
    swarm, known = made(0, robots=9, steps=5, outliers=0.05)
    anchors = {swarm.table.ids[k]: p for k, p in known.items()}
    usual = mapweave.locate(swarm.table, anchors=anchors, method="robust")
    assert usual.reliable, usual.warnings
    monkeypatch.setattr(posterior, "TOO_MANY", 0.02)
    strict = mapweave.locate(swarm.table, anchors=anchors, method="robust")
    assert not strict.reliable
    assert any("too many" in text for text in strict.warnings)
    assert np.array_equal(strict.track.tracks[5].position, usual.track.tracks[5].position)
    monkeypatch.setattr(posterior, "TOO_MANY", 0.25)
    monkeypatch.setattr(posterior, "VERDICT_DOUBT", 0.9999)
    assert not mapweave.locate(swarm.table, anchors=anchors, method="robust").reliable


def test_one_anchor_does_not_hold_the_scale_of_moving_robots():
    swarm, known = made(0, robots=9, steps=5)
    with pytest.raises(DataError, match="two anchors"):
        smooth(swarm.table, dict(list(known.items())[:1]))


def test_two_odometry_frames_meet_from_bearings_alone():
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 1.0, 30)
    a = np.column_stack([4 * t, np.sin(3 * t), np.cos(3 * t)])
    b = np.column_stack([2 - 3 * t, 5 + t * t, 1 + 2 * t])
    T = np.array([1.0, -2.0, 2.3])  # robot b's frame in a's
    own_b = se2.compose(se2.inverse(T), b)
    by_a = rng.random(30) < 0.5
    d = np.where(by_a[:, None], b[:, :2] - a[:, :2], a[:, :2] - b[:, :2])
    heading = np.where(by_a, a[:, 2], b[:, 2])
    bearing = np.arctan2(d[:, 1], d[:, 0]) - heading + 0.002 * rng.standard_normal(30)
    found, error = relative_odometry_frame(a, own_b, bearing, by_a)
    assert found == pytest.approx(T, abs=0.05)
    assert error < 1e-4


def test_odometry_between_instants_follows_arcs_and_scales():
    rows = Odometry(np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.array([0.0, np.pi / 2]))
    said = odometry_steps(rows, np.array([0.0, 0.5, 1.0, 2.0]), TrackConfig())
    assert said.delta[0] == pytest.approx([0.5, 0.0, 0.0])
    assert said.delta[2] == pytest.approx([4 / np.pi, 4 / np.pi, np.pi / 2])  # a quarter turn of radius 4 / pi
    assert said.slope[0, 0, 0] == pytest.approx(0.5)
    assert said.slope[2, 2, 1] == pytest.approx(np.pi / 2, rel=1e-6)


def test_every_jacobian_equals_finite_differences():
    rng = np.random.default_rng(0)
    x = rng.normal(size=8)
    at = np.arange(8)[None, :]
    for factor in (
        velocity_factor(at, np.array([0.7]), 0.02),
        odometry_factor(at, rng.normal(size=(1, 3)), rng.normal(size=(1, 3, 2)), np.ones((1, 3))),
        sighting_factor(np.arange(5)[None, :], np.array([[0.6, 0.8]]), np.ones(1)),
    ):
        assert_derivative(factor, x)


# Through the files.


def simulated(tmp_path, *words):
    path = tmp_path / "s.csv"
    assert _run(["simulate", "swarm", "--out", str(path), "--robots", "9", "--sigma", "1deg", *words]) == 0
    truth = list(csv.DictReader((tmp_path / "s.truth.csv").open()))
    corners = [row for row in truth if row["id"] in {"1", "3", "7", "9"} and float(row.get("t", 0)) == 0.0]
    return path, [w for row in corners for w in ("--anchor", f"{row['id']}={row['x']},{row['y']}")]


def located(tmp_path, path, *words):
    out = tmp_path / "out"
    code = _run(["locate", str(path), "--out", str(out), "--truth", str(tmp_path / "s.truth.csv"), *words])
    return code, json.loads((out / "metrics.json").read_text()) if out.exists() else None


def test_stamped_sightings_give_trajectories_over_time(tmp_path, capsys):
    path, known = simulated(tmp_path, "--steps", "15")
    code, metrics = located(tmp_path, path, *known)
    assert code == 0
    assert metrics["moving"] is True
    assert metrics["reliable"] is True
    assert metrics["rmse"] < 0.3
    rows = list(csv.DictReader((tmp_path / "out" / "trajectories" / "5.csv").open()))
    assert list(rows[0]) == ["t", "x", "y", "var_x", "cov_xy", "var_y"]
    assert len(rows) == 15
    assert (tmp_path / "out" / "figures" / "tracks.png").is_file()
    capsys.readouterr()
    assert _run(["evaluate", str(tmp_path / "out"), "--truth", str(tmp_path / "s.truth.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rmse"] == pytest.approx(metrics["rmse"], rel=1e-4)


def test_the_filter_can_be_asked_for(tmp_path):
    path, known = simulated(tmp_path, "--steps", "12")
    code, metrics = located(tmp_path, path, *known, "--filtered")
    assert code == 0
    assert metrics["reliable"] is True
    assert len((tmp_path / "out" / "trajectories" / "5.csv").read_text().splitlines()) == 10


def test_driving_robots_are_located_with_their_odometry_file(tmp_path):
    path, known = simulated(tmp_path, "--steps", "25", "--drive", "--no-axis")
    code, metrics = located(tmp_path, path, *known, "--odometry", str(tmp_path / "s.odometry.csv"))
    assert code == 0
    assert metrics["axis"] is False
    assert metrics["rmse"] < 0.3


def test_robots_that_drive_without_axis_and_odometry_are_refused_with_the_way_out(tmp_path, capsys):
    path, known = simulated(tmp_path, "--steps", "25", "--drive", "--no-axis")
    code, metrics = located(tmp_path, path, *known)
    assert (code, metrics) == (1, None)
    assert "--odometry" in capsys.readouterr().err


def test_stamped_robots_that_stand_still_get_one_position(tmp_path):
    swarm, _ = made(0, robots=9)
    rows = ["observer,target,bearing,sigma,t"]
    rng = np.random.default_rng(0)
    for t in range(5):
        for a, b in zip(swarm.table.observer, swarm.table.target, strict=True):
            d = swarm.position[0][b] - swarm.position[0][a]
            rows.append(f"{a + 1},{b + 1},{np.arctan2(d[1], d[0]) + 0.01 * rng.normal()},0.01,{t}")
    path = tmp_path / "s.csv"
    path.write_text("\n".join(rows) + "\n")
    p = swarm.position[0]
    found = mapweave.locate(path, tmp_path / "out", anchors={"1": p[0], "9": p[8]})
    assert found.metrics["moving"] is False
    assert (tmp_path / "out" / "trajectories" / "5.csv").is_file()
    assert found.estimate.position[4] == pytest.approx(p[4], abs=0.3)
