"""Fusing maps whose landmarks carry names that mean nothing between robots."""

from dataclasses import replace

import numpy as np

from mapweave.fusion.config import FuseConfig
from mapweave.fusion.identities import identify
from mapweave.fusion.join import fuse

from .worlds import rmse, team, with_landmarks

UNKNOWN = FuseConfig(identities="unknown")


def nameless(maps, rng, keep=1):
    """The maps with labels shuffled, but for the first `keep`; and the true name of every own name."""
    out, true = [], {}
    for k, m in enumerate(maps):
        ids = m.submap.ids
        own = ids if k < keep else tuple(f"p{i}" for i in rng.permutation(len(ids)))
        out.append(with_landmarks(m, own))
        true[m.robot] = dict(zip(own, ids, strict=True))
    return out, true


def test_maps_without_common_names_give_the_map_that_names_would_have_given():
    for draw in range(4):
        rng = np.random.default_rng([1, draw])
        maps, points, _, _ = team(rng, robots=4, landmarks=16, seen=16)
        strange, true = nameless(maps, rng)
        fused = fuse(strange, UNKNOWN)
        known = fuse(maps)
        assert len(fused.components) == 1
        assert fused.components[0].map.ids == known.components[0].map.ids
        np.testing.assert_allclose(fused.components[0].map.mean, known.components[0].map.mean, atol=1e-5)
        for robot, names in fused.labels.items():
            assert all(true[robot][own] == name for own, name in names.items())
        assert rmse(fused.components[0], points) < 0.2


def test_landmarks_of_few_robots_keep_names_of_their_own():
    rng = np.random.default_rng(2)
    maps, _, _, _ = team(rng, robots=4, landmarks=20, seen=14)
    strange, _ = nameless(maps, rng)
    fused = fuse(strange, UNKNOWN)
    assert len(fused.components) == 1
    names = fused.components[0].map.ids
    assert len(names) == len(set(names)) == len({i for m in maps for i in m.submap.ids})


def test_a_map_of_another_place_is_refused_with_the_reason():
    rng = np.random.default_rng(3)
    maps, _, _, _ = team(rng, robots=3, landmarks=14, seen=14)
    other, _, _, _ = team(np.random.default_rng(99), robots=1, landmarks=14, seen=14)
    strange, _ = nameless([*maps, replace(other[0], robot="robot4")], rng)
    fused = fuse(strange, UNKNOWN)
    assert fused.components[0].robots == ("robot1", "robot2", "robot3")
    decision = fused.decisions[3]
    assert decision.decision == "refused"
    assert "fit together" in decision.reason


def test_no_two_landmarks_of_one_map_become_one():
    rng = np.random.default_rng(4)
    maps, _, _, _ = team(rng, robots=5, landmarks=15, seen=12)
    strange, _ = nameless(maps, rng, keep=0)
    found = identify([m.submap.landmarks for m in strange], [m.robot for m in strange])
    for m in found.maps:
        assert len(set(m.ids)) == len(m.ids)
