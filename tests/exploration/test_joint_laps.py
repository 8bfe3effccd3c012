"""Laps that a whole team plans together before it starts."""

from dataclasses import replace

import numpy as np

from mapweave.exploration.landmarks import lap_search
from mapweave.exploration.landmarks.config import ExploreConfig, LapSearchConfig
from mapweave.exploration.landmarks.lap_search import LapTask, find_laps
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
    heading_cost=ExploreConfig().steering.heading_cost,
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
    judge = lap_search._Judge(TASK, 8)
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
