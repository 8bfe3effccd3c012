"""A gauge sets what bearings leave free, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.swarm.factors import bearing_factor, width
from mapweave.swarm.observability import Gauge, gauge_basis, gauge_pins, normalise

from .swarms import complete

RNG = np.random.default_rng(5)
PLACES = RNG.uniform(-4, 9, (6, 2))
HEADINGS = RNG.uniform(-0.5, 1.5, 6)
MEMBERS = np.array([True, True, False, True, True, True])


def gauge(*, place=False, scale=False, turn=False, centre=(0.0, 0.0)):
    return Gauge("something free", place, scale, np.eye(1)[:, : int(turn)], MEMBERS, np.array(centre))


def distances(p):
    return np.hypot(*np.moveaxis(p[:, None] - p, -1, 0))


def test_place_size_and_orientation_are_set_and_the_shape_is_kept():
    whole = gauge(place=True, scale=True, turn=True)
    p, h = normalise(whole, PLACES, HEADINGS)
    np.testing.assert_allclose(p[MEMBERS].mean(axis=0), 0.0, atol=1e-12)
    assert np.square(p[MEMBERS]).sum(axis=1).mean() == pytest.approx(1.0)
    assert np.angle(np.exp(1j * h[MEMBERS]).sum()) == pytest.approx(0.0, abs=1e-12)
    ratio = distances(p)[np.triu_indices(6, 1)] / distances(PLACES)[np.triu_indices(6, 1)]
    np.testing.assert_allclose(ratio, ratio[0])
    seen = np.arctan2(*(p[3] - p[1])[::-1]) - h[1]
    before = np.arctan2(*(PLACES[3] - PLACES[1])[::-1]) - HEADINGS[1]
    assert np.exp(1j * (seen - before)) == pytest.approx(1.0)
    again, same = normalise(whole, p, h)
    np.testing.assert_allclose(again, p, atol=1e-12)
    np.testing.assert_allclose(same, h, atol=1e-12)


@pytest.mark.parametrize("free", ["place", "scale", "turn"])
def test_only_what_is_free_is_set(free):
    centre = np.array([1.0, -2.0])
    p, h = normalise(gauge(**{free: True}, centre=(0.0, 0.0) if free == "place" else centre), PLACES, HEADINGS)
    if free == "place":
        np.testing.assert_allclose(p - p[0], PLACES - PLACES[0], atol=1e-12)
        np.testing.assert_array_equal(h, HEADINGS)
    elif free == "scale":
        away, was = p - centre, PLACES - centre
        np.testing.assert_allclose(away / away[0], was / was[0])
        assert np.square(away[MEMBERS]).sum(axis=1).mean() == pytest.approx(1.0)
    else:
        np.testing.assert_allclose(distances(p), distances(PLACES))
        np.testing.assert_allclose(np.hypot(*(p - centre).T), np.hypot(*(PLACES - centre).T))
    p, h = normalise(Gauge("", False, False, np.zeros((1, 0)), MEMBERS, centre), PLACES, HEADINGS)
    assert p is PLACES
    assert h is HEADINGS


@pytest.mark.parametrize(("place", "scale"), [(True, True), (True, False), (False, True)])
def test_no_sighting_sees_the_motions_that_the_gauge_takes_away_and_pins_leave_none(place, scale):
    anchors = () if place else (2,)
    net = complete(PLACES, 0.5, RNG, anchors)
    whole = gauge(place=place, scale=scale, centre=PLACES[2] if not place else (0.0, 0.0))
    G, C = gauge_basis(net, whole, PLACES)
    assert G.shape == C.shape == (6 * width(net), 2 * place + scale)
    members = Gauge(whole.name, place, scale, np.zeros((1, 0)), np.ones(6, dtype=bool), whole.centre)
    G, C = gauge_basis(net, members, PLACES)
    factor, x, h = bearing_factor(net), PLACES.ravel(), 1e-6
    for g in G.T:
        change = (factor.residual(x + h * g) - factor.residual(x - h * g)) / (2 * h)
        assert np.abs(change).max() < 1e-6
    np.testing.assert_allclose(C.T @ G, np.diag(np.diag(C.T @ G)), atol=1e-9)
    free = np.flatnonzero(~gauge_pins(net, members, PLACES).ravel())
    assert len(free) == 12 - G.shape[1]
    J = [(factor.residual(x + h * e) - factor.residual(x - h * e)).ravel() / (2 * h) for e in np.eye(12)[free]]
    lost = (
        0 if place and scale else 2 - 2 * place + (1 - scale)
    )  # what bearings leave free and this gauge does not hold
    assert np.linalg.matrix_rank(np.array(J), tol=1e-6) == len(free) - lost


def test_turning_the_whole_is_the_motion_that_sightings_in_own_axes_do_not_see():
    net = replace(complete(PLACES, 0.5, RNG), axis=False)
    whole = Gauge("orientation free", True, True, np.eye(1), np.ones(6, dtype=bool), np.zeros(2))
    G, C = gauge_basis(net, whole, PLACES)
    assert G.shape == C.shape == (18, 4)
    factor, x, h = bearing_factor(net), np.column_stack([PLACES, HEADINGS]).ravel(), 1e-6
    for g in G.T:
        change = (factor.residual(x + h * g) - factor.residual(x - h * g)) / (2 * h)
        assert np.abs(change).max() < 1e-6
    assert np.linalg.matrix_rank(C.T @ G) == 4
    free = np.flatnonzero(~gauge_pins(net, whole, PLACES).ravel())
    J = [(factor.residual(x + h * e) - factor.residual(x - h * e)).ravel() / (2 * h) for e in np.eye(18)[free]]
    assert len(free) == 14
    assert np.linalg.matrix_rank(np.array(J), tol=1e-6) == 14
