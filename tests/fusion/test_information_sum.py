"""The sum of information: a newer map in place of an older one gives what joining the newer maps at once gives."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.errors import EstimateError
from mapweave.fusion import online
from mapweave.fusion.cluster import clusters
from mapweave.fusion.full_covariance import join
from mapweave.fusion.join import fuse
from mapweave.fusion.online import InformationSum, OnlineFuser
from mapweave.landmarks.landmark_map import LandmarkMap

from .test_online import versions
from .worlds import team, with_landmarks

SIGMA, FLOOR = 0.02, 0.01


def joined_at_once(maps):
    start = clusters([m.submap.landmarks for m in maps])[0]
    return join([m.submap.landmarks for m in maps], start, scale_sigma=SIGMA, floor=FLOOR)


def summed(maps, shift=0.0):
    component = fuse(maps).components[0]
    landmarks = LandmarkMap(component.map.ids, component.map.mean + shift, component.map.cov)
    moved = type(component)(component.robots, landmarks, component.frames, component.frame_cov, component.members)
    return InformationSum.of(
        moved, {m.robot: m.submap.landmarks for m in maps}, {m.robot: 1.0 for m in maps}, SIGMA, FLOOR
    )


def assert_as_at_once(component, maps):
    whole = joined_at_once(maps)
    order = [whole.ids.index(name) for name in component.map.ids]
    rows = (2 * np.array(order)[:, None] + np.arange(2)).ravel()
    np.testing.assert_allclose(component.map.mean, whole.mean[order], atol=1e-6)
    np.testing.assert_allclose(component.map.cov, whole.cov[np.ix_(rows, rows)], rtol=2e-3, atol=1e-9)
    for robot, frame in zip(component.robots, whole.frames, strict=True):
        np.testing.assert_allclose(se2.between(frame, component.frames[robot]), 0, atol=1e-6)


@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_a_sum_is_all_maps_joined_at_once_from_wherever_it_starts(shift):
    maps, _, _, _ = team(np.random.default_rng(11), robots=4)
    assert_as_at_once(summed(maps, shift).joined(), maps)


def test_new_less_old_is_the_newer_maps_joined_at_once_after_a_hundred_exchanges():
    rng = np.random.default_rng(12)
    older, _, _, _ = team(rng, robots=4)
    newer = [
        with_landmarks(
            m, mean=m.submap.mean + rng.normal(0, 0.02, m.submap.mean.shape), cov=0.25 * m.submap.cov[3:, 3:]
        )
        for m in older
    ]
    total = summed(older)
    for k in range(100):
        m = (newer if k % 2 == 0 else older)[k % 4]
        total = total.put({m.robot: m.submap.landmarks}).converged()
    total = total.put({m.robot: m.submap.landmarks for m in newer}).converged()
    assert_as_at_once(total.joined(), newer)


def test_between_two_judgements_only_the_sum_changes_and_it_stays_near_what_fusing_gives():
    grown = versions(team(np.random.default_rng(13), robots=4)[0], steps=4)
    fuser = OnlineFuser().update(*grown[-1])
    assert fuser.judged == 1
    again = fuser.update(*grown[-1])
    assert again.judged == 1
    np.testing.assert_allclose(again.largest.map.mean, fuse(grown[-1]).components[0].map.mean, atol=2e-3)


def test_a_sum_that_comes_to_no_rest_is_an_error_and_no_map(monkeypatch):
    maps, _, _, _ = team(np.random.default_rng(11), robots=4)
    monkeypatch.setattr(online, "ROUNDS", 1)
    with pytest.raises(EstimateError, match="come to no rest"):
        summed(maps, 0.3)
