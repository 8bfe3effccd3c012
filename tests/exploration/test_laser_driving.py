"""Robots with scanners drive without touching anything, and get past each other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapweave.exploration.laser.config import ARCS_APART, LaserPlan
from mapweave.exploration.laser.mission import PlannerState
from mapweave.exploration.laser.planners import predicted_path, steer

from .laser_truth import Team, known_map, room, world_of

CFG = LaserPlan()
ALONE = np.zeros((0, 2))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 60), far=st.floats(0.25, 3.0))
def test_no_command_ever_brings_the_disc_to_a_point_of_the_scan(seed, count, far):
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.201, 0.201 + far, count)
    points = distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    target = rng.uniform(-4, 4, 2)
    command = steer(np.zeros(3), target, points, ALONE, CFG)
    for part in np.linspace(0.0, 1.0, 60):
        shorter = LaserPlan(period=CFG.period * max(part, 1e-9))
        end = predicted_path(np.zeros(3), command, shorter)[-1]
        assert np.hypot(*(points - end).T).min() >= CFG.radius


def test_a_robot_in_the_open_drives_at_full_speed_towards_its_target():
    assert steer(np.zeros(3), np.array([2.0, 0.0]), ALONE, ALONE, CFG) == pytest.approx([CFG.speed, 0.0])


def test_a_robot_turns_on_the_spot_towards_what_lies_behind():
    v, w = steer(np.zeros(3), np.array([-2.0, 0.1]), ALONE, ALONE, CFG)
    assert v <= 0.1
    assert abs(w) == pytest.approx(CFG.turn)


def test_without_a_target_a_robot_stands_still():
    assert steer(np.zeros(3), None, ALONE, ALONE, CFG).tolist() == [0.0, 0.0]


def test_a_robot_never_drives_into_the_way_another_has_chosen():
    other = np.array([[0.7, 0.0], [0.6, 0.0], [0.5, 0.0]])
    command = steer(np.zeros(3), np.array([2.0, 0.0]), ALONE, other, CFG)
    ends = predicted_path(np.zeros(3), command, CFG)
    apart = np.linalg.norm(ends[:, None] - other[None], axis=-1).min()
    assert apart >= min(0.5, 2 * CFG.radius + ARCS_APART) - 1e-6


def exchanged(world, starts, lower, upper, most: int, homes=None) -> Team:
    """The team after everybody has driven to where another began (or to `homes`), on a known map."""
    team = Team(world, starts, lower, upper)
    team.given = known_map(world, lower, upper)
    homes = np.roll(np.array(starts, float)[:, :2], 1, axis=0) if homes is None else np.array(homes)
    team.memory["planner_state"] = PlannerState(home=homes)
    assert team.play("loop", most), "they never got there"
    assert np.hypot(*(team.sim.true_poses[:, :2] - homes).T).max() < 1.0
    assert team.sim.collisions.sum() == 0
    return team


def test_two_robots_head_on_in_a_corridor_pass_each_other():
    world = world_of(*room(0.0, 0.0, 14.0, 2.0))
    exchanged(world, [(1.0, 1.0, 0.0), (13.0, 1.0, np.pi)], (-1, -1), (15, 3), 150)


@pytest.mark.parametrize("offset", [0.0, 0.11])
def test_two_robots_that_meet_in_a_door_get_past_each_other(offset):
    door = 2.5 + offset
    walls = [*room(0.0, 0.0, 10.0, 6.0), (5.0, 0.0, 5.0, door), (5.0, door + 1.0, 5.0, 6.0)]
    middle = door + 0.5
    starts = [(3.0, middle, 0.0), (7.0, middle, np.pi)]
    exchanged(world_of(*walls), starts, (-1, -1), (11, 7), 200)


def test_in_a_narrow_corridor_the_robot_that_can_leaves_it_again():
    walls = [*room(0.0, 0.0, 4.0, 4.0), *room(8.0, 0.0, 12.0, 4.0)]
    walls = [w for w in walls if not (w[0] == w[2] and w[0] in {4.0, 8.0})]
    walls += [(4.0, 0.0, 4.0, 1.5), (4.0, 2.5, 4.0, 4.0), (8.0, 0.0, 8.0, 1.5), (8.0, 2.5, 8.0, 4.0)]
    walls += [(4.0, 1.5, 8.0, 1.5), (4.0, 2.5, 8.0, 2.5)]
    starts = [(3.0, 2.0, 0.0), (9.0, 2.0, np.pi)]
    exchanged(world_of(*walls), starts, (-1, -1), (13, 5), 250)


def test_four_robots_cross_in_one_door():
    walls = [*room(0.0, 0.0, 12.0, 6.0), (6.0, 0.0, 6.0, 2.5), (6.0, 3.5, 6.0, 6.0)]
    starts = [(2.0, 2.0, 0.0), (10.0, 2.0, np.pi), (2.0, 4.0, 0.0), (10.0, 4.0, np.pi)]
    exchanged(world_of(*walls), starts, (-1, -1), (13, 7), 400)


def test_a_robot_with_nothing_to_do_makes_room_in_a_door():
    walls = [*room(0.0, 0.0, 10.0, 6.0), (5.0, 0.0, 5.0, 2.5), (5.0, 3.5, 5.0, 6.0)]
    starts = [(5.0, 3.0, 0.0), (8.0, 3.0, np.pi)]
    team = exchanged(world_of(*walls), starts, (-1, -1), (11, 7), 200, homes=[(5.0, 3.0), (2.0, 3.0)])
    assert team.step > 5
