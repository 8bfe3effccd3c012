"""What a frontier is: known ground that a robot gets to, beside unknown ground it might get to."""

import numpy as np
import pytest

from mapweave.exploration.laser import frontiers as laser_frontiers
from mapweave.exploration.laser.config import LaserPlan
from mapweave.exploration.laser.frontiers import FRONTIER_SPLIT, frontiers, mapped_ground, pockets
from mapweave.laser.occupancy_mapper import FREE, OCCUPIED, UNKNOWN, Occupancy

CFG = LaserPlan()
NOBODY = np.zeros((0, 2))


def drawn(*rows: str) -> Occupancy:
    """A map from a drawing, the top row last in y: `.` free, `#` occupied, space unknown; cells of 0.2 m."""
    state = {".": FREE, "#": OCCUPIED, " ": UNKNOWN}
    return Occupancy(0.2, np.zeros(2), np.array([[state[c] for c in row] for row in rows[::-1]]))


def box(inside: str, rows: int = 9) -> Occupancy:
    wall = "#" * (len(inside) + 2)
    return drawn(wall, *[f"#{inside}#"] * rows, wall)


def found(grid: Occupancy, *at: tuple[float, float]):
    return frontiers(mapped_ground(grid, np.array(at), NOBODY, CFG))


def test_known_ground_within_walls_has_no_frontier():
    assert found(box("." * 12), (1.0, 1.0)) == []


def test_a_frontier_lies_on_free_cells_beside_unknown_ones():
    pieces = found(box("." * 8 + " " * 8), (0.6, 1.0))
    assert len(pieces) == 1
    assert pieces[0].place[0] == pytest.approx(0.2 * 8.5)
    assert np.allclose(pieces[0].unknown[:, 0], 0.2 * 9.5)


def test_no_frontier_is_seen_through_a_gap_that_no_robot_fits_through():
    shut = "#........#....     #"
    gap = "#.............     #"
    assert found(drawn("#" * 20, *[shut] * 5, *[gap] * 2, *[shut] * 5, "#" * 20), (0.9, 0.9)) == []
    assert found(drawn("#" * 20, *[shut] * 3, *[gap] * 5, *[shut] * 4, "#" * 20), (0.9, 0.9)) != []


def test_a_closed_room_seen_by_a_stray_beam_is_no_goal_and_is_told_as_a_pocket():
    grid = box("." * 8 + "##" + "." * 10 + " " * 6)
    ground = mapped_ground(grid, np.array([[0.9, 1.0]]), NOBODY, CFG)
    assert frontiers(ground) == []
    middles = pockets(ground)
    assert len(middles) == 1
    assert 2.2 < middles[0][0] < 4.2


def test_a_patch_smaller_than_a_sliver_is_nobodys_goal():
    state = box("." * 20, rows=14).state.copy()
    state[7, 10:12] = UNKNOWN
    small = Occupancy(0.2, np.zeros(2), state)
    assert found(small, (1.0, 1.0)) == []
    state[6:9, 10:13] = UNKNOWN
    assert len(found(Occupancy(0.2, np.zeros(2), state), (1.0, 1.0))) >= 1


def test_a_long_frontier_is_cut_into_pieces_no_longer_than_asked():
    grid = box("." * 8 + " " * 8, rows=60)
    pieces = found(grid, (0.9, 6.0))
    assert len(pieces) >= 4
    for piece in pieces:
        assert np.ptp(piece.unknown[:, 1]) <= FRONTIER_SPLIT + 0.5


def test_there_are_never_more_pieces_than_asked(monkeypatch):
    monkeypatch.setattr(laser_frontiers, "MOST_GOALS", 3)
    assert len(found(box("." * 8 + " " * 8, rows=90), (0.9, 6.0))) <= 3


def test_a_dead_robot_in_a_door_shuts_it():
    row = "#........#....    #"
    open_row = "#.............    #"
    grid = drawn("#" * 19, *[row] * 4, *[open_row] * 5, *[row] * 4, "#" * 19)
    assert found(grid, (0.9, 1.4))
    dead = np.array([[0.2 * 9.5, 0.2 * 7.5]])
    assert frontiers(mapped_ground(grid, np.array([[0.9, 1.4]]), dead, CFG)) == []
