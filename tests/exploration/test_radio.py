"""Robots whose radio reaches so far alone: they part with what they know, and meet again without counting it twice."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.explore import explore
from mapweave.core.errors import UsageError
from mapweave.exploration.landmarks.belief import parted, united
from mapweave.exploration.landmarks.config import ExploreConfig, MissionConfig, find_scenario, make_field
from mapweave.exploration.landmarks.experiment import LandmarkMission, explore_once
from mapweave.exploration.landmarks.team import RENDEZVOUS_PATIENCE, Team
from mapweave.exploration.planner_interface import find_planner

KNOWN = ExploreConfig()
KNOWN = replace(KNOWN, submap=replace(KNOWN.submap, association="known"))


def mission(robots=2, radio=20.0, **options):
    options = {"until": "landmarks", "cfg": KNOWN} | options
    return LandmarkMission(find_scenario("yuan"), robots, "paper", radio=radio, **options)


def made(robots=2, radio=20.0, seed=1, cfg=KNOWN):
    world = make_field(find_scenario("yuan"), robots, seed)
    rng = np.random.default_rng(seed)
    team = Team(world, cfg, find_planner("paper", "landmarks"), rng, radio=radio)
    team.observe_start()
    return team


def test_a_radio_that_reaches_everywhere_changes_nothing():
    far, (_, any_) = explore_once(mission(radio=1000.0), 3), explore_once(mission(radio=np.inf), 3)
    score, record = far
    assert score.in_touch == 1.0
    np.testing.assert_array_equal(record.map.mean, any_.map.mean)
    np.testing.assert_array_equal(record.map.cov, any_.map.cov)
    assert len(record.moments) == len(any_.moments)


def test_robots_that_parted_and_met_have_the_map_of_all_submaps_and_count_none_twice():
    team = made(seed=4)
    sizes = set()
    for _ in team.play():
        sizes.add(len(team.crews))
        if len(sizes) > 1 and len(team.crews) == 1 and team.step > 100:
            break
    assert sizes == {1, 2}
    (crew,) = team.crews
    handed = dict(crew.handed)
    assert {j for _, j in handed} == {0, 1}
    alone = [parted(crew, np.array([True, False])), parted(crew, np.array([False, True]))]
    for k, one in enumerate(alone):
        one.handed = {key: value for key, value in handed.items() if key[1] == k or key[0] < 60}
    both = np.ones(2, dtype=bool)
    one, other = (united(crews, both, None) for crews in (alone, alone[::-1]))
    np.testing.assert_array_equal(one.G.cov, other.G.cov)  # the order in which they meet does not matter
    assert one.handed.keys() == handed.keys()
    again = united([one, other], both, None)  # nor that they meet twice
    np.testing.assert_array_equal(again.G.cov, one.G.cov)
    place = [one.G.ids.index(name) for name in crew.G.ids]
    np.testing.assert_allclose(one.G.mean[place], crew.G.mean, atol=0.05)  # linearised in another order
    assert one.truth.safe == crew.truth.safe


def test_maps_of_teams_that_part_and_meet_are_honest():
    runs = [explore_once(mission(4, 30.0), seed)[0] for seed in range(520, 526)]
    assert all(r.finished for r in runs)
    assert all(r.in_touch < 0.9 for r in runs)
    assert all(r.missed == 0 for r in runs)
    assert 0.7 < np.mean([r.nees_per_dof for r in runs]) < 1.3


def test_a_robot_in_between_hands_on_what_it_hears():
    team = made(robots=3)
    team.truth.poses[:, :2] = [[-30.0, 0.0], [0.0, 0.0], [30.0, 0.0]]
    team.radio = 31.0
    team._exchange()
    assert [crew.members.tolist() for crew in team.crews] == [[0, 1, 2]]
    team.alive[1] = False
    team._exchange()
    assert [crew.members.tolist() for crew in team.crews] == [[0], [2]]
    assert not team.belief(team.crews[0]).alive[2]
    assert team.belief(team.crews[0]).away.tolist() == [False, True, True]


def test_a_robot_out_of_touch_knows_nothing_of_the_others_since():
    team = made(seed=2)
    play = team.play()
    while len(team.crews) == 1:
        next(play)
    crew, seen = team.crews[0], team.crews[0].explored.pending[1].copy()
    for _ in range(5):
        next(play)
    assert team.crews[0] is crew
    np.testing.assert_array_equal(crew.explored.pending[1], seen)
    assert team.belief(crew).submaps[1].ids == ()
    assert np.isnan(team._placed()[1]).all()


@pytest.mark.parametrize("until", ["landmarks", "field"])
def test_of_a_robot_that_died_out_of_touch_nobody_waits_for_ever(until):
    score, record = explore_once(mission(kills={1: 60}, until=until), 5)
    assert score.finished
    assert score.missed == 0
    last = record.moments[-1]
    assert last.step < 800
    waiting = sum((m.commands[0] == 0.0).all() for m in record.moments)
    assert waiting <= 2 * RENDEZVOUS_PATIENCE + 2


def test_when_all_robots_die_the_run_ends():
    score, record = explore_once(mission(kills={0: 3, 1: 3}), 5)
    assert not score.finished
    assert record.moments[-1].step == 4


def test_where_a_rendezvous_is_agreed_robots_come_back_to_it():
    cfg = replace(KNOWN, mission=MissionConfig(rendezvous=40))
    _, record = explore_once(mission(radio=8.0, cfg=cfg, until=200), 7)
    apart = [np.hypot(*np.subtract(*m.true_poses[:, :2])) for m in record.moments]
    assert max(apart[20:40]) > 15.0
    met = [k for k, d in enumerate(apart) if d <= 8.0 and k > 40]
    assert met
    assert np.hypot(*record.moments[met[0]].true_poses[0, :2]) < 15.0


def test_a_radio_that_cannot_be_is_refused(tmp_path):
    for radio in (0.0, -3.0, float("nan")):
        with pytest.raises(UsageError, match="--radio"):
            explore("yuan", radio=radio, until=1)
    with pytest.raises(UsageError, match="--radio"):
        explore("office", radio=5.0, until=1)
    with pytest.raises(UsageError, match="--radio"):
        explore("yuan", radio=5.0, unknown_starts=True, until=1)
    result = explore("yuan", tmp_path / "out", radio=12.0, until=30)
    assert result.metrics["radio_m"] == 12.0
    assert "radio of 12 m: all robots in touch in" in "\n".join(result.lines())
