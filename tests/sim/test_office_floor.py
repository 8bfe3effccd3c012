"""Office floors: as large as asked, every room can be driven into but those told to be pockets, starts are clear."""

import numpy as np
import pytest
from scipy import ndimage

from mapweave.core.errors import DataError
from mapweave.core.walls import WallIndex
from mapweave.sim.laser_worlds import office_floor

CELL, ROBOT = 0.1, 0.2


def free_cells(floor, radius=ROBOT):
    """Cells whose centre a robot may stand on, and the pieces they fall into."""
    xs, ys = (np.arange(0.5 * CELL, top, CELL) for top in floor.upper)
    centres = np.stack(np.meshgrid(xs, ys), axis=-1)
    free = ~WallIndex.of(floor.world.segments).touches(centres.reshape(-1, 2), radius).reshape(centres.shape[:2])
    return centres, ndimage.label(free)[0]


@pytest.mark.parametrize(
    ("area", "seed"), [(500, 0), (500, 1), (1000, 2), (2000, 3), pytest.param(5000, 4, marks=pytest.mark.slow)]
)
def test_every_room_is_reached_from_every_start_but_the_pockets_told(area, seed):
    floor = office_floor(area, seed)
    assert np.prod(floor.upper - floor.lower) == pytest.approx(area, rel=1e-3)
    centres, piece = free_cells(floor, ROBOT + 0.1)  # with room to spare
    at = [piece[tuple((p[1::-1] / CELL).astype(int))] for p in floor.starts]
    assert len(at) >= 8
    assert set(at) == {at[0]}
    assert at[0] > 0
    shut = {tuple(box) for box in floor.pockets}
    for x0, y0, x1, y1 in floor.rooms:
        inside = (centres > (x0, y0)).all(axis=-1) & (centres < (x1, y1)).all(axis=-1)
        reached = (piece[inside] == at[0]).mean()
        if (x0, y0, x1, y1) in shut:
            assert reached == 0
        else:
            assert reached > 0.3
    assert 0.4 < (piece == at[0]).sum() * CELL**2 / area < 0.75


def test_all_that_is_not_free_is_solid():
    floor = office_floor(500, 1)
    walls = floor.world
    rng = np.random.default_rng(0)
    points = rng.uniform(floor.lower, floor.upper, (4000, 2))
    in_room = np.array([((points > (x0, y0)) & (points < (x1, y1))).all(axis=1) for x0, y0, x1, y1 in floor.rooms])
    solid = walls.inside(points)
    assert not walls.inside(floor.starts[:, :2]).any()
    assert walls.inside(np.array([[-1.0, 3.0], [floor.upper[0] + 0.5, 3.0]])).all()
    assert 0.05 < solid[in_room.any(axis=0)].mean() < 0.35  # desks
    assert (walls.clearance(points[~solid]) > 0).all()


def test_corridors_form_loops():
    """Taking away a stretch of corridor beside the starts does not cut the floor in two."""
    floor = office_floor(1000, 5)
    centres, piece = free_cells(floor)
    home = piece[tuple((floor.starts[0][1::-1] / CELL).astype(int))]
    x, y = floor.starts[0][:2]
    cut = (piece == home) & ~((np.abs(centres[..., 0] - x) < 0.5) & (np.abs(centres[..., 1] - y) < 1.0))
    sizes = np.bincount(ndimage.label(cut)[0].ravel())[1:]
    assert sizes.max() > 0.97 * cut.sum()


def test_some_floors_have_pockets_and_halls_and_small_floors_stand_too():
    floors = [office_floor(2000, seed) for seed in range(6)]
    assert any(len(f.pockets) for f in floors)
    assert any(((f.rooms[:, 2:] - f.rooms[:, :2]).prod(axis=1) > 80).any() for f in floors)
    assert len(office_floor(150, 0).starts) >= 2


def test_the_same_seed_gives_the_same_floor_and_another_seed_another():
    one, same, other = office_floor(500, 3), office_floor(500, 3), office_floor(500, 4)
    assert np.array_equal(one.world.segments, same.world.segments)
    assert np.array_equal(one.world.reflectance, same.world.reflectance)
    assert not np.array_equal(one.rooms, other.rooms)


def test_an_area_no_office_has_is_refused():
    for area in (0.0, 100.0, 1e6):
        with pytest.raises(DataError, match="an office of"):
            office_floor(area, 0)
