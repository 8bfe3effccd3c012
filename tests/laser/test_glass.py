"""Glass is seen by beams that meet it squarely and passed by others: it stays in the map, and is told."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core import se2
from mapweave.core.records import frozen
from mapweave.exploration.laser.config import OCCUPIED_SHARE
from mapweave.io.robot_graph import read_robot_graph, write_robot_graph
from mapweave.kernels.laser.moving import flat_faces
from mapweave.kernels.walls.segments import cast
from mapweave.laser.moving import THING, MovingConfig, MovingReturns
from mapweave.laser.occupancy_mapper import of_grid
from mapweave.sim.laser import DriftConfig, DriveConfig, Scanner
from mapweave.sim.laser_worlds import GLASS_SHOWN, OfficeConfig, simulate_office

from .test_moving import ANGLES, HALL, scan

DRIVE = DriveConfig(scanner=Scanner(far=10.0), drift=DriftConfig(end_error=(1.0, 2.0)))
GLAZED = OfficeConfig(rooms=3, visited=2, glazed=0.7, drive=DRIVE)
PANE = np.array(
    [  # a hall whose right wall is glass, and what is behind it
        [-3, -2, 12, -2, 0.95],
        [12, -5, 12, 4, 0.0],
        [12, 4, -3, 4, 0.0],
        [-3, 4, -3, -5, 0.0],
        [-3, -5, 12, -5, 0.0],
    ]
)


def test_beams_pass_glass_but_where_they_meet_it_squarely():
    r, what, cosine = cast(np.array([[0.0, 0.0, -np.pi / 2]]), ANGLES, frozen(PANE), np.zeros((1, 0, 3)), 30.0)
    square = np.abs(np.cos(ANGLES)) >= 0.95
    assert (what[0][square] == 0).all()
    assert (what[0][~square] != 0).all()
    assert r[0][square] == pytest.approx(2.0 / np.cos(ANGLES[square]))
    past = np.abs(ANGLES) < 0.5
    assert r[0][~square & past] == pytest.approx(5.0 / np.cos(ANGLES[~square & past]))
    assert (cosine[0][square] >= 0.95).all()


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.02])
def test_flat_faces_have_normals_and_round_bodies_have_none(noise):
    rng = np.random.default_rng(3)
    wall = scan((0.0, 0.0, 0.0), [[(1.5, 1.0, 0.22), (2.0, -1.2, 0.3)]])
    ranges = wall.ranges + noise * rng.standard_normal(len(ANGLES))
    normals = flat_faces(ranges, wall.hit, ANGLES[0], ANGLES[1] - ANGLES[0], THING)[:, :2]
    points = wall.ranges[:, None] * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
    body = np.minimum(np.hypot(*(points - [1.5, 1.0]).T) - 0.22, np.hypot(*(points - [2.0, -1.2]).T) - 0.3) < 0.01
    flat = np.abs(points[:, 1] + 2.0) < 1e-9
    assert (normals[body] != 0.0).any(axis=1).mean() < (0.05 if noise < 0.02 else 0.3)
    assert np.abs(normals[flat & (normals[:, 1] != 0.0)] @ [0.0, 1.0]).min() > 0.98
    assert (normals[flat] != 0.0).any(axis=1).mean() > 0.8


def test_a_pane_and_what_stands_behind_it_do_not_move_and_somebody_before_it_does():
    found, walked, gone = MovingReturns(MovingConfig()), MovingReturns(MovingConfig()), 0
    for k in range(20):
        pose = (0.3 * k, 0.0, -0.7)
        alone = scan(pose, walls=PANE)
        assert np.array_equal(found.cleaned(0.5 * k, alone, np.array(pose)).hit, alone.hit)
        body = np.array([0.3 * k + 2.0, 3.0 - 0.2 * k])
        seen = scan(pose, [[(*body, 0.22)]], walls=PANE)
        clean = walked.cleaned(0.5 * k, seen, np.array(pose))
        points = se2.act(np.array(pose), seen.ranges[:, None] * np.column_stack([np.cos(ANGLES), np.sin(ANGLES)]))
        gone += int((seen.hit & ~clean.hit & (np.hypot(*(points - body).T) < 0.25)).sum())
    assert gone > 50


def box(x, y, wide, deep):
    """Four walls, the nearest side of which is at x."""
    a, b = y - wide / 2, y + wide / 2
    return [[x, a, x, b], [x, b, x + deep, b], [x + deep, b, x + deep, a], [x + deep, a, x, a]]


@pytest.mark.parametrize(("wide", "ahead"), [(0.4, 0.7), (0.5, 1.0), (0.6, 1.5)])
def test_a_robot_that_is_followed_is_no_pane(wide, ahead):
    found, there, gone = MovingReturns(MovingConfig()), 0, 0
    for k in range(20):
        pose = (0.25 * k, 0.0, 0.0)
        seen = scan(pose, walls=np.vstack([HALL, box(0.25 * k + ahead, 0.03 * np.sin(k), wide, 0.5)]))
        clean = found.cleaned(0.5 * k, seen, np.array(pose))
        back = seen.hit & (np.abs(seen.ranges * np.cos(ANGLES) - ahead) < 0.05)
        there, gone = there + (k > 3) * int(back.sum()), gone + (k > 3) * int((back & ~clean.hit).sum())
    assert gone > 0.8 * there


@pytest.fixture(scope="module")
def glazed():
    """A glazed office and its map."""
    made = simulate_office(GLAZED, 5)
    return made, mapweave.map(made.log)


def squarely_met(made, least: int = 3):
    """Middles (k, 2) [m] of squares of 0.1 m in which panes returned light `least` times, in the world's frame."""
    walls = frozen(np.column_stack([made.world.segments, made.world.shown]))
    at = np.searchsorted(made.truth.t, made.log.scan_t)
    angles = made.log.scans[0].angles()
    r, what, _ = cast(made.truth.pose[at], angles, walls, np.zeros((len(at), 0, 3)), GLAZED.drive.scanner.far)
    k, b = np.nonzero(np.append(made.world.shown > 0.0, False)[what])
    turn = made.truth.pose[at][k, 2] + angles[b]
    points = made.truth.pose[at][k, :2] + r[k, b][:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    cells, count = np.unique(np.floor(points / 0.1), axis=0, return_counts=True)
    return 0.1 * cells[count >= least] + 0.05


def placed(made, track):
    """Where the map's frame lies in the world, by the poses driven."""
    return se2.align(track.pose[:, :2], made.truth.pose[np.searchsorted(made.truth.t, track.t), :2])


def walls_near(made, result, points):
    """Which of the points [m] of the world lie within 0.15 m of an occupied cell of the map."""
    T_map_world = se2.inverse(placed(made, result.maps[0].track))
    occupied = of_grid(result.maps[0].grid, OCCUPIED_SHARE)
    walls = occupied.centres(np.argwhere(occupied.occupied))
    away = se2.act(T_map_world, points)[:, None] - walls[None]
    return np.hypot(away[..., 0], away[..., 1]).min(axis=1) < 0.15


def test_panes_stay_in_the_map_which_is_good_and_says_so(glazed):
    made, result = glazed
    panes = squarely_met(made)
    assert len(panes) > 50
    assert walls_near(made, result, panes).mean() > 0.9
    told = {f.code: f.value for f in result.findings}
    assert "glass-seen" in told
    assert 5.0 < told["glass-seen"] < 0.1 * len(panes)
    assert result.verdict == "good"


def test_walls_that_are_opaque_are_never_glass(glazed):
    made, result = glazed
    plain = simulate_office(replace(GLAZED, glazed=0.0), 5)
    assert not mapweave.map(plain.log).maps[0].graph.glass.any()
    graph = result.maps[0].graph
    panes = made.world.segments[made.world.shown > 0.0]
    assert (made.world.shown[made.world.shown > 0.0] == GLASS_SHOWN).all()
    points = se2.act(placed(made, result.maps[0].track), graph.panes())
    a, b = panes[:, :2], panes[:, 2:]
    along = np.clip(((points[:, None] - a) * (b - a)).sum(axis=2) / ((b - a) ** 2).sum(axis=1), 0.0, 1.0)
    far = np.linalg.norm(points[:, None] - a - along[..., None] * (b - a), axis=2).min(axis=1)
    assert np.mean(far < 0.3) > 0.9


def test_glass_is_written_and_read_with_the_graph(glazed, tmp_path):
    graph = glazed[1].maps[0].graph
    write_robot_graph(tmp_path / "g.npz", graph)
    assert graph.glass.any()
    assert np.array_equal(read_robot_graph(tmp_path / "g.npz").glass, graph.glass)
