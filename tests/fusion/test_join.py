"""Fusing local maps: what comes out whatever the order, and what is told about maps that do not fit."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse

from .worlds import local_map, nees, rmse, team, with_landmarks


def same(a, b, atol=1e-6):
    assert a.map.ids == b.map.ids
    np.testing.assert_allclose(a.map.mean, b.map.mean, atol=atol)
    np.testing.assert_allclose(a.map.cov, b.map.cov, rtol=1e-3, atol=1e-8)
    for robot in a.robots:
        np.testing.assert_allclose(se2.between(a.frames[robot], b.frames[robot]), 0, atol=10 * atol)


@pytest.mark.parametrize("weights", ["full-scaled", "full", "diagonal", "paper", "constant", "naive"])
def test_fusing_in_any_order_gives_the_same_map(weights):
    rng = np.random.default_rng(1)
    maps, points, _, _ = team(rng)
    cfg = FuseConfig(weights=weights)
    once = fuse(maps, cfg)
    assert once.components[0].robots == ("robot1", "robot2", "robot3", "robot4")
    turned = fuse(maps[::-1], cfg)
    same(once.components[0], turned.components[0])
    assert [d.robot for d in turned.decisions] == [m.robot for m in maps]
    assert rmse(once.components[0], points) < 0.3


def test_the_order_of_landmarks_in_a_map_does_not_matter():
    rng = np.random.default_rng(2)
    maps, _, _, _ = team(rng)
    shuffled = []
    for m in maps:
        order = rng.permutation(len(m.submap.ids))
        chosen = m.submap.landmarks.select([m.submap.ids[i] for i in order])
        shuffled.append(with_landmarks(m, chosen.ids, chosen.mean, chosen.cov))
    same(fuse(maps).components[0], fuse(shuffled).components[0])


def test_the_map_stands_in_the_first_pose_of_the_lowest_numbered_robot():
    rng = np.random.default_rng(3)
    maps, points, frames, _ = team(rng, robots=3)
    names = ["robot11", "robot2", "robot3"]
    maps = [replace(m, robot=name) for m, name in zip(maps, names, strict=True)]
    component = fuse(maps).components[0]
    assert component.robots == ("robot2", "robot3", "robot11")
    np.testing.assert_array_equal(component.frames["robot2"], 0)
    T = se2.inverse(frames[1])
    np.testing.assert_allclose(component.frames["robot11"][:2], T[:2], atol=0.2)
    assert rmse(component, se2.act(T, points)) < 0.3


def test_robots_that_share_one_landmark_stay_apart_and_it_is_told():
    rng = np.random.default_rng(4)
    maps, _, _, _ = team(rng, robots=3)
    lonely = with_landmarks(maps[2], [maps[0].submap.ids[0], *[f"9{i}" for i in range(10)]])
    fused = fuse([*maps[:2], lonely])
    assert [c.robots for c in fused.components] == [("robot1", "robot2"), ("robot3",)]
    decision = fused.decisions[2]
    assert decision.decision == "refused"
    assert "fewer than 2 landmarks" in decision.reason
    np.testing.assert_allclose(fused.components[1].map.select(lonely.submap.ids).mean, lonely.submap.mean)


def test_maps_that_only_together_share_two_landmarks_are_joined():
    rng = np.random.default_rng(5)
    points = rng.uniform(-5, 5, (9, 2))
    P = 1e-4 * np.eye(6)
    one = local_map("robot1", ["100", "101", "102"], points[:3], P)
    two = local_map("robot2", ["102", "103", "104"], points[2:5], P)
    three = local_map("robot3", ["101", "102", "103"], points[1:4], P)
    assert len(fuse([one, two]).components) == 2
    fused = fuse([one, two, three])
    assert len(fused.components) == 1
    np.testing.assert_allclose(fused.components[0].map.mean, points[:5] - 0, atol=1e-6)
    pairs = [
        local_map("robot1", ["a", "b", "c"], points[[0, 1, 2]], P),
        local_map("robot2", ["b", "c", "d"], points[[1, 2, 3]], P),
        local_map("robot3", ["a", "e", "f"], points[[0, 4, 5]], P),
        local_map("robot4", ["e", "f", "d"], points[[4, 5, 3]], P),
    ]
    assert len(fuse(pairs).components) == 1


def test_the_same_log_counts_once_and_it_is_told():
    rng = np.random.default_rng(6)
    maps, _, _, _ = team(rng, robots=2)
    maps = [replace(m, log_hash=f"hash {i}") for i, m in enumerate(maps)]
    twice = [*maps, replace(maps[1], robot="robot2b")]
    once, both = fuse(maps), fuse(twice)
    same(once.components[0], both.components[0])
    assert "same log" in both.warnings[0]
    assert [d.decision for d in both.decisions].count("refused") == 1


def test_labels_exchanged_in_one_robot_are_found_and_put_back():
    found = 0
    for draw in range(12):
        rng = np.random.default_rng([7, draw])
        maps, points, _, _ = team(rng, robots=5, landmarks=15, seen=13)
        k = int(rng.integers(5))
        m = maps[k]
        d = np.hypot(*np.moveaxis(m.submap.mean[:, None] - m.submap.mean[None], -1, 0))
        a, b = (int(i) for i in rng.permutation(np.argwhere(d > 1.0))[0])
        ids = list(m.submap.ids)
        ids[a], ids[b] = ids[b], ids[a]
        wrong = [*maps[:k], with_landmarks(m, ids), *maps[k + 1 :]]
        fused = fuse(wrong)
        found += len(fused.warnings) == 1 and f"robot {k + 1}: labels" in fused.warnings[0]
        if fused.warnings:
            assert fused.own_name(m.robot, m.submap.ids[a]) == m.submap.ids[b]
            assert fused.own_name("robot9", m.submap.ids[a]) == m.submap.ids[a]
            assert fused.findings[0].code == "labels-exchanged"
        assert rmse(fused.components[0], points) < 0.25
        assert [x.decision for x in fused.decisions] == ["reference", *["merged"] * 4]
    assert found >= 11


def test_a_landmark_misplaced_in_one_robot_hardly_counts_and_it_is_told():
    rng = np.random.default_rng(8)
    maps, points, _, _ = team(rng, robots=4, landmarks=12, seen=12)
    clean = fuse(maps).components[0]
    mean = maps[1].submap.mean.copy()
    mean[4] += [1.5, -1.0]
    fused = fuse([maps[0], with_landmarks(maps[1], mean=mean), *maps[2:]])
    assert len(fused.warnings) == 1
    assert f"robot 2: landmark {maps[1].submap.ids[4]} lies 1." in fused.warnings[0]
    moved = np.hypot(*(fused.components[0].map.mean - clean.map.mean).T)
    assert moved.max() < 0.06
    assert rmse(fused.components[0], points) < 0.15


def test_two_robots_that_disagree_on_a_landmark_are_both_doubted():
    rng = np.random.default_rng(9)
    maps, _, _, _ = team(rng, robots=2, landmarks=10, seen=10)
    mean = maps[1].submap.mean.copy()
    mean[4] += [1.5, -1.0]
    fused = fuse([maps[0], with_landmarks(maps[1], mean=mean)])
    assert len(fused.warnings) == 2
    assert all("either may be wrong" in w for w in fused.warnings)
    at = 2 * fused.components[0].map.ids.index(maps[1].submap.ids[4])
    assert np.sqrt(fused.components[0].map.cov[at, at]) > 0.5


def test_a_grossly_wrong_map_is_refused_and_the_rest_still_get_theirs():
    rng = np.random.default_rng(10)
    maps, points, _, _ = team(rng, robots=4, landmarks=12, seen=12)
    for bad in range(4):
        mad = with_landmarks(maps[bad], mean=rng.uniform(-5, 5, maps[bad].submap.mean.shape))
        fused = fuse([*maps[:bad], mad, *maps[bad + 1 :]])
        assert len(fused.components[0].robots) == 3
        assert f"robot{bad + 1}" not in fused.components[0].robots
        decision = fused.decisions[bad]
        assert decision.decision == "refused"
        assert "from where the others put them" in decision.reason
        if bad:
            assert rmse(fused.components[0], points) < 0.15


@pytest.mark.parametrize("fault", ["nan", "indefinite", "empty"])
def test_a_map_that_is_no_map_is_refused_with_a_plain_reason(fault):
    rng = np.random.default_rng(11)
    maps, _, _, _ = team(rng, robots=3)
    cov = maps[2].submap.cov[3:, 3:].copy()
    if fault == "nan":
        bad = with_landmarks(maps[2], mean=np.full_like(maps[2].submap.mean, np.nan))
    elif fault == "indefinite":
        bad = with_landmarks(maps[2], cov=cov - 10 * np.eye(len(cov)))
    else:
        bad = local_map("robot3", [], np.zeros((0, 2)), np.zeros((0, 0)))
    fused = fuse([*maps[:2], bad])
    assert fused.components[0].robots == ("robot1", "robot2")
    assert fused.decisions[2].decision == "refused"
    assert fused.decisions[2].reason


def test_one_map_alone_is_its_own_reference():
    rng = np.random.default_rng(12)
    maps, _, _, _ = team(rng, robots=1)
    fused = fuse(maps)
    assert fused.decisions[0].decision == "reference"
    np.testing.assert_allclose(fused.components[0].map.select(maps[0].submap.ids).cov, maps[0].submap.landmarks.cov)
    assert fuse([]).components == ()


def test_the_default_states_an_error_that_is_sane_when_maps_have_scales():
    total, dof = 0.0, 0
    for draw in range(25):
        rng = np.random.default_rng([13, draw])
        maps, points, _, _ = team(rng, robots=4, landmarks=12, seen=9, scale_sigma=0.01)
        a, b = nees(fuse(maps).components[0], points)
        total, dof = total + a, dof + b
    assert 0.7 < total / dof < 1.2


def test_a_fused_map_is_better_than_the_plain_mean_when_maps_are_unequal():
    full, naive = [], []
    for draw in range(20):
        rng = np.random.default_rng([14, draw])
        maps, points, _, _ = team(rng, robots=5, landmarks=12, seen=10, sigma=(0.005, 0.3))
        full.append(rmse(fuse(maps, FuseConfig(weights="full")).components[0], points))
        naive.append(rmse(fuse(maps, FuseConfig(weights="naive")).components[0], points))
    assert np.mean(full) < 0.75 * np.mean(naive)


def test_full_weights_give_what_relative_information_gives_and_repeats_are_told():
    rng = np.random.default_rng(15)
    maps, points, frames, _ = team(rng, robots=4, landmarks=12, seen=9)
    maps = [  # the two forms part only by what is quadratic in the noise
        with_landmarks(m, mean=0.99 * true + 0.01 * m.submap.mean, cov=1e-4 * m.submap.cov[3:, 3:])
        for m, T in zip(maps, frames, strict=True)
        for true in [se2.act(se2.inverse(T), points[[int(i) - 100 for i in m.submap.ids]])]
    ]
    joined = fuse(maps, FuseConfig(weights="full"))
    repeated = fuse(maps, FuseConfig(weights="full", repeats=3))
    a, b = joined.components[0].map, repeated.components[0].map
    np.testing.assert_allclose(a.mean, b.mean, atol=5e-6)
    np.testing.assert_allclose(a.cov, 3 * b.cov, rtol=0.02, atol=1e-9)
    assert "counted 3 times" in repeated.warnings[0]
    assert not joined.warnings
