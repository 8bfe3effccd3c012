"""The pool of tiles against plain NumPy maps: searching, writing, sharing."""

import numpy as np
import pytest

from mapweave.kernels.laser.refine import ScanCost, refine, systematic
from mapweave.kernels.laser.tiles import NearestRule
from mapweave.laser.particle_grid import CELL_CAP, MOST_WEIGHT, CellConfig, ParticleGrid

pytestmark = pytest.mark.kernel

CFG = CellConfig()
N = 12


class SlowMaps:
    """The same maps as dictionaries of cells, one deep copy a particle, in double precision."""

    def __init__(self, maps):
        self.cells = [{} for _ in range(maps)]

    @staticmethod
    def world(pose, points):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.column_stack(
            [
                pose[0] + c * points[:, 0] - s * points[:, 1],
                pose[1] + s * points[:, 0] + c * points[:, 1],
                points[:, 2],
            ]
        )

    def score(self, poses, points):
        out = np.full((len(poses), len(points)), CELL_CAP)
        for p, pose in enumerate(poses):
            for i, z in enumerate(self.world(pose, points)):
                a, b = np.floor(z[:2] / CFG.size).astype(int)
                for da in (-1, 0, 1):
                    for db in (-1, 0, 1):
                        cell = self.cells[p].get((a + da, b + db))
                        if cell is not None:
                            D = (cell[0] - z[0]) ** 2 + (cell[1] - z[1]) ** 2 + CFG.alpha * (cell[2] - z[2]) ** 2
                            out[p, i] = min(out[p, i], D)
        return out

    def insert(self, poses, points, weights):
        for p, pose in enumerate(poses):
            for z, w in zip(self.world(pose, points), weights, strict=True):
                key = tuple(np.floor(z[:2] / CFG.size).astype(int))
                old = self.cells[p].get(key)
                if old is None:
                    self.cells[p][key] = np.array([*z, w])
                else:
                    old[:3] += w / (old[3] + w) * (z - old[:3])
                    old[3] = min(MOST_WEIGHT, old[3] + w)

    def resample(self, ancestors):
        self.cells = [{k: v.copy() for k, v in self.cells[a].items()} for a in ancestors]


def scan(rng, n=N):
    angle = np.sort(rng.uniform(-2, 2, n))
    r = rng.uniform(0.5, 3.0, n)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(0, 1, n)]).astype(np.float32)


def test_the_fast_filter_does_what_a_slow_one_does_on_the_same_poses():
    """Poses and ancestors are forced; a beam whose cell two roundings put differently is counted and left out."""
    rng = np.random.default_rng(3)
    P = 5
    fast, slow = ParticleGrid(P, CFG), SlowMaps(P)
    rows, poses = np.arange(P), np.zeros((P, 3))
    points, weights = scan(rng), rng.uniform(0.1, 1, N).astype(np.float32)
    differ, total = 0, 0
    for k in range(6):
        poses = poses + rng.normal(0, [0.08, 0.08, 0.02], (P, 3)) + [0.3, 0.1, 0.0]
        points = points + rng.normal(0, 0.01, points.shape).astype(np.float32)
        a, b = fast.score(rows, poses, points), slow.score(poses, points)
        off = np.abs(a - b) > 1e-4
        differ, total = differ + int(off.sum()), total + off.size
        log_fast = np.where(off, 0, a).mean(axis=1, dtype=float) * 30 / (2 * 0.05**2)
        log_slow = np.where(off, 0, b).mean(axis=1) * 30 / (2 * 0.05**2)
        assert np.abs(log_fast - log_slow).max() < 1e-4
        fast.insert(rows, poses, points, weights)
        slow.insert(poses, points, weights)
        if k % 2:
            ancestors = systematic(rng.random(P), rng.random())
            fast.resample(ancestors)
            slow.resample(ancestors)
            poses = poses[ancestors]
        fast.check()
    assert differ <= 0.02 * total, f"{differ} of {total} beams fell into another cell"


def test_the_cells_of_a_map_are_those_written_to_it():
    rng = np.random.default_rng(5)
    fast, slow = ParticleGrid(2, CFG), SlowMaps(2)
    poses = rng.normal(0, 1, (2, 3))
    points, weights = scan(rng), np.full(N, 0.5, np.float32)
    fast.insert(np.arange(2), poses, points, weights)
    slow.insert(poses, points, weights)
    for p in range(2):
        ours = fast.cells(p)
        theirs = np.array(list(slow.cells[p].values()))
        assert len(ours) == len(theirs)
        assert np.allclose(ours[np.lexsort(ours.T)], theirs[np.lexsort(theirs.T)], atol=1e-4)
        near = fast.cells(p, poses[p, :2], 1.5)
        assert len(near) == ((theirs[:, :2] - poses[p, :2]) ** 2).sum(axis=1).__lt__(1.5**2).sum()


