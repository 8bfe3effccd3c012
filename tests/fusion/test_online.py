"""Fusing while maps grow: the last map is the one that fusing at the end gives, and nothing counts twice."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.fusion import online
from mapweave.fusion.join import fuse
from mapweave.fusion.online import OnlineFuser

from .worlds import local_map, team, with_landmarks


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


@pytest.fixture
def five():
    return team(np.random.default_rng(21), robots=5, landmarks=14, seen=9)[0]


def seen_so_far(m, n):
    """The map when its robot had mapped `n` landmarks."""
    part = m.submap.landmarks.select(m.submap.ids[:n])
    return replace(local_map(m.robot, part.ids, part.mean, part.cov), log_hash=m.robot)


def assert_near(fuser, maps, tolerance=0.01):
    """Near what fusing all at once gives, which finds every map's variance as well."""
    whole = fuse(maps).components[0]
    assert fuser.largest.robots == whole.robots
    assert fuser.largest.map.ids == whole.map.ids
    np.testing.assert_allclose(fuser.largest.map.mean, whole.map.mean, atol=tolerance)
    for robot, frame in whole.frames.items():
        np.testing.assert_allclose(se2.between(frame, fuser.largest.frames[robot]), 0, atol=tolerance)


def test_a_robot_more_is_tied_in_without_judging_all_anew(five):
    fuser = OnlineFuser().update(*five[1:]).grown(five[0])  # robot1, in whose first pose the map stands from now on
    assert (fuser.judged, fuser.tied_in) == (1, 5)
    assert [d.decision for d in fuser.fusion.decisions] == ["reference", *["merged"] * 4]
    assert_near(fuser, five)


def test_a_landmark_more_is_put_into_the_map_without_judging_all_anew(five):
    before = [seen_so_far(m, 8) for m in five]
    now = [replace(m, log_hash=m.robot) for m in five]
    fuser = OnlineFuser().update(*before).grown(*now)
    assert fuser.judged == 1
    assert_near(fuser, now)


def test_two_parts_are_one_when_what_both_have_seen_shows_it_and_nothing_is_judged(five):
    ids = sorted(set(five[0].submap.ids) & set(five[1].submap.ids))[:1]
    apart = [seen_so_far(with_landmarks(m), 9) for m in five[:2]]
    own = [n for n in apart[1].submap.ids if n not in apart[0].submap.ids]
    alone = local_map("robot2", [*own, *ids], *_of(apart[1], [*own, *ids]), log_hash="robot2")
    fuser = OnlineFuser().update(apart[0], alone)
    assert fuser.tied_in == 1
    fuser = fuser.grown(apart[1])
    assert (fuser.judged, fuser.tied_in) == (1, 2)
    assert_near(fuser, apart)


def _of(m, ids):
    part = m.submap.landmarks.select(ids)
    return part.mean, part.cov


def test_a_landmark_that_one_fresh_map_misplaces_hardly_counts_and_all_are_to_be_judged(five):
    hashed = [replace(m, log_hash=m.robot) for m in five]
    fuser = OnlineFuser().update(*hashed)
    assert not fuser.due
    name = next(n for n in five[4].submap.ids if all(n in m.submap.ids for m in five[2:]))
    k = five[4].submap.ids.index(name)
    mean = np.array(five[4].submap.mean)
    mean[k] += 3.0
    wrong = replace(with_landmarks(five[4], mean=mean), log_hash="robot5")
    grown = fuser.grown(wrong)
    assert (grown.judged, grown.due) == (1, True)
    assert [f.code for f in grown.fusion.findings] == ["landmark-elsewhere"]
    place = [c.map.mean[c.map.ids.index(name)] for c in (fuser.largest, grown.largest)]
    assert np.hypot(*(place[1] - place[0])) < 0.1
    assert not grown.grown(*hashed).fusion.findings


