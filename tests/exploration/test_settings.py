"""Planner thresholds are configuration: every one is explained, can be set from a file, and reaches its planner."""

import inspect
import re
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from mapweave.core.config import build
from mapweave.exploration import world
from mapweave.exploration.landmarks import config as landmarks
from mapweave.exploration.landmarks import coverage, objective
from mapweave.exploration.landmarks.config import ExploreConfig, ScenarioConfig, make_field
from mapweave.exploration.landmarks.coverage import approach_cost
from mapweave.exploration.landmarks.objective import steer
from mapweave.exploration.landmarks.team import Team
from mapweave.exploration.laser import config as laser
from mapweave.exploration.laser import planners
from mapweave.exploration.laser.config import LaserMissionConfig, LaserPlan
from mapweave.exploration.laser.planners import candidate_commands
from mapweave.exploration.laser.planners import steer as follow


@pytest.mark.parametrize("module", [landmarks, laser, world])
def test_every_setting_says_what_it_means(module):
    """Each field but tables has a comment of more than a unit."""
    own = [c for c in vars(module).values() if is_dataclass(c) and c.__module__ == module.__name__]
    lines = [line for c in own for line in inspect.getsource(c).splitlines() if re.match(r"    \w+: .* = ", line)]
    assert lines
    tables = re.compile(r"= (field\(default_factory=)?\w+Config(\(\)|\))$")
    assert [
        line for line in lines if not tables.search(line) and not re.search(r"  # (\[.*?\])?.*[a-z]{3}", line)
    ] == []


def values(cfg):
    """The configuration as a file would hold it."""
    out = {}
    for f in fields(cfg):
        value = getattr(cfg, f.name)
        if value is not None:
            out[f.name] = values(value) if is_dataclass(value) else value
    return out


@pytest.mark.parametrize("kind", [ExploreConfig, LaserMissionConfig])
def test_a_file_that_holds_every_default_changes_nothing(kind):
    assert build(kind, values(kind())) == kind()


def test_what_a_wrong_heading_costs_decides_whether_a_robot_turns_first(monkeypatch):
    cfg = ExploreConfig()
    team = Team(make_field(ScenarioConfig(landmarks=3), 1, 0), cfg, coverage.choose, np.random.default_rng(0))
    pose, goal = np.zeros(3), np.array([0.0, 10.0])
    assert steer(team.belief(), pose, goal, cfg)[1] == max(cfg.commands.turns)
    monkeypatch.setattr(objective, "STEERING_HEADING_COST", 50.0)
    strict = steer(team.belief(), pose, goal, cfg)[0]
    monkeypatch.setattr(objective, "STEERING_HEADING_COST", 0.01)
    assert strict <= steer(team.belief(), pose, goal, cfg)[0]
    assert steer(team.belief(), pose, np.array([10.0, 0.1]), cfg)[0] == max(cfg.commands.speeds)


def test_turning_towards_a_place_costs_what_is_set():
    behind = np.array([[-5.0, 0.0]])
    for cost in (0.0, 2.0):
        np.testing.assert_allclose(approach_cost(np.zeros((1, 3)), behind, cost), 5.0 + cost * np.pi)


def test_robots_drive_backwards_a_third_as_fast_and_only_where_it_is_worth_it(monkeypatch):
    cfg = LaserPlan()
    assert candidate_commands(cfg)[0][:, 0].min() == pytest.approx(-cfg.speed / 3)
    behind, nobody = np.array([-0.15, 0.0]), np.zeros((0, 2))
    assert follow(np.zeros(3), behind, nobody, nobody, cfg)[0] < 0.0
    monkeypatch.setattr(planners, "REVERSE_COST", 2.0)
    assert follow(np.zeros(3), behind, nobody, nobody, cfg)[0] >= 0.0
    monkeypatch.setattr(planners, "REVERSE_SPEED", 0.1)
    assert candidate_commands.__wrapped__(cfg)[0][:, 0].min() == pytest.approx(-0.1 * cfg.speed)
