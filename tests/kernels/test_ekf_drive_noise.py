"""The noise gathered while driving equals dense textbook algebra: what earlier noise becomes, and what is added."""

import math

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.landmarks import ekf

pytestmark = pytest.mark.kernel

NOISE = ekf.Noise(
    along=0.05, across=0.02, drift=0.05, turn=0.04, rest_xy=0.03, rest_theta=0.07, lost_xy=0.06, lost_theta=0.3,
    hold=2.0, speed=0.0, speed_time=1.0, spin=0.0, spin_time=1.0, range_floor=0.05, range_share=0.045, bearing=0.014,
    range_inflation=1.0, bearing_inflation=1.0, gate=1e9, far=1e9, agree=1,
)  # fmt: skip
HEADING, V_SCALE, TURN_SCALE = 0.8, 1.1, 0.9


def on_an_arc(Q, v, w, dt, *, known=True):
    """Noise after one arc that begins with `Q`; and the arc's shift and mean heading."""
    x = np.array([1.0, -2.0, HEADING, V_SCALE, TURN_SCALE, 0.1, 0.0, 1.0])
    Phi, unused = np.zeros((3, 8)), np.zeros((3, 3))
    ekf.clear(Phi, unused)
    before, out = x.copy(), Q.copy()
    ekf.arc(x, Phi, out, v, w, dt, NOISE, known)
    return out, (x - before)[:2], HEADING + 0.5 * TURN_SCALE * w * dt


def added(v, w, dt, heading):
    """The process noise of an arc whose mean heading is `heading`."""
    along = NOISE.along**2 * abs(v * dt) + NOISE.rest_xy**2 * dt
    across = NOISE.across**2 * abs(v * dt) + NOISE.rest_xy**2 * dt
    turned = NOISE.drift**2 * abs(v * dt) + NOISE.turn**2 * abs(w * dt) + NOISE.rest_theta**2 * dt
    R = np.eye(3)
    R[:2, :2] = se2.rotation(heading)
    return R @ np.diag([along, across, turned]) @ R.T


@pytest.mark.parametrize(("v", "w", "dt"), [(0.4, 0.0, 0.3), (0.3, 0.7, 0.25), (-0.2, -1.1, 2.0), (0.0, 0.0, 4.0)])
def test_noise_gathered_before_is_carried_on_and_the_arcs_own_is_added(v, w, dt):
    A = np.random.default_rng(1).normal(size=(3, 3))
    Q = A @ A.T  # correlated in all three
    got, shift, heading = on_an_arc(Q, v, w, dt)
    F = np.eye(3)
    F[:2, 2] = -shift[1], shift[0]
    np.testing.assert_allclose(got, F @ Q @ F.T + added(v, w, dt, heading), atol=1e-12)
    np.testing.assert_array_equal(got, got.T)


def arc_end(turn_scale, v, w, dt):
    """Where an arc from the origin with HEADING ends, exact for complex turn scales as well."""
    h = 0.5 * turn_scale * w * dt
    sinc = sum((-1) ** k * h ** (2 * k) / math.factorial(2 * k + 1) for k in range(12))
    return V_SCALE * v * dt * sinc * np.array([np.cos(HEADING + h), np.sin(HEADING + h)])


@pytest.mark.parametrize("h", [0.0, 1e-7, -1e-5, 0.95e-4, -1.05e-4, 1e-3, 0.6])
def test_arcs_and_their_derivative_by_the_turn_scale_are_exact_however_slight_the_turn(h):
    v, dt = 0.4, 0.5
    w = h / (0.5 * TURN_SCALE * dt)
    x = np.array([0.0, 0.0, HEADING, V_SCALE, TURN_SCALE, 0.1, 0.0, 1.0])
    Phi, Q = np.zeros((3, 8)), np.zeros((3, 3))
    ekf.clear(Phi, Q)
    ekf.arc(x, Phi, Q, v, w, dt, NOISE, True)
    np.testing.assert_allclose(x[:2], arc_end(TURN_SCALE, v, w, dt), rtol=1e-13)
    by_scale = arc_end(TURN_SCALE + 1e-30j, v, w, dt).imag / 1e-30
    np.testing.assert_allclose(Phi[:2, ekf.TURN_SCALE], by_scale, rtol=1e-7)


@pytest.mark.parametrize("known", [True, False])
def test_noise_at_rest_grows_with_time_however_it_is_cut(known):
    whole, _, _ = on_an_arc(np.zeros((3, 3)), 0.0, 0.0, 3.0, known=known)
    parts = np.zeros((3, 3))
    for dt in (0.5, 1.5, 1.0):
        parts, _, _ = on_an_arc(parts, 0.0, 0.0, dt, known=known)
    xy, theta = (NOISE.rest_xy, NOISE.rest_theta) if known else (NOISE.lost_xy, NOISE.lost_theta)
    np.testing.assert_allclose(np.diag(whole), 3.0 * np.array([xy, xy, theta]) ** 2, rtol=1e-12)
    np.testing.assert_allclose(parts, whole, atol=1e-15)