def test_a_robot_that_is_taken_out_leaves_the_map_of_the_others(five):
    fuser = OnlineFuser().grown(*five).without(["robot3"]).grown()
    assert fuser.largest.robots == ("robot1", "robot2", "robot4", "robot5")
    assert_near(fuser, [m for m in five if m.robot != "robot3"])


def test_who_came_while_all_was_judged_stays_where_it_was_tied(five):
    begun = OnlineFuser().grown(*five[:3])
    meanwhile = begun.grown(*five[3:])
    fuser = begun.converged().caught_up(meanwhile).grown()
    assert (fuser.judged, fuser.tied_in) == (1, 5)
    assert not fuser.tried  # nobody had to be asked again
    assert_near(fuser, five)


def test_a_map_that_lost_landmarks_or_is_of_another_run_waits_until_all_are_judged(five):
    hashed = [replace(m, log_hash=m.robot) for m in five]
    fuser = OnlineFuser().update(*hashed)
    for other in (seen_so_far(five[4], 3), replace(five[4], log_hash="another run")):
        grown = fuser.grown(other)
        assert grown.due
        assert grown.largest.robots == fuser.largest.robots
        np.testing.assert_allclose(grown.largest.map.mean, fuser.largest.map.mean, atol=1e-6)
        assert grown.converged().latest["robot5"] is other


def test_the_sum_does_not_grow_with_robots():
    maps = team(np.random.default_rng(22), robots=30, landmarks=10, seen=6)[0]
    fuser = OnlineFuser().grown(*maps)
    assert fuser.tied_in == 30
    assert {term.S.shape for term in fuser.sums[0].terms.values()} == {(12, 12)}
    assert_near(fuser, maps, 0.02)


def test_what_one_robot_claims_to_have_seen_keeps_nobody_from_judging(five):
    def seen(m, n):
        return replace(m, log_hash=m.robot, sightings=dict.fromkeys(m.submap.ids, n))

    claimed = seen(five[4], 2**53)
    fuser = OnlineFuser().update(*(seen(m, 10) for m in five[:4]), claimed)
    assert not fuser.grown(*(seen(m, 11) for m in five[:4])).due
    assert fuser.grown(*(seen(m, 15) for m in five[:4])).due
    assert not OnlineFuser().update(*(seen(m, 10) for m in five)).grown(seen(five[4], 20)).due


def test_a_map_that_is_none_is_judged_once_and_the_others_go_on(five):
    hashed = [replace(m, log_hash=m.robot) for m in five]
    none = replace(with_landmarks(five[4], cov=np.zeros((18, 18))), log_hash="robot5")
    fuser = OnlineFuser().update(*hashed).grown(none)
    assert fuser.due
    fuser = fuser.converged().grown(none)
    assert not fuser.due
    assert fuser.largest.robots == tuple(m.robot for m in five[:4])
    assert fuser.fusion.decisions[4].reason == "its covariance is not positive definite"


def test_a_map_that_comes_to_contradict_the_others_is_out_of_theirs_before_all_are_judged(five):
    hashed = [replace(m, log_hash=m.robot) for m in five]
    fuser = OnlineFuser().update(*hashed)
    mean = np.random.default_rng(0).uniform(-9, 9, (9, 2))
    wrong = replace(with_landmarks(five[0], mean=mean), log_hash="robot1")  # it was the map's frame
    grown = fuser.grown(wrong)
    assert grown.largest.robots == ("robot2", "robot3", "robot4", "robot5")
    assert_near(grown, five[1:])
    assert not any(f.robot != "robot1" for f in grown.fusion.findings)
    assert grown.due
    assert_near(grown.grown(*hashed).converged(), five)


def test_maps_that_no_sum_holds_are_judged_all_the_same(five, monkeypatch):
    monkeypatch.setattr(online, "ROUNDS", 0)
    fuser = OnlineFuser().update(*five)
    assert fuser.judged == 1
    np.testing.assert_array_equal(fuser.largest.map.mean, fuse(five).components[0].map.mean)
    assert fuser.update(*five).judged == 2
