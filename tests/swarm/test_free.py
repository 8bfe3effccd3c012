"""What the sightings leave open is found, named, and fails nothing."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.errors import DataError
from mapweave.core.se2 import wrap_angle
from mapweave.swarm.factors import bearing_factor, columns
from mapweave.swarm.locate import locate
from mapweave.swarm.network import BearingNetwork, Distance

from .swarms import PAPER, complete, score, simulated


def likeness(position, truth, *, turn=False):
    """RMSE [m] of `position` brought onto `truth` by place, scale and, with `turn`, orientation (2D)."""
    a, b = position - position.mean(axis=0), truth - truth.mean(axis=0)
    if turn:
        z, w = a @ [1, 1j], b @ [1, 1j]
        fit = np.vdot(z, w) / np.vdot(z, z) * z
        return float(np.sqrt(np.mean(np.abs(fit - w) ** 2)))
    return float(np.sqrt(np.square((a * b).sum() / (a * a).sum() * a - b).sum(axis=1).mean()))


@pytest.mark.parametrize(("dim", "free"), [(2, 3), (3, 4)])
def test_without_anchors_the_shape_is_right_and_place_and_scale_are_said_to_be_free(dim, free):
    net, truth = simulated(1, robots=216, dim=dim, anchors=())
    estimate = locate(net)
    assert estimate.null_space == free
    assert estimate.localisable.all()
    assert "place free" in estimate.gauge
    assert "scale free" in estimate.gauge
    np.testing.assert_allclose(estimate.position.mean(axis=0), 0, atol=1e-12)
    assert np.square(estimate.position).sum(axis=1).mean() == pytest.approx(1.0)
    assert likeness(estimate.position, truth) < 0.3


def test_the_covariance_of_a_free_gauge_holds_the_conditions_that_fix_it():
    net, _ = simulated(1, robots=49, anchors=())
    estimate = locate(net)
    joint = estimate.joint(np.arange(49))
    p = estimate.position.ravel()
    place = np.tile(np.eye(2), (49, 1))
    np.testing.assert_allclose(joint @ place, 0, atol=1e-12)
    np.testing.assert_allclose(joint @ p, 0, atol=1e-12)
    blocks = np.stack([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(49)])
    np.testing.assert_allclose(blocks, estimate.cov, atol=1e-12)
    J = bearing_factor(net)
    A = np.zeros((98, 98))
    rows = J.jacobian(p)[:, 0, :] / net.sigma[:, None]
    for row, at in zip(rows, columns(net), strict=True):
        A[np.ix_(at, at)] += np.outer(row, row)
    np.testing.assert_allclose(joint, np.linalg.pinv(A, rcond=1e-9), atol=1e-9 * joint.max())


def test_one_anchor_leaves_the_scale_and_a_known_distance_gives_it():
    net, truth = simulated(2, robots=100, anchors=(0,))
    free = locate(net)
    assert free.null_space == 1
    assert free.gauge.startswith("scale free")
    np.testing.assert_array_equal(free.position[0], truth[0])
    far = float(np.linalg.norm(truth[99] - truth[0]))
    known = locate(replace(net, distances=(Distance(0, 99, far),)))
    assert known.gauge == ""
    assert known.null_space == 0
    assert np.linalg.norm(known.position[99] - known.position[0]) == pytest.approx(far, rel=1e-5)
    rmse, bound, nees = score(known, truth)
    assert rmse < 1.5 * bound
    assert 0.7 < nees < 1.3


def test_the_localisable_robots_are_those_on_which_the_dense_null_space_is_zero():
    for dim, seed in ((2, 1), (2, 2), (3, 3)):
        net, truth = simulated(seed, robots=150, dim=dim, missing=0.7 if dim == 2 else 0.8)
        p = locate(net).position
        J = (
            bearing_factor(net).jacobian(p.ravel())
            * np.linalg.norm(p[net.target] - p[net.observer], axis=1)[:, None, None]
        )
        A = np.zeros((truth.size, truth.size))
        for rows, at in zip(J, columns(net), strict=True):
            A[np.ix_(at, at)] += rows.T @ rows
        free = np.repeat(~net.is_anchor, dim)
        values, vectors = np.linalg.eigh(A[free][:, free])
        null = vectors[:, values < 1e-10]
        moves = np.zeros(truth.size)
        moves[free] = np.square(null).sum(axis=1)
        expected = moves.reshape(-1, dim).sum(axis=1) < 1e-9
        estimate = locate(net)
        assert 0 < np.count_nonzero(~expected) < len(net)
        np.testing.assert_array_equal(estimate.localisable, expected)
        assert estimate.null_space == null.shape[1]
        assert np.isnan(estimate.cov[~expected]).all()
        assert np.isfinite(estimate.cov[expected]).all()
        assert set(estimate.not_localisable) == {net.ids[k] for k in np.flatnonzero(~expected)}


def test_robots_that_only_nearly_parallel_rays_determine_are_remarked_on():
    net, truth = simulated(1, robots=49, sigma=1.0)
    away = truth[10] + 400.0 * np.array([np.cos(0.3), np.sin(0.3)])
    d = away - truth[[10, 11]]
    far = BearingNetwork(
        (*net.ids, "far"),
        2,
        np.r_[net.observer, 10, 11],
        np.r_[net.target, 49, 49],
        np.r_[net.bearing, np.arctan2(d[:, 1], d[:, 0])],
        np.r_[net.sigma, net.sigma[:2]],
        net.anchors,
    )
    estimate = locate(far)
    assert estimate.localisable.all()
    assert any("robots barely determined, by rays nearly parallel: 1;" in w for w in estimate.warnings)
    assert not any("barely" in w for w in locate(net).warnings)


def test_a_robot_sighted_once_stands_along_its_ray_and_is_listed():
    net, truth = simulated(1, robots=36)
    lonely = BearingNetwork(
        (*net.ids, "hanger-on"),
        2,
        np.r_[net.observer, 5],
        np.r_[net.target, 36],
        np.r_[net.bearing, 1.0],
        np.r_[net.sigma, net.sigma[0]],
        net.anchors,
    )
    estimate = locate(lonely)
    assert estimate.not_localisable == ("hanger-on",)
    ray = estimate.position[36] - estimate.position[5]
    assert abs(wrap_angle(np.arctan2(ray[1], ray[0]) - 1.0)) < 0.01
    np.testing.assert_allclose(estimate.position[:36], locate(net).position, atol=1e-4)
    assert np.abs(estimate.position[:36] - truth).max() < 1


@pytest.mark.parametrize("anchors", ["corners", (0, 99), (0,), ()])
def test_headings_are_found_where_no_axis_is_common(anchors):
    net, truth = simulated(3, robots=100, axis=False, anchors=anchors, visibility="mutual")
    estimate = locate(net)
    known = len(net.anchors)
    assert estimate.localisable.all()
    assert estimate.reliable
    assert estimate.null_space == (0 if known >= 2 else 2 if known else 4)
    assert estimate.heading is not None
    if known >= 2:
        rmse, bound, nees = score(estimate, truth)
        assert rmse < 1.6 * bound
        assert 0.7 < nees < 1.3
        assert (estimate.heading_var > 0).all()
    else:
        assert "orientation free" in estimate.gauge
        assert likeness(estimate.position, truth, turn=True) < 0.5


def test_headings_spread_to_robots_that_only_see():
    net, truth = simulated(4, robots=100, axis=False)  # directed: not everybody is seen back
    estimate = locate(net)
    assert estimate.localisable.all()
    rmse, bound, _ = score(estimate, truth)
    assert rmse < 1.5 * bound


def test_no_axis_and_no_mutual_sighting_is_an_error_that_says_so():
    net, _ = simulated(1, robots=49, axis=False, visibility="single")
    with pytest.raises(DataError, match="no two robots sighted each other"):
        locate(net)


def test_pieces_that_do_not_hang_together_are_each_given_their_due():
    a, _ = simulated(1, robots=49)
    b, other = simulated(2, robots=36, anchors=())
    both = BearingNetwork(
        tuple(map(str, range(85))),
        2,
        np.r_[a.observer, b.observer + 49],
        np.r_[a.target, b.target + 49],
        np.r_[a.bearing, b.bearing],
        np.r_[a.sigma, b.sigma],
        a.anchors,
    )
    estimate = locate(both)
    assert estimate.localisable.tolist() == [True] * 49 + [False] * 36
    assert estimate.null_space == 3
    np.testing.assert_allclose(estimate.position[:49], locate(a).position, atol=1e-6)
    assert likeness(estimate.position[49:], other) < 0.5
    assert estimate.dof == len(both.observer) - 2 * (85 - 4) + 3


@pytest.mark.parametrize("anchors", [(), (0,), (0, 9)])
def test_robots_on_one_line_are_listed_and_the_line_is_named(anchors):
    line = np.stack([10.0 * np.arange(10), 3.0 * np.arange(10)], axis=1)
    estimate = locate(complete(line, 0.5, np.random.default_rng(1), anchors))
    assert not estimate.localisable[~estimate.anchor].any()
    assert any("one line" in w for w in estimate.warnings)
    assert not estimate.reliable
    assert np.isfinite(estimate.position).all()


def test_robots_all_at_one_point_fail_nothing_and_are_not_called_reliable():
    point = np.zeros((6, 2))
    estimate = locate(complete(point, 0.5, np.random.default_rng(1), (0, 1)))
    assert np.isfinite(estimate.position).all()
    assert not estimate.reliable
    assert any("one place" in w for w in estimate.warnings)


@pytest.mark.parametrize("dim", [2, 3])
def test_exact_sightings_give_exact_positions_with_nothing_to_doubt(dim):
    net, truth = simulated(1, robots=64, dim=dim, sigma=0.0)
    estimate = locate(net)
    assert np.abs(estimate.position - truth).max() < 1e-9
    assert not estimate.cov.any()


def test_the_order_of_robots_and_sightings_does_not_matter():
    net, _ = simulated(6, robots=64, sigma=1.0)
    rng = np.random.default_rng(0)
    rows, robots = rng.permutation(len(net.observer)), rng.permutation(64)
    place = np.argsort(robots)
    shuffled = BearingNetwork(
        tuple(net.ids[k] for k in robots),
        2,
        place[net.observer[rows]],
        place[net.target[rows]],
        net.bearing[rows],
        net.sigma[rows],
        {int(place[k]): p for k, p in net.anchors.items()},
    )
    np.testing.assert_allclose(locate(shuffled).position, locate(net).position[robots], atol=1e-6)


def test_the_paper_s_five_robots_come_out_from_no_guess_at_all():
    net = complete(PAPER, 0.1, np.random.default_rng(2), (0, 1))
    assert np.abs(locate(net).position - PAPER).max() < 0.1
