"""No kernel reads or writes beyond its arrays, whatever numbers they hold; run with bounds checks, which tell."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from mapweave import kernels
from mapweave.kernels.cells import FARTHEST, cell_of
from mapweave.kernels.exploration.objective import mark_half_disc, unexplored_cells
from mapweave.kernels.landmarks.submap import relation_normal
from mapweave.kernels.laser import icp
from mapweave.kernels.laser.beams import beam_lines, scan_returns, spacing
from mapweave.kernels.laser.icp import IcpRules, intensity_icp, sort_into_cells
from mapweave.kernels.laser.joint_scans import BeamIndex, LineGate, ScanLines, beams_by_direction, match_pairs
from mapweave.kernels.laser.local_map import MatchCost, ScanPoints, add_points, align_scan, count_matches, fit_lines
from mapweave.kernels.laser.moving import BeamRanges, Thing, flat_faces, moving_returns
from mapweave.kernels.laser.place_search import bound, fit_normals, lay_onto_lines, stamp, turned_cells
from mapweave.kernels.laser.pose_edges import edge_normal, edge_residuals, edge_squares
from mapweave.kernels.laser.refine import ScanCost, refine, systematic
from mapweave.kernels.laser.scan_laying import CellCounts, lay_scan, score_field
from mapweave.kernels.laser.tiles import FLOATS, NearestRule, TileBooks, TileMaps, gather, insert, score, touch
from mapweave.kernels.mapping.places import Clouds, SearchedField, SearchRules, heading_peaks, search_submaps
from mapweave.kernels.walls.segments import (
    Raster,
    Sector,
    cast,
    distance_of_moves,
    distance_to_walls,
    enclosed,
    enclosed_cells,
    mark_near,
    sight_on_raster,
)
from mapweave.kernels.walls.sight import Looks, judge_walls, mark_in_sight, points_in_sight, unexplored_in_sight
from mapweave.kernels.walls.wall_grid import WallBuckets, cast_in_grid, fill_buckets, touches_wall

pytestmark = pytest.mark.kernel

HOUSE = Path(kernels.__file__).parent
EXTREMES = np.array(
    [
        0.0,
        -0.0,
        5e-324,
        -5e-324,
        0.05,
        -1.0,
        3.0,
        2.0**31,
        -(2.0**53),
        1e15,
        -(2.0**63),
        2.0**64,
        1e300,
        -1e300,
        1.7e308,
    ]
)
NOT_FINITE = np.array([np.inf, -np.inf, np.nan])
COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") == "0"
CALM = () if COMPILED else (ArithmeticError, ValueError)  # what Python says of numbers that compiled code passes on


class Extremes:
    """Arrays of a few honest numbers among extreme ones."""

    def __init__(self, seed, *, finite):
        self.rng = np.random.default_rng(seed)
        self.values = EXTREMES if finite else np.concatenate([EXTREMES, NOT_FINITE])
        self.finite = finite

    def __call__(self, *shape):
        calm = self.rng.uniform(-3.0, 3.0, shape)
        wild = self.rng.choice(self.values, shape)
        return np.where(self.rng.random(shape) < 0.5, calm, wild)

    def angles(self, *shape):
        """Python's cosine of an infinite angle is an error, the compiled one no number."""
        return self(*shape) if COMPILED else np.clip(np.nan_to_num(self(*shape)), -1e9, 1e9)

    def poses(self, *shape):
        out = self(*shape, 3)
        out[..., 2] = self.angles(*shape)
        return out

    def marks(self, *shape):
        return self.rng.random(shape) < 0.7

    def count(self):
        return int(self.rng.choice([0, 1, 2, 7, 70]))


def tile_maps(x):
    maps, width, tiles = 2, 3, 12
    pool = np.zeros((3 * tiles, FLOATS), np.float32)
    pool[0] = 1e6
    table = np.zeros((maps, tiles), np.int32)
    return TileMaps(pool.ravel(), table, width, np.array([-1.0, -1.0]), 0.1)


