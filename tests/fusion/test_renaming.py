"""A robot that calls landmarks otherwise than the rest is joined under their names; another place never is."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion.alignment import joint_fit, left_out
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse, sure_links
from mapweave.landmarks.landmark_map import LandmarkMap

from .worlds import covariance, rmse, team, with_landmarks

TABLE = [str(100 + i) for i in range(17)]
ALL = len(TABLE)


def misnamed(m, rng, moved):
    """`m` with `moved` names of the table moved round among themselves; and the true name of each of its own."""
    which = rng.choice(ALL, moved, replace=False)
    to = {TABLE[a]: TABLE[b] for a, b in zip(which, np.roll(which, 1), strict=True)}
    own = [to.get(name, name) for name in m.submap.ids]
    return with_landmarks(m, own), dict(zip(own, m.submap.ids, strict=True))


def misnamed_team(rng, robots, seen, moved, who=1):
    maps, points, _, _ = team(rng, robots, ALL, seen)
    maps[who], true = misnamed(maps[who], rng, moved)
    return maps, points, true


@pytest.mark.parametrize(("robots", "moved"), [(2, ALL), (4, ALL), (4, 12), (4, 9), (4, 3), (4, 2)])
def test_a_robot_whose_names_are_permuted_is_joined_under_the_names_of_the_others(robots, moved):
    """Names that move, in whole or in part, one in a hundred of which may be left open, none taken for another."""
    right = left = 0
    for draw in range(4):
        maps, points, true = misnamed_team(np.random.default_rng([1, moved, draw]), robots, ALL, moved)
        fused = fuse(maps)
        assert len(fused.components) == 1
        assert set(fused.labels) == {"robot2"}
        for own, name in fused.labels["robot2"].items():
            assert name in {true[own], f"robot2:{own}"}
            right += name == true[own]
            left += name != true[own]
        if not left:
            assert rmse(fused.components[0], points) < 0.2
    assert right >= 0.95 * 4 * moved


def test_names_that_the_robot_gives_to_landmarks_it_calls_nothing_else_are_mended_too():
    """The robot has seen part of the place: what it calls by a name that moved may bear a name that it has not."""
    right = wrong = asked = 0
    for draw in range(8):
        maps, _, true = misnamed_team(np.random.default_rng([2, draw]), 4, 13, 6)
        held = {name for k, m in enumerate(maps) if k != 1 for name in m.submap.ids}
        labels = fuse(maps).labels.get("robot2", {})
        for own, name in true.items():
            asked += own != name and name in held
            right += own != name and labels.get(own) == name
            wrong += labels.get(own, own) not in {own, name, f"robot2:{own}"}
    assert wrong == 0
    assert right >= 0.6 * asked > 0


def test_the_renaming_is_told_in_words_and_every_name_in_the_labels():
    maps, _, true = misnamed_team(np.random.default_rng(3), 3, ALL, ALL)
    fused = fuse(maps)
    told = next(f for f in fused.findings if f.code == "landmarks-renamed")
    assert told.robot == "2"
    assert f"it calls 100 what the others call {true['100']}, 101 what the others call {true['101']}, " in told.text
    assert told.text.endswith("and 9 more; taken as the same ones")
    assert fused.decisions[1].reason == "shares 17 landmarks with the others, 17 under other names"
    two = fuse(maps[:2])
    told = next(f for f in two.findings if f.code == "landmarks-renamed")
    assert f"it calls 100 what robot 1 calls {true['100']}" in told.text
    assert "(or the other way round: only two see them)" in told.text


def test_two_robots_with_a_table_of_their_own_are_joined_with_the_two_that_have_another():
    rng = np.random.default_rng(4)
    maps, points, _, _ = team(rng, 4, ALL, ALL)
    to = dict(zip(TABLE, np.roll(TABLE, 5), strict=True))
    maps[2:] = [with_landmarks(m, [to[name] for name in m.submap.ids]) for m in maps[2:]]
    fused = fuse(maps)
    assert len(fused.components) == 1
    assert set(fused.labels) == {"robot3", "robot4"}
    assert rmse(fused.components[0], points) < 0.2


@pytest.mark.parametrize(("landmarks", "seen", "sigma"), [(17, 17, (0.01, 0.05)), (12, 8, (0.02, 0.2))])
def test_no_two_places_that_use_the_same_names_are_joined_under_others(landmarks, seen, sigma):
    for draw in range(20):
        rng = np.random.default_rng([5, landmarks, draw])
        here, _, _, _ = team(rng, 1, landmarks, seen, sigma=sigma)
        there, _, _, _ = team(rng, 1, landmarks, seen, sigma=sigma)
        fused = fuse([*here, replace(there[0], robot="robot2")])
        assert not any(f.code == "landmarks-renamed" for f in fused.findings)


def lattice(rng, columns, rows, share):
    """Places 2 m apart in rows, a `share` of them, in any order."""
    at = 2.0 * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return at[rng.permutation(len(at))[: int(share * len(at))]]


@pytest.mark.parametrize(("columns", "rows", "share"), [(4, 4, 1.0), (4, 5, 1.0), (5, 5, 0.6), (1, 12, 1.0)])
def test_landmarks_in_rows_prove_nothing_and_are_never_renamed_wrongly(columns, rows, share):
    for draw in range(5):
        rng = np.random.default_rng([6, columns, rows, draw])
        truth = [lattice(rng, columns, rows, share) for _ in range(2)]
        here, _, _, _ = team(rng, 1, len(truth[0]), len(truth[0]), truth=truth[0])
        there, _, _, _ = team(rng, 1, len(truth[1]), len(truth[1]), truth=truth[1])
        fused = fuse([*here, replace(there[0], robot="robot2")])
        assert not any(f.code == "landmarks-renamed" for f in fused.findings)


def test_few_landmarks_in_common_are_refused_with_the_names_that_contradict():
    rng = np.random.default_rng(7)
    points = rng.uniform(-5, 5, (5, 2))
    maps, _, _, _ = team(rng, 2, 5, 5, truth=points)
    maps[1] = with_landmarks(maps[1], np.roll(maps[1].submap.ids, 2))
    fused = fuse(maps)
    assert len(fused.components) == 2
    assert "contradicts robot1" in fused.decisions[1].reason


def test_names_are_left_where_names_agree_and_where_they_are_known_to_mean_nothing():
    maps, _, _ = misnamed_team(np.random.default_rng(8), 3, ALL, ALL)
    straight, _, _, _ = team(np.random.default_rng(8), 3, ALL, ALL)
    assert not fuse(straight).labels
    unknown = fuse(maps, FuseConfig(identities="unknown"))
    assert not any(f.code == "landmarks-renamed" for f in unknown.findings)


def test_a_link_that_two_landmarks_may_be_is_not_sure():
    rng = np.random.default_rng(9)
    points = np.vstack([rng.uniform(-5, 5, (10, 2)), [[9.0, 0.0], [9.03, 0.0]]])
    P = 0.03**2 * np.eye(24)
    T = np.array([1.0, -2.0, 0.7])
    one = LandmarkMap(tuple(TABLE[:12]), points, P)
    two = LandmarkMap(tuple(TABLE[:12]), se2.act(T, points), P)
    links = sure_links(one, two, FuseConfig())
    assert (links[:, 0] == links[:, 1]).all()
    assert set(links[:, 0]) == set(range(10))


def test_what_is_left_of_a_link_is_what_all_others_leave_of_it():
    """Against the joint fit of all other links, and the covariance that is propagated from it."""
    rng = np.random.default_rng(10)
    points = rng.uniform(-4, 4, (7, 2))
    P = covariance(rng, points)
    one = LandmarkMap(tuple(TABLE[:7]), points, P)
    two = LandmarkMap(tuple(TABLE[:7]), points + rng.normal(0, 0.05, points.shape), np.diag(np.diag(P)))
    links = np.stack([np.arange(7)] * 2, axis=1)
    fit = joint_fit(one, two, links, np.zeros(3), 0.01, 0.02)
    r, V = left_out(one, two, links, fit, 0.01, 0.02)
    np.testing.assert_allclose(np.einsum("ki,kij,kj->k", r, np.linalg.inv(V), r), fit.single, rtol=1e-6)
    for k in range(7):
        rest = joint_fit(one, two, np.delete(links, k, axis=0), np.zeros(3), 0.01, 0.02)
        assert fit.chi2 - rest.chi2 == pytest.approx(fit.single[k], rel=0.05, abs=0.02)
