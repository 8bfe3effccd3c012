"""Robots in space, each with axes of its own: attitudes and places together, and what is free or not told named."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core.attitude import about, angles, headings, matrices, nearest, turned
from mapweave.core.bearings import BearingTable
from mapweave.core.errors import DataError
from mapweave.evaluation.swarm import similarity
from mapweave.sim.swarm import SwarmScene, simulate_swarm
from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork, Distance
from mapweave.swarm.robust import unsupported
from mapweave.swarm.start import mutual_headings, relative_turns

from .swarms import as_network, score, simulated

RNG = np.random.default_rng(3)


def standing(places, anchors=(), distances=(), pairs=None, sigma=0.2, seed=0):
    """Robots at `places` that see those of `pairs` (all when None) in axes of their own; sigma in degrees."""
    rng = np.random.default_rng(seed)
    n = len(places)
    i, j = np.nonzero(~np.eye(n, dtype=bool)) if pairs is None else np.array(pairs).T
    R = matrices(rng.uniform(-2, 2, (n, 3)))
    d = places[j] - places[i]
    u = d / np.linalg.norm(d, axis=1, keepdims=True) + np.radians(sigma) * rng.normal(size=(len(i), 3))
    own = np.einsum("mji,mj->mi", R[i], u / np.linalg.norm(u, axis=1, keepdims=True))
    known = {k: places[k] for k in anchors}
    return BearingNetwork(
        tuple(map(str, range(n))), 3, i, j, own, np.full(len(i), np.radians(sigma)), known, distances, axis=False
    )


def test_turns_are_rotations_and_come_back_as_they_went():
    for heading in (RNG.uniform(-3, 3, 6), RNG.uniform(-1.7, 1.7, (6, 3))):
        R = matrices(heading)
        np.testing.assert_allclose(headings(R), heading, atol=1e-12)
        np.testing.assert_allclose(matrices(turned(heading, 0.3 * heading)), matrices(0.3 * heading) @ R, atol=1e-12)
        np.testing.assert_allclose(nearest(2.0 * R), R, atol=1e-12)
        size = np.abs(heading) if heading.ndim == 1 else np.linalg.norm(heading, axis=1)
        np.testing.assert_allclose(angles(R, np.broadcast_to(np.eye(R.shape[1]), R.shape)), size, atol=1e-7)
    assert np.linalg.det(nearest(-np.eye(3)[None]))[0] == pytest.approx(1.0)
    axis = np.array([[0.6], [0.0], [0.8]])
    np.testing.assert_allclose(about(matrices(0.7 * axis.T)[0], axis), matrices(0.7 * axis.T)[0], atol=1e-12)


def test_who_sees_each_other_and_a_third_knows_how_the_other_is_turned():
    swarm = simulate_swarm(SwarmScene(robots=27, dim=3, axis=False, sigma=0.0), np.random.default_rng(1))
    net, R = as_network(swarm.table, swarm.position[0], ()), matrices(swarm.heading[0])
    i, j, between, variance = relative_turns(net)
    np.testing.assert_allclose(between, R[i].swapaxes(1, 2) @ R[j], atol=1e-7)
    assert (variance < 0.1).all()
    found, known = mutual_headings(net)
    off = matrices(found[known]) @ R[known].swapaxes(1, 2)
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), atol=1e-6)


def test_wrong_sightings_do_not_turn_the_start():
    swarm = simulate_swarm(
        SwarmScene(robots=64, dim=3, axis=False, outliers=0.1, visibility="mutual"), np.random.default_rng(2)
    )
    found, known = mutual_headings(as_network(swarm.table, swarm.position[0], ()))
    off = matrices(found[known]) @ matrices(swarm.heading[0][known]).swapaxes(1, 2)
    common = nearest(off.sum(axis=0)[None])
    assert np.degrees(np.median(angles(off, np.broadcast_to(common, off.shape)))) < 3.0


@pytest.mark.parametrize(
    ("anchors", "measured", "free"),
    [((), False, 7), ((), True, 6), ((0,), False, 4), ((0,), True, 3), ((0, 26), False, 1)],
)
def test_what_is_free_in_space_is_counted_and_named_and_the_shape_is_right(anchors, measured, free):
    net, truth = simulated(3, robots=27, dim=3, axis=False, anchors=anchors)
    net = replace(net, distances=(Distance(2, 20, float(np.linalg.norm(truth[2] - truth[20]))),) if measured else ())
    estimate = locate(net)
    assert estimate.null_space == free
    assert estimate.localisable.all()
    assert estimate.reliable
    words = {"place free": not anchors, "scale free": free in {4, 7}, "turn about the line": free == 1}
    assert {word: word in estimate.gauge for word in words} == words
    assert ("orientation free" in estimate.gauge) == (free > 1)
    s, R, t = similarity(estimate.position, truth, scale=free in {4, 7}, turn=True)
    assert np.linalg.norm(s * estimate.position @ R.T + t - truth, axis=1).max() < 1.0
    for k in anchors:
        np.testing.assert_array_equal(estimate.position[k], truth[k])
    assert (np.einsum("nkk->nk", estimate.cov)[~estimate.anchor] > 0).all()


@pytest.mark.parametrize("visibility", ["directed", "mutual"])
def test_three_anchors_leave_nothing_free_and_errors_are_as_large_as_said(visibility):
    ratios, nees = [], []
    for seed in range(6):
        net, truth = simulated(seed, robots=27, dim=3, axis=False, visibility=visibility)
        estimate = locate(net)
        assert estimate.gauge == ""
        rmse, bound, one = score(estimate, truth)
        ratios.append(rmse / bound)
        nees.append(one)
        assert estimate.heading_var.shape == (27, 3)
    assert 0.8 < np.mean(ratios) < 1.2
    assert 0.85 < np.mean(nees) < 1.15


def test_one_anchor_and_one_distance_leave_a_turn_in_the_plane():
    net, truth = simulated(3, robots=49, axis=False, anchors=(0,))
    net = replace(net, distances=(Distance(0, 48, float(np.linalg.norm(truth[48] - truth[0]))),))
    estimate = locate(net)
    assert estimate.localisable.all()
    assert estimate.null_space == 1
    assert estimate.gauge == "orientation free (the located robots' mean heading is set to 0)"
    np.testing.assert_array_equal(estimate.position[0], truth[0])
    _, R, t = similarity(estimate.position, truth, scale=False, turn=True)
    assert np.linalg.norm(estimate.position @ R.T + t - truth, axis=1).max() < 1.5


@pytest.mark.parametrize("seed", [1, 7])
def test_wrong_sightings_are_found_in_space_without_axes(seed):
    net, truth = simulated(seed, robots=64, dim=3, axis=False, outliers=0.1)
    estimate = locate(net, SwarmConfig(method="robust"))
    swarm = simulate_swarm(
        SwarmScene(robots=64, dim=3, axis=False, outliers=0.1, sigma=np.radians(0.5)), np.random.default_rng(seed)
    )
    d = truth[net.target] - truth[net.observer]
    seen = np.einsum("mij,mj->mi", matrices(swarm.heading[0])[net.observer], net.direction)
    wrong = np.einsum("mk,mk->m", seen, d / np.linalg.norm(d, axis=1, keepdims=True)) < np.cos(np.radians(4.0))
    assert wrong.sum() > 20
    assert (wrong & ~estimate.outlier).sum() <= 1
    assert (estimate.outlier & ~wrong).sum() < 10
    rmse, bound, nees = score(estimate, truth)
    assert rmse < 1.4 * bound
    assert 0.8 < nees < 1.25


def test_robots_in_one_plane_are_located_and_those_on_a_line_are_told():
    flat = np.column_stack([RNG.uniform(-10, 10, (9, 2)), np.zeros(9)])
    estimate = locate(standing(flat, anchors=(0, 1, 2)))
    assert estimate.localisable.all()
    assert np.linalg.norm(estimate.position - flat, axis=1).max() < 0.5
    line = np.arange(8.0)[:, None] * np.array([1.0, 2.0, 0.5])
    with pytest.raises(DataError, match="third one off their line"):
        locate(standing(line, anchors=(0, 7)))


EVERYONE = [(i, j) for i in range(6) for j in range(6) if i != j]  # but robot 6


def seeing(seen, seed=1000, by=()):
    """Six robots that see each other, three of them known, and a seventh that sees `seen` and is seen `by` some."""
    places = np.random.default_rng(seed).uniform(-10, 10, (7, 3))
    pairs = [*EVERYONE, *((6, k) for k in seen), *((k, 6) for k in by)]
    return standing(places, anchors=(0, 1, 2), pairs=pairs), places


@pytest.mark.parametrize(("method", "seed"), [("batch", 1000), ("batch", 1001), ("robust", 1000)])
def test_a_robot_that_sees_three_stands_at_one_of_the_answers_and_all_are_told(method, seed):
    net, places = seeing((0, 1, 2), seed)
    found = locate(net, SwarmConfig(method=method))
    assert found.localisable.all()
    assert not found.reliable
    assert len(found.others) == 1
    off = [np.linalg.norm(p - places, axis=1) for p in (found.position, found.others[0].position)]
    assert min(o[6] for o in off) < 0.5
    assert max(o[6] for o in off) > 10.0
    assert max(o[:6].max() for o in off) < 0.5
    assert found.others[0].chi2 == pytest.approx(found.chi2, abs=0.1)
    assert "another answer fits the sightings about as well" in found.warnings[0]
    assert ": 6 (" in found.warnings[0]


def test_one_more_sighting_leaves_one_answer_and_a_chi_square_far_larger_is_none():
    for net, places in (seeing((0, 1, 2, 3)), seeing((0, 1, 2), by=(0,))):
        found = locate(net)
        assert found.others == ()
        assert found.reliable
        assert np.linalg.norm(found.position - places, axis=1).max() < 0.5


@pytest.mark.parametrize("seed", [1000, 1001, 1002, 1005])
def test_a_robot_that_one_of_several_answers_would_place_off_its_other_ray_decides(seed):
    places = np.random.default_rng(seed).uniform(-10, 10, (8, 3))
    pairs = [*EVERYONE, (6, 0), (6, 1), (6, 2), (6, 7), (0, 7)]  # robot 7 stands where 6 and 0 look
    found = locate(standing(places, anchors=(0, 1, 2), pairs=pairs))
    assert found.localisable.all()
    assert found.reliable
    assert np.linalg.norm(found.position - places, axis=1).max() < 1.0


def test_where_one_of_four_sightings_is_called_wrong_the_others_only_just_place_and_turn_a_robot():
    net, _ = seeing((0, 1, 2, 3, 4))
    four = net.select(~((net.observer == 6) & (net.target == 4)))
    for swarm, named in ((net, []), (four, [6])):
        wrong = (swarm.observer == 6) & (swarm.target == 3)
        assert unsupported(swarm, wrong).tolist() == named


def test_of_answers_the_best_is_given_whatever_the_start():
    net, places = seeing((0, 1, 2, 3))
    three = net.select(~((net.observer == 6) & (net.target == 3)))
    away = next(
        one.position for one in (locate(three), *locate(three).others) if abs(one.position - places)[6].max() > 5
    )
    found = locate(net, initial=away)
    assert np.linalg.norm(found.position - places, axis=1).max() < 0.5


@pytest.mark.parametrize("relief", [0.0, 0.5])
def test_robots_in_a_plane_have_no_mirror_image_for_what_each_sees_tells_left_from_right(relief):
    rng = np.random.default_rng(5)
    flat = np.column_stack([rng.uniform(-10, 10, (9, 2)), relief * rng.normal(size=9)])
    flat[:3, 2] = 0.0
    net = standing(flat, anchors=(0, 1, 2))
    found, over = locate(net), locate(net, initial=flat * [1.0, 1.0, -1.0])
    assert found.others == over.others == ()
    assert over.chi2 == pytest.approx(found.chi2, abs=0.01)
    np.testing.assert_allclose(over.position, found.position, atol=1e-2)


def test_other_answers_are_written_beside_the_positions(tmp_path):
    net, _ = seeing((0, 1, 2))
    table = BearingTable(net.ids, net.observer, net.target, net.direction, net.sigma, None, axis=False)
    known = {net.ids[k]: p for k, p in net.anchors.items()}
    result = mapweave.locate(table, tmp_path / "out", anchors=known, axis=False)
    lines = (tmp_path / "out" / "others.csv").read_text().splitlines()
    assert lines[0] == "answer,chi2,id,x,y,z,rx,ry,rz"
    assert len(lines) == 8
    last = lines[-1].split(",")
    assert last[0] == "2"
    assert last[2] == "6"
    np.testing.assert_allclose([float(v) for v in last[3:6]], result.estimate.others[0].position[6], rtol=1e-6)
    assert result.metrics["others"] == 1
    alone, _ = seeing((0, 1, 2, 3))
    table = BearingTable(alone.ids, alone.observer, alone.target, alone.direction, alone.sigma, None, axis=False)
    mapweave.locate(table, tmp_path / "out", anchors=known, axis=False)
    assert not (tmp_path / "out" / "others.csv").exists()


def test_a_robot_that_sees_others_on_one_line_has_its_place_and_the_missing_turn_is_told():
    places = np.vstack([RNG.uniform(-10, 10, (6, 3)), [[2.0, 1.0, 0.0]]])
    pairs = [(i, j) for i in range(6) for j in range(7) if i != j]
    seer = standing(places, anchors=(0, 1, 2), pairs=[*pairs, (6, 3)])
    estimate = locate(seer)
    assert estimate.localisable.all()
    assert np.linalg.norm(estimate.position[6] - places[6]) < 0.3
    assert np.flatnonzero(estimate.outlier).tolist() == [len(pairs)]  # one direction in axes nobody knows tells nothing
    along = locate(seer, initial=places)
    assert any("turned about the line to all they see is not known: 6" in w for w in along.warnings)
    assert np.isnan(along.heading_var[6]).all()
    assert np.isfinite(along.heading_var[:6]).all()
    np.testing.assert_allclose(along.position, estimate.position, atol=1e-4)


@pytest.mark.parametrize("method", ["ekf", "iekf", "fej", "distributed"])
def test_methods_that_need_common_axes_in_space_say_so(method):
    net, _ = simulated(1, robots=8, dim=3, axis=False)
    with pytest.raises(DataError, match=r"in space .* common axes: use the batch method"):
        locate(net, SwarmConfig(method=method))