def into_local_map(x):
    n = x.count()
    sums, lines = np.zeros((16, 16, 9), np.float32), np.zeros((16, 16, 6), np.float32)
    points, normals, q = x(n, 2), x(n, 2), x(n)
    for sign in (1.0, -1.0):
        add_points(sums, 0.1, points, normals, q, sign)
        fit_lines(sums, lines, 0.1, points)
    scan = ScanPoints(x(n, 2), x(n, 2), x(n), x(n))
    cost = MatchCost(0.1, 0.5, 1e4, 0.1, 0.1, 0.05)
    align_scan(lines, 0.1, scan, cost, x.poses(), x.poses(), np.ones(3), 4)
    count_matches(lines, 0.1, *scan[:3], 0.1, 0.5, x.poses(), 0.1)


def laid(x):
    n = x.count()
    grids = [np.zeros((9, 11), np.int32) for _ in range(3)]
    corner = x.rng.choice([np.array([-4, -4]), np.array([2**40, -(2**40)])]).astype(np.int64)
    light = x.rng.uniform(0, 1, (n, 2))
    counts = CellCounts(*grids, np.zeros((9, 11, 4), np.int64), corner, 0.05)
    near = x.rng.uniform(-0.3, 0.3, (n, 2))
    points = np.where(x.marks(n, 1), near, x(n, 2))
    lay_scan(counts, x(2) if x.marks() else np.zeros(2), points, light, x(3, 2), 1.0, 1)


def among_tiles(x):
    maps, n, particles = tile_maps(x), x.count(), 2
    points = x(n, 3).astype(np.float32)
    poses, rows = x.poses(particles), np.arange(particles)
    least = np.zeros((particles, n), np.float32)
    score(maps, rows, poses, points, NearestRule(0.1, 0.25), least)
    refine(maps, rows, poses, points, x(n, 2), NearestRule(0.1, 0.25), ScanCost(100.0, 0.1, 0.1), np.eye(3), 2, least)
    tiles = len(maps.pool) // FLOATS
    books = TileBooks(
        np.zeros((2, 12), np.int32), np.zeros(2, np.int64), np.zeros(tiles, np.int64),
        np.arange(tiles - 1, 0, -1), tiles - 1,
    )  # fmt: skip
    places, jobs = np.zeros((particles, n), np.int64), np.zeros((tiles, 2), np.int32)
    _, _, done = touch(maps, rows, books, poses, points, jobs, 0, places)
    if done:
        insert(maps.pool, places, poses, points, np.ones(n, np.float32), 10.0)
    gather(maps.pool, maps.table[0], np.arange(12), x(2), 1.0)


def searched(x):
    n = x.count()
    points, origin = x(n, 2), np.array([-1.0, -1.0])
    _, nearest = stamp(points, origin, 0.1, 20, 25, 0.1, 2)
    lines = fit_normals(points, 0.3)
    assert len(lines) == n
    cells = turned_cells(x(n, 2), x(2), x.angles(3), origin, 0.1)
    table, none = np.ones((20, 25), np.uint8), np.zeros((0, 25), np.uint8)
    for shift in (-(2**28), 0, 7, 2**28):
        bound(table, none, none, np.zeros(256, np.int64), cells[0], np.zeros(n, np.int64), shift, shift, 3, 0)
    lay_onto_lines(x(n, 2), x.poses(), points, lines, nearest, origin, 0.1, 0.5, np.array([0.2, 0.1]), 1e-3)
    field = np.zeros((20, 25, 3))
    score_field(field, origin, 0.1, x.poses(4), x(n, 3), 0.1, 1.0, 0.5)


