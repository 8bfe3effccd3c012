"""Where one frame lies in another: the compiled cost and its derivatives."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.kernels.landmarks.submap import relation_normal
from mapweave.team.config import PlacingConfig
from mapweave.team.relation import MutualSightings, costs, residuals

pytestmark = pytest.mark.kernel
CFG = PlacingConfig()


def glances(m: int = 40) -> MutualSightings:
    rng = np.random.default_rng(5)
    pose = np.column_stack([rng.uniform(-5, 5, (m, 2)), rng.uniform(-3, 3, m)])
    told = np.where(rng.random(m) < 0.3, np.nan, rng.uniform(0.5, 6, m))
    seen = rng.uniform(-1, 1, m)
    return MutualSightings(rng.random(m) < 0.5, pose, rng.uniform(-5, 5, (m, 2)), told, seen, np.arange(m, dtype=float))


def test_cost_gradient_and_information_are_those_of_the_residuals():
    z, T = glances(), np.array([0.7, -0.4, 1.1])
    cost, g, H = relation_normal(
        z.forward, z.pose, z.point, z.range, z.bearing, T, CFG.range_floor, CFG.range_share, CFG.bearing
    )
    assert cost == pytest.approx(float(costs(z, T, CFG)), rel=1e-12)
    h = 1e-6 * np.eye(3)
    e = residuals(z, T, CFG)
    both = residuals(z, T + h, CFG) - residuals(z, T - h, CFG)
    both[..., 1] = se2.wrap_angle(both[..., 1] * CFG.bearing) / CFG.bearing
    J = np.moveaxis(both / 2e-6, 0, -1)
    weight = 1.0 / (1.0 + np.square(e).sum(axis=-1) / 4.0)
    np.testing.assert_allclose(g, np.einsum("m,mri,mr->i", weight, J, e), rtol=1e-5)
    np.testing.assert_allclose(H, np.einsum("m,mri,mrj->ij", weight, J, J), rtol=1e-5, atol=1e-6)


def test_a_direction_to_a_point_at_the_observers_place_does_not_tell_it_without_end():
    nothing = np.full(1, np.nan)
    for forward in (True, False):
        at = np.array([[2.0, 1.0, 0.3]]), np.array([[2.0, 1.0 + 1e-8]])
        _, _, H = relation_normal(
            np.full(1, forward), *at, nothing, np.zeros(1), np.zeros(3), CFG.range_floor, CFG.range_share, CFG.bearing
        )
        assert 0.0 < np.linalg.eigvalsh(H[:2, :2])[1] < 1.0 / (0.05 * CFG.bearing) ** 2
