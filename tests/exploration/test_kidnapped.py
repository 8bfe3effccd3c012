"""Robots among landmarks that are lifted and set down elsewhere: they begin anew, and are found in the map again."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.explore import explore, parse_kidnaps
from mapweave.core.errors import UsageError
from mapweave.exploration.landmarks.config import ExploreConfig, find_scenario
from mapweave.exploration.landmarks.experiment import LandmarkMission, explore_once
from mapweave.fusion.handover import without_frames
from mapweave.landmarks.landmark_map import GlobalMap

KNOWN = ExploreConfig()
KNOWN = replace(KNOWN, submap=replace(KNOWN.submap, association="known"))


def carried(robots, who, step, seed, cfg=KNOWN, until="landmarks"):
    task = LandmarkMission(find_scenario("yuan"), robots, "paper", until, cfg=cfg, kidnaps={who: step})
    return explore_once(task, seed)


@pytest.mark.parametrize(("robots", "who"), [(2, 1), (2, 0), (1, 0)])
def test_a_robot_that_was_carried_away_is_found_in_the_map_again_where_it_is(robots, who):
    runs = [carried(robots, who, 100, seed) for seed in (530, 531, 532)]
    for score, record in runs:
        (told,) = record.carried
        assert told.step == 100
        assert told.back is not None
        assert told.back > 100
        assert score.finished
        assert (score.wrong_meetings, score.missed, score.maps) == (0, 0, 1)
        assert np.isnan(record.moments[100].poses[who]).all()  # nobody knows where it is
        after = record.moments[told.back - 1]
        assert np.hypot(*(after.poses[who] - after.true_poses[who])[:2]) < 3.0
    assert np.mean([score.nees_per_dof for score, _ in runs]) < 1.5


def test_what_it_saw_before_and_after_is_in_one_honest_map_whose_names_are_its_own_again():
    score, record = carried(2, 1, 60, 533, cfg=ExploreConfig())
    assert record.carried[0].back is not None
    assert record.maps == (("robot1", "robot2"),)
    assert record.map.robots == ("robot1", "robot2")
    assert score.nees_per_dof < 2.0
    assert score.map_error < 1.0


def test_the_map_of_a_robot_that_is_carried_off_at_once_is_not_lost():
    """Carried away alone, it still has the map; what it saw from its start is in it."""
    _, record = carried(1, 0, 40, 534, until=41)
    assert len(record.map.ids) >= 1
    assert record.maps == ((), ("robot1",))
    assert record.carried[0].back is None
    assert np.isnan(record.moments[-1].poses).all()


def test_frames_that_leave_a_map_take_nothing_else_along():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(13, 13))
    G = GlobalMap(("a", "b", "c"), rng.normal(size=(3, 3)), ("m", "n"), rng.normal(size=(2, 2)), A @ A.T)
    left = without_frames(G, [1])
    rows = [0, 1, 2, 6, 7, 8, 9, 10, 11, 12]
    assert left.robots == ("a", "c")
    np.testing.assert_array_equal(left.frames, G.frames[[0, 2]])
    np.testing.assert_array_equal(left.cov, G.cov[np.ix_(rows, rows)])
    np.testing.assert_array_equal(without_frames(G, []).cov, G.cov)


def test_kidnaps_are_told_and_those_that_cannot_be_are_refused(tmp_path):
    assert parse_kidnaps(["robot1@5"]) == {"robot1": 5}
    with pytest.raises(UsageError, match="--kidnap: robot1 can be carried away but once"):
        parse_kidnaps(["robot1@5", "robot1@9"])
    for scenario, options in (
        ("yuan", {"kidnap": {"robot7": 3}}),
        ("yuan", {"kidnap": {"robot1": 3}, "radio": 9.0}),
        ("office", {"kidnap": {"robot1": 3}}),
    ):
        with pytest.raises(UsageError, match="--kidnap"):
            explore(scenario, until=1, **options)
    result = explore("yuan", tmp_path / "out", kidnap={"robot2": 4}, until=8)
    assert "robot2: carried away at step 4, and never found in the map again (seed 0)" in result.lines()
    assert "carried away at step 4, and never found" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    told = json.loads((tmp_path / "out" / "metrics.json").read_text())["kidnapped"]
    assert told == [{"robot": "robot2", "step": 4, "back": None}]


def test_a_robot_that_was_dead_or_that_nobody_knew_is_told_as_such():
    dead = explore("yuan", kidnap={"robot2": 4, "robot1": 99}, kill={"robot2": 4}, until=6)
    for robot, step in (("robot2", 4), ("robot1", 99)):
        assert f"{robot}: not carried away at step {step}: it was dead, or the run over (seed 0)" in dead.lines()
    own = explore("yuan", kidnap={"robot1": 4}, unknown_starts=True, until=6).lines()
    assert [line for line in own if "not found in" in line] == [
        f"{robot}: not found in what robot1 mapped before, nor is what they mapped" for robot in ("robot2", "robot1")
    ]
    other = explore("yuan", kidnap={"robot2": 4}, unknown_starts=True, until=6).lines()
    assert [line for line in other if "not found in" in line] == [
        "what a robot mapped before it was carried away: not found in the map of robot1",
        "robot2: not found in the map of robot1, nor is what they mapped",
    ]
