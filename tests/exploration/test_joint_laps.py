"""Laps that a whole team plans together before it starts."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.exploration.landmarks import laps as lap_search
from mapweave.exploration.landmarks.config import ExploreConfig, LapSearchConfig
from mapweave.exploration.landmarks.laps import LapJudge, LapTask, Past, _least_detour, find_laps, revise_laps
from mapweave.landmarks.submap_slam import SubmapConfig

TASK = LapTask(
    lower=(-30.0, -25.0),
    upper=(30.0, 25.0),
    starts=((-3.0, 0.0, np.pi), (3.0, 0.0, 0.0)),
    controls=tuple(map(tuple, ExploreConfig().controls)),
    submap=SubmapConfig(),
    steps=70,
    density=1 / 275,
    error_weight=80.0,
    search=LapSearchConfig(tries=40),
    looks=1,
    sight_margin=0.0,
)


def test_the_same_task_gives_the_same_laps_and_places_lie_in_the_field():
    first, end = find_laps(TASK)
    find_laps.cache_clear()
    again, _ = find_laps(TASK)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert len(first) == 2
    assert end >= TASK.steps
    assert all(np.all(np.abs(lap) <= TASK.upper) for lap in first)


def test_trying_more_plans_never_makes_the_plan_dearer():
    judge = LapJudge(TASK, 8)
    start = min(lap_search._first_plans(TASK), key=judge)
    rng = np.random.default_rng(0)
    cost, plan = lap_search._improve(start, judge, 60, rng)
    assert cost == judge(plan)
    assert cost <= judge(start)


def test_first_plans_go_round_the_border_in_equal_shares_for_any_team():
    for starts in (((0.0, 0.0, 0.0),), tuple((np.cos(a), np.sin(a), a) for a in (0.1, 2.0, 4.0))):
        plans = lap_search._first_plans(replace(TASK, starts=starts))
        for ways, counts in plans:
            assert len(counts) == len(starts)
            assert np.all(np.abs(ways) <= TASK.upper)
            assert counts.min() >= 2
        ways, counts = plans[0]
        begins = np.arctan2(ways[:, 0, 1] / 25.0, ways[:, 0, 0] / 30.0)
        assert len(set(begins.round(6))) == len(starts)


def test_laps_are_changed_for_the_landmarks_that_turn_out_to_be_there():
    """Half way, with everything seen: what is left of the laps goes where the known landmarks are."""
    laps, _ = find_laps(TASK)
    judge = LapJudge(TASK, 1)
    plan = lap_search._plan(laps, 12)
    trail = judge.drive(plan)[:, :36]
    marks = np.array([[-6.0, 4.0], [5.0, -5.0], [-25.0, 0.0], [25.0, 3.0], [0.0, 20.0], [0.0, -20.0]])
    live = np.array([True, True])
    past = Past(trail, marks, np.ones_like(judge.past.explored), live)
    now = LapJudge(TASK, 4, past)
    task = replace(TASK, search=LapSearchConfig(tries_by_now=60))
    better, end = revise_laps(task, past, laps)
    again, _ = revise_laps(task, past, laps)
    assert end >= TASK.steps
    assert all(np.array_equal(a, b) for a, b in zip(better, again, strict=True))
    before, after = (now.error(now.drive(lap_search._plan(some, 12))) for some in (laps, better))
    assert after < 0.95 * before


def test_a_dead_robot_is_given_no_place():
    laps, _ = find_laps(TASK)
    judge = LapJudge(TASK, 1)
    trail = judge.drive(lap_search._plan(laps, 12))[:, :20]
    past = Past(trail, np.array([[0.0, 5.0]]), judge.past.explored, np.array([True, False]))
    task = replace(TASK, search=LapSearchConfig(tries_by_now=40))
    (first, second), _ = revise_laps(task, past, (laps[0], np.zeros((0, 2))))
    assert len(second) == 0
    assert len(first) > 0


@pytest.mark.parametrize(("place", "k"), [([0.5, 0.1], 0), ([1.9, 1.0], 1), ([1.0, 2.1], 2), ([-1.0, 2.0], 3)])
def test_a_place_is_put_in_where_it_makes_the_way_least_longer_or_last(place, k):
    way = np.array([[2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    assert _least_detour(np.zeros(2), way, np.array(place)) == k
