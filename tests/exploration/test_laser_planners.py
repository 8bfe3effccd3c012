"""Teams with scanners map whole offices, whatever the planner, and never touch anything."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapweave.core.errors import UsageError
from mapweave.exploration.laser.config import LaserPlan
from mapweave.exploration.laser.frontiers import frontiers, mapped_ground
from mapweave.exploration.laser.mission import PlannerState, route_to
from mapweave.exploration.laser.planners import (
    allocation_problem,
    by_tours,
    halved,
    keep_commitments,
    nearest_first,
)
from mapweave.exploration.planner_interface import find_planner, planners
from mapweave.kernels.exploration.wavefront import NO_LIMIT, UNREACHED, spread
from mapweave.laser.occupancy_mapper import FREE, OCCUPIED, UNKNOWN, Occupancy
from mapweave.sim.laser_worlds import office_floor

from .laser_truth import Team, room, world_of

CFG = LaserPlan()


def office_team(area: float, seed: int, robots: int) -> Team:
    floor = office_floor(area, seed)
    return Team(floor.world, floor.starts[:robots], floor.lower, floor.upper, seed=seed)


@pytest.mark.parametrize("planner", planners("laser"))
def test_every_planner_maps_a_whole_office_without_a_touch(planner):
    team = office_team(300, 1, 2)
    assert team.play(planner, 900)
    assert team.mapped() >= 0.99
    assert team.sim.collisions.sum() == 0


def test_the_loop_planner_ends_where_it_began():
    team = office_team(300, 2, 2)
    assert team.play("loop", 900)
    assert np.hypot(*(team.sim.true_poses - team.sim.starts)[:, :2].T).max() < 1.0


@pytest.mark.slow
def test_more_robots_need_fewer_steps():
    steps = []
    for robots in (1, 3):
        team = office_team(500, 0, robots)
        assert team.play("coverage", 1500)
        assert team.mapped() >= 0.99
        steps.append(team.step)
    assert steps[1] < 0.6 * steps[0]


def test_the_others_finish_when_a_robot_dies():
    team = office_team(300, 3, 3)
    team.play("coverage", 40)
    team.alive[1] = False
    assert team.play("coverage", 1200)
    assert team.mapped() >= 0.99
    assert team.sim.collisions.sum() == 0


def test_what_lies_behind_a_dead_robot_in_the_only_door_is_left_and_the_run_ends():
    walls = [*room(0.0, 0.0, 12.0, 6.0), (6.0, 0.0, 6.0, 2.5), (6.0, 3.5, 6.0, 6.0)]
    walls += [(8.0, 2.0, 8.0, 6.0)]
    team = Team(world_of(*walls), [(6.0, 3.0, np.pi), (2.0, 3.0, 0.0)], (0, 0), (12, 6))
    team.alive[0] = False
    assert team.play("coverage", 400)
    assert team.mapped() < 0.9
    assert team.sim.collisions.sum() == 0


def test_a_frontier_that_never_goes_away_is_given_up_and_told():
    """A map that stays as it is: robots get to its frontiers, see nothing new, and stop trying after a while."""
    team = Team(world_of(*room(0.0, 0.0, 6.0, 4.0)), [(1.0, 1.0, 0.0)], (0, 0), (6, 4))
    state = np.full((20, 30), FREE)
    state[[0, -1]], state[:, [0, -1]], state[8:14, 18:24] = OCCUPIED, OCCUPIED, UNKNOWN
    team.given = Occupancy(0.2, np.zeros(2), state)
    assert team.play("coverage", 1500)
    assert len(team.memory["given_up"]) >= 1


def offers_in_a_hall(places: list[tuple[float, float]], *, width: float = 30.0):
    """Robots at `places` in a hall with patches of unknown ground in a row along it."""
    rows, cols = 20, int(width / 0.2)
    state = np.full((rows, cols), FREE)
    state[[0, -1]], state[:, [0, -1]] = OCCUPIED, OCCUPIED
    for x in range(10, cols - 8, 20):
        state[9:12, x : x + 3] = UNKNOWN
    grid, poses = Occupancy(0.2, np.zeros(2), state), np.array([(*p, 0.0) for p in places])
    ground = mapped_ground(grid, poses[:, :2], np.zeros((0, 2)), CFG)
    state = PlannerState(still=np.zeros(len(places), int))
    return allocation_problem(ground, frontiers(ground), state, poses, np.arange(len(places)), CFG)


def test_tours_send_robots_to_different_sides():
    problem = offers_in_a_hall([(14.5, 2.0), (15.5, 2.0)])
    chosen = by_tours(problem, CFG)
    first, second = (problem.pieces[chosen[j]].place[0] for j in (0, 1))
    assert (first - 15.0) * (second - 15.0) < 0


def test_no_two_robots_get_the_same_frontier():
    problem = offers_in_a_hall([(3.0, 1.0), (3.0, 3.0), (4.0, 2.0)])
    for allocate in (by_tours, nearest_first):
        chosen = allocate(problem, CFG)
        assert len(chosen) == 3
        assert len(set(chosen.values())) == 3


def test_a_robot_on_its_way_changes_its_mind_only_for_what_is_nearer_or_on_the_way():
    problem = replace(offers_in_a_hall([(15.0, 2.0)]), held={0: 0})
    far = int(np.argmax(problem.first[0]))
    near = int(np.argmin(problem.first[0]))
    held = int(np.argmin(np.abs(problem.first[0] - problem.first[0, far] + 1.0)))
    assert keep_commitments(replace(problem, held={0: held}), {0: far}) == {0: held}
    assert keep_commitments(replace(problem, held={0: held}), {0: near}) == {0: near}


def test_a_robot_leaves_its_frontier_to_a_nearer_one():
    problem = offers_in_a_hall([(3.0, 2.0), (15.0, 2.0)])
    left = int(np.argmin(problem.first[0]))
    right = int(np.argmax(problem.first[0]))
    assert keep_commitments(replace(problem, held={1: left}), {0: left, 1: right}) == {0: left, 1: right}


def test_a_planner_of_ones_own_is_found_by_its_dotted_name():
    assert find_planner("mapweave.exploration.laser.planners:coverage", "laser") is find_planner("coverage", "laser")
    with pytest.raises(UsageError, match="best"):
        find_planner("best", "laser")


def test_shares_go_by_lengths_that_are_nearly_those_of_the_ways():
    problem = offers_in_a_hall([(3.0, 1.0)])
    for n, piece in enumerate(problem.pieces):
        exact = route_to(problem.ground, piece.place, np.zeros((0, 2)), CFG).metres_from(problem.poses[:, :2])[0]
        assert problem.first[0, n] == pytest.approx(exact, rel=0.1, abs=2.5)


def test_a_wall_stays_shut_over_cells_twice_as_large():
    for at in range(6, 12):
        weight = np.ones((16, 20), dtype=np.uint8)
        weight[:, at : at + 3] = 0
        cost = spread(halved(weight), np.array([[2, 1]]), NO_LIMIT)
        assert (cost[:, 8:] == UNREACHED).all()


def test_the_planner_that_the_documentation_shows_maps_an_office():
    text = (Path(__file__).parents[2] / "docs" / "methods" / "active-exploration.md").read_text(encoding="utf-8")
    example = text.partition("## Laser worlds: planning")[2].partition("```python\n")[2].partition("```")[0]
    names = {}
    exec(example, names)  # noqa: S102  (what a reader would run)
    team = office_team(300, 4, 2)
    assert team.play(names["choose"], 900)
    assert team.mapped() >= 0.99
    assert team.sim.collisions.sum() == 0