def places(x):
    n = max(x.count(), 1)
    _, count = heading_peaks(x(3, 36), 4, 3, 0.3, 0.35)
    assert ((count >= 0) & (count <= 4)).all()
    size, reach, tiles = 4, 8, 5
    tables, none = np.ones((3, 23, 27), np.uint8), np.zeros((3, 0, 0), np.uint8)
    blocks = np.ones((size, size, 6 * (7 + tiles)), np.uint8)
    field = SearchedField(tables, blocks, 7 + tiles, none, none, np.zeros(256, np.int64), x(2), 0.2)
    clouds = Clouds(x(n, 2), np.zeros(n, np.int64), np.array([0, n // 2, n, n]))
    rows = search_submaps(field, clouds, x.angles(12).reshape(3, 4), count, SearchRules(reach, 0.5, 5, 0.25))
    assert rows.shape == (3, 8)


def sorted_in(x):
    n = max(x.count(), 1)
    points = x(n, 3)
    ordered, starts, _, cols = sort_into_cells(points, 0.3)
    assert starts[-1] == n
    assert (len(starts) - 1) % cols == 0
    assert np.array_equal(np.sort(ordered[:, 2]), np.sort(points[:, 2]), equal_nan=True)
    intensity_icp(points, x(n, 3), x.poses(), IcpRules(0.1, 1.0, 0.1, 0.8, 3, 1e-3, 3, 0.3))


def matched(x):
    n = x.count()
    start = np.array([0, n // 2, n])
    points, normals, lined = x(n, 2), x(n, 2), x.marks(n)
    sensor = x(2, 2)
    table = beams_by_direction(start, points, lined, sensor, 16)
    scans = ScanLines(start, points, normals, lined)
    ends = np.array([0, 1, 0]), np.array([1, 0, 0])
    match_pairs(*ends, x.poses(3), scans, BeamIndex(table, sensor), LineGate(0.3, 0.5), 0.1)


def moved(x):
    n, m = x.count(), 3
    step = float(x.rng.choice([0.0, 1e-6, 0.01, -0.01, 3.0]))
    thing = Thing(0.2, 0.1, 0.3, 1.0, 0.2, 0.1, 0.5, 1, 3, 1, 0.35, 0.01, 0.8)
    ranges, hit, first = np.abs(x(n)), x.marks(n), float(x.angles())
    faces = flat_faces(ranges, hit, first, step, thing)
    assert (np.hypot(*faces[:, :2].T) < 1.0 + 1e-9).all()
    scan = BeamRanges(ranges, hit, first, step, 30.0, faces)
    before, there = np.abs(x(m, n)), x.marks(m, n)
    past = np.array([flat_faces(a, b, first, step, thing) for a, b in zip(before, there, strict=True)])
    moving_returns(scan, before, there, past, x.poses(m), np.abs(x(m)), thing)


def seen_among_walls(x):
    n = x.count()
    segments, points = x(5, 4), x(n, 2)
    raster, sector = Raster(np.array([-2.0, -2.0]), 0.5), Sector(3.0, 1.0)
    free = np.zeros((8, 9), bool)
    mark_near(free, segments, 0.3, raster)
    enclosed(points, segments)
    enclosed_cells(segments, raster, 8, 9)
    distance_to_walls(points, segments)
    distance_of_moves(points, x(n, 2), segments)
    points_in_sight(x(2), points, 3.0, segments)
    mark_in_sight(free, x.poses(), sector, raster, segments)
    unexplored_in_sight(free, x.poses(3), sector, raster, segments)
    mark_half_disc(free, x.poses(), sector, raster)
    unexplored_cells(free, x.poses(3), sector, raster)
    sight_on_raster(free, x.rng.uniform(-1, 9, 2), x.rng.uniform(-1, 9, 2))
    first, items = fill_buckets(x.rng.uniform(0, 4, (5, 4)), np.zeros(2), 1.0, 4, 4)
    walls = WallBuckets(segments, np.zeros(2), 1.0, 4, first, items)
    touches_wall(points, 0.2, walls)
    cast_in_grid(x.poses(2), x.angles(3), x(2, 1, 3), 9.0, walls)
    cast(x.poses(2), x.angles(3), segments, x(2, 1, 3), 9.0)


def tied(x):
    n, m = 4, x.count()
    pose, ends = x.poses(n), x.rng.integers(0, n, (2, m))
    measured, information = x.poses(m), x(m, 3, 3)
    edge_residuals(pose, *ends, measured)
    edge_squares(pose, *ends, measured, information)
    edge_normal(pose, *ends, measured, information, x(m))
    relation_normal(x.marks(m), x.poses(m), x(m, 2), x(m), x(m), x.poses(), 0.1, 0.1, 0.1)


def resampled(x):
    weights = np.abs(x(max(x.count(), 1)))
    weights[0] = 1.0
    ancestors = systematic(np.nan_to_num(weights, posinf=1e300) / 1e10, 0.5)
    assert ((ancestors >= 0) & (ancestors < len(weights))).all()


def lined(x):
    n = x.count()
    half = int(x.rng.choice([0, 2, 10**9]))
    beam_lines(x(n), x(n), np.abs(x(n)), x.marks(n), half, 0.1, 0.1)
    seen = scan_returns(x(n), x.marks(n), (0.02, 25.0), tuple(x(2).tolist()), x.poses(), half, 0.1, 0.1)
    assert len(spacing(seen.s)) == len(seen.beam) <= n


def viewed(x):
    n, walls, bins = 3, 12, 8
    poses, views = np.array([x.poses() for _ in range(n)]), x(n, bins)
    squarely = np.array([0.75, 0.9])
    given = x(walls, 2), x(walls, 2), x.marks(walls)
    seen, gone, deep = judge_walls(poses, views, *given, Looks(8.0, 0.2, 0.02, 0.4, 1.0, 0.2), squarely)
    assert (deep <= gone).all()
    assert (seen + gone).sum(axis=1).max() <= n


KERNELS = [
    viewed,
    into_local_map,
    laid,
    among_tiles,
    searched,
    places,
    sorted_in,
    matched,
    moved,
    seen_among_walls,
    tied,
    resampled,
    lined,
]
MADE_BY_US = {
    # modules whose numbers make no index, or whose indices are made by their callers from lengths of lists
    "block_cholesky", "cells", "compiling", "dense", "elimination",
    "tours", "wavefront", "ekf", "ekf_smooth",
    "submap",
}  # fmt: skip


@pytest.mark.skipif(
    COMPILED and os.environ.get("NUMBA_BOUNDSCHECK", "0") == "0", reason="tells with NUMBA_BOUNDSCHECK=1 or uncompiled"
)
@pytest.mark.parametrize("fuzz", KERNELS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("finite", [True, False])
def test_whatever_numbers_a_kernel_is_given_it_stays_within_its_arrays(fuzz, finite, monkeypatch):
    if not COMPILED:
        monkeypatch.setattr(icp, "MOST_CELLS", 64)
    for seed in range(15 if COMPILED else 4):
        x = Extremes(seed, finite=finite)
        with np.errstate(all="ignore"):
            try:
                fuzz(x)
            except CALM:
                continue


def test_every_module_of_kernels_is_tried_or_makes_no_index_of_a_number():
    here = Path(__file__).read_text()
    tried = set(re.findall(r"^from mapweave\.kernels\.\w+\.(\w+) import", here, re.MULTILINE))
    modules = {path.stem for path in HOUSE.rglob("*.py") if not path.stem.startswith("_")}
    assert modules == tried | MADE_BY_US


def test_a_float_becomes_an_index_in_one_way_alone():
    told = []
    for path in sorted(HOUSE.rglob("*.py")):
        lines = path.read_text().splitlines()
        told += [
            f"{path.stem}: {line.strip()}" for line in lines if re.search(r"int\w*\((np|math)\.(floor|ceil)", line)
        ]
    assert not told


@pytest.mark.parametrize("at", [*EXTREMES.tolist(), *NOT_FINITE.tolist()])
def test_a_cell_is_the_floor_or_outside_of_every_grid(at):
    cell = cell_of(at)
    assert abs(cell) <= FARTHEST
    if abs(at) < FARTHEST:
        assert cell == np.floor(at)
    else:
        assert cell == (FARTHEST if at > 0 else -FARTHEST)