def test_searching_the_grid_finds_the_least_distance_wherever_it_lies_inside_the_window():
    rng = np.random.default_rng(7)
    grid = ParticleGrid(1, CFG)
    row = np.zeros(1, int)
    points = scan(rng, 40)
    grid.insert(row, np.zeros((1, 3)), points, np.ones(40, np.float32))
    cells = grid.cells(0).astype(float)
    asked = points + rng.normal(0, 0.05, points.shape).astype(np.float32)
    found = grid.score(row, np.zeros((1, 3)), asked)[0]
    D = ((cells[None, :, :3] - asked[:, None, :].astype(float)) ** 2).sum(axis=2)
    inside = (
        np.abs(np.floor(cells[D.argmin(axis=1), :2] / CFG.size) - np.floor(asked[:, :2] / CFG.size)).max(axis=1) <= 1
    )
    assert inside.sum() > 20
    assert np.allclose(found[inside], np.minimum(D.min(axis=1), CELL_CAP)[inside], atol=1e-5)


def test_maps_that_share_tiles_do_not_see_what_is_written_to_each_other():
    rng = np.random.default_rng(11)
    grid = ParticleGrid(3, CFG)
    rows = np.arange(3)
    points, w = scan(rng), np.ones(N, np.float32)
    grid.insert(rows, np.zeros((3, 3)), points, w)
    grid.resample(np.array([0, 0, 0]))
    shared = grid.tiles_in_use
    before = grid.cells(0).copy()
    grid.insert(np.array([1]), np.array([[0.02, 0.01, 0.0]]), points, w)
    grid.check()
    assert np.array_equal(grid.cells(0), before)
    assert np.array_equal(grid.cells(2), before)
    assert not np.array_equal(grid.cells(1), before)
    assert grid.tiles_in_use > shared


def test_references_balance_after_every_resampling_and_all_tiles_come_back():
    rng = np.random.default_rng(13)
    P = 6
    grid = ParticleGrid(P, CFG)
    rows = np.arange(P)
    for _ in range(8):
        grid.insert(rows, rng.normal(0, 1.0, (P, 3)), scan(rng), np.ones(N, np.float32))
        grid.resample(systematic(rng.random(P) ** 4, rng.random()))
        grid.check()
    grid.resample(np.zeros(P, int))
    grid.check()
    assert grid.tiles_in_use == grid.n_used[0]


def test_a_map_grows_with_the_world_and_keeps_what_it_had():
    rng = np.random.default_rng(17)
    grid = ParticleGrid(1, CFG)
    row = np.zeros(1, int)
    points = scan(rng)
    poses = np.array([[0.0, 0, 0], [60.0, -45.0, 1.0], [-50.0, 30.0, 2.0]])
    for pose in poses:
        grid.insert(row, pose[None], points, np.ones(N, np.float32))
        grid.check()
    assert (grid.score(row, poses[:1], points) < 1e-4).all()
    assert (grid.score(row, poses[2:], points) < 1e-4).all()
    assert (grid.score(row, np.array([[900.0, 900.0, 0.0]]), points) == np.float32(CELL_CAP)).all()


def test_systematic_resampling_draws_each_particle_floor_or_ceil_of_its_share_and_survivors_stay():
    rng = np.random.default_rng(19)
    for _ in range(20):
        w = rng.random(16) ** 3
        a = systematic(w, rng.random())
        share = 16 * w / w.sum()
        count = np.bincount(a, minlength=16)
        assert (count >= np.floor(share - 1e-9)).all()
        assert (count <= np.ceil(share + 1e-9)).all()
        alive = count > 0
        assert (a[alive] == np.flatnonzero(alive)).all()


def test_one_particle_of_all_the_weight_becomes_everybodys_ancestor():
    w = np.zeros(8)
    w[3] = 1e-300
    assert (systematic(w, 0.999999) == 3).all()


@pytest.mark.parametrize("n", [1, 63, 64, 65, 150])
def test_a_beam_is_compared_with_all_nine_cells_around_it_however_many_beams_there_are(n):
    """Also where the pose is refined from a cell to the next: `least` is then of the windows there."""
    rng = np.random.default_rng(n)
    fast, slow = ParticleGrid(3, CFG), SlowMaps(3)
    poses = rng.normal(0, [0.3, 0.3, 1.0], (3, 3))
    for _ in range(4):
        points = scan(rng, n)
        fast.insert(np.arange(3), poses, points, np.ones(n, np.float32))
        slow.insert(poses, points, np.ones(n))
        poses = poses + rng.normal(0, [0.05, 0.05, 0.02], (3, 3))
    got, want = fast.score(np.arange(3), poses, points), slow.score(poses, points)
    assert (np.abs(got - want) > 1e-4).mean() <= 0.02  # beams whose cell two roundings put differently
    assert 0.0 < (got < CELL_CAP).mean() <= 1.0
    least, normals = np.full((3, n), -1.0, np.float32), np.tile([1.0, 0.0], (n, 1))
    moved = refine(
        fast.tile_maps, np.arange(3), poses, points, normals,
        NearestRule(CFG.alpha, CELL_CAP), ScanCost(1e4, 0.5, 0.1), np.eye(3), 3, least,
    )  # fmt: skip
    assert np.abs(moved - poses).max() > 1e-3
    np.testing.assert_array_equal(least, fast.score(np.arange(3), moved, points))
