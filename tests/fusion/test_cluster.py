"""Which maps hang together, and where a first guess puts them."""

import numpy as np

from mapweave.core import se2
from mapweave.fusion.cluster import clusters
from mapweave.landmarks.landmark_map import LandmarkMap


def local(ids, points, frame):
    return LandmarkMap(tuple(ids), se2.act(se2.inverse(frame), points), 1e-4 * np.eye(2 * len(ids)))


def world(seed=0):
    rng = np.random.default_rng(seed)
    points = {name: rng.uniform(-5, 5, 2) for name in "abcdefghij"}
    frames = [np.zeros(3), *rng.uniform(-3, 3, (4, 3))]
    views = ("abcd", "cdef", "efgh", "ghij", "hx")
    points["x"] = rng.uniform(-5, 5, 2)
    return points, frames, [local(v, np.array([points[n] for n in v]), T) for v, T in zip(views, frames, strict=True)]


def test_exact_maps_in_a_chain_are_put_together_exactly():
    points, frames, maps = world()
    whole, alone = clusters(maps)
    assert whole.members == (0, 1, 2, 3)
    assert alone.members == (4,)
    assert np.allclose(whole.points, [points[n] for n in whole.ids], atol=1e-12)
    assert np.allclose(whole.frames, frames[:4], atol=1e-12)
    assert whole.shared.tolist() == [2, 4, 4, 2]
    assert alone.shared.tolist() == [0]


def test_the_order_of_the_maps_changes_only_the_frame_it_is_told_in():
    points, frames, maps = world(1)
    order = [3, 1, 4, 0, 2]
    whole = clusters([maps[k] for k in order])[0]
    wanted = se2.act(se2.inverse(frames[3]), np.array([points[n] for n in whole.ids]))
    assert [order[k] for k in whole.members] == [3, 1, 0, 2]
    assert np.allclose(whole.points, wanted, atol=1e-12)


def test_two_pairs_that_together_share_enough_with_a_third_are_one_cluster():
    rng = np.random.default_rng(2)
    p = {n: rng.uniform(-4, 4, 2) for n in "abcdefgh"}
    views = ("ad", "abc", "bcd")  # the first shares one landmark with each of the others
    maps = [local(v, np.array([p[n] for n in v]), T) for v, T in zip(views, rng.uniform(-2, 2, (3, 3)), strict=True)]
    assert [c.members for c in clusters(maps)] == [(0, 1, 2)]


def test_no_maps_are_no_clusters():
    assert clusters([]) == ()
