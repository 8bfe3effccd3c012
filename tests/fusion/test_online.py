"""Fusing while maps grow: the last map is the one that fusing at the end gives, and nothing counts twice."""

from dataclasses import replace

import numpy as np

from mapweave.fusion.join import fuse
from mapweave.fusion.online import OnlineFuser

from .worlds import local_map, team


def versions(maps, steps=4):
    """Each map as it grows: first few landmarks with much noise, in the end the map itself."""
    out = []
    for step in range(1, steps + 1):
        grown = []
        for m in maps:
            n = max(2, len(m.submap.ids) * step // steps)
            part = m.submap.landmarks.select(m.submap.ids[:n])
            more = 1.0 + 3.0 * (steps - step)
            grown.append(replace(local_map(m.robot, part.ids, part.mean, more * part.cov), log_hash=m.robot))
        out.append(grown)
    return out


def test_the_last_online_map_is_the_offline_one_whatever_came_before():
    rng = np.random.default_rng(1)
    maps, _, _, _ = team(rng, robots=4)
    fuser = OnlineFuser()
    for grown in versions(maps):
        for m in grown:
            fuser = fuser.update(m)
    last = versions(maps)[-1]
    offline = fuse(last)
    np.testing.assert_allclose(fuser.largest.map.mean, offline.components[0].map.mean, atol=5e-3)
    fuser = fuser.converged()
    np.testing.assert_array_equal(fuser.fusion.components[0].map.mean, offline.components[0].map.mean)
    np.testing.assert_array_equal(fuser.fusion.components[0].map.cov, offline.components[0].map.cov)
    np.testing.assert_array_equal(OnlineFuser().update(*last).largest.map.mean, offline.components[0].map.mean)


def test_the_same_version_sent_again_changes_nothing():
    rng = np.random.default_rng(2)
    maps, _, _, _ = team(rng, robots=3)
    once = OnlineFuser().update(*maps)
    again = once.update(maps[1]).update(maps[1])
    np.testing.assert_allclose(once.largest.map.cov, again.largest.map.cov, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(once.largest.map.cov, again.converged().largest.map.cov)


def test_the_map_gets_surer_as_maps_grow_and_robots_are_tied_in_one_by_one():
    rng = np.random.default_rng(3)
    maps, _, _, _ = team(rng, robots=4, landmarks=12, seen=12)
    empty = OnlineFuser()
    assert (empty.tied_in, empty.trace, empty.log_det) == (0, None, None)
    fuser, tied = empty, []
    for m in maps:
        fuser = fuser.update(m)
        tied.append(fuser.tied_in)
    assert tied == [1, 2, 3, 4]
    first = OnlineFuser().update(*[replace(m, submap=replace(m.submap, cov=4 * m.submap.cov)) for m in maps])
    assert first.trace > fuser.trace
    assert first.log_det > fuser.log_det
    assert empty.tied_in == 0  # an update gives a new fuser and leaves the old one


def test_a_robot_that_has_mapped_nothing_yet_waits():
    rng = np.random.default_rng(4)
    maps, _, _, _ = team(rng, robots=2)
    fuser = OnlineFuser().update(local_map("robot3", [], np.zeros((0, 2)), np.zeros((0, 0))))
    assert fuser.trace is None
    assert fuser.update(*maps).tied_in == 2
