"""The local map and the match against it."""

import mmap
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Scan
from mapweave.kernels.laser.local_map import MatchCost, ScanPoints, add_points, align_scan, fit_lines, solve3
from mapweave.laser.beam import BeamConfig, beams
from mapweave.laser.scan_matching import FrontEnd, FrontEndConfig, allowed_sd

pytestmark = pytest.mark.kernel


def box_scan(pose, n=121, half=(3.0, 2.0)):
    """What a scanner at `pose` in the middle of a box of 6 x 4 m sees."""
    angle = np.linspace(-2.0, 2.0, n)
    a = angle + pose[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        tx = (np.sign(np.cos(a)) * half[0] - pose[0]) / np.cos(a)
        ty = (np.sign(np.sin(a)) * half[1] - pose[1]) / np.sin(a)
    r = np.minimum(np.where(tx > 0, tx, np.inf), np.where(ty > 0, ty, np.inf))
    return Scan(r, np.ones(n, bool), None, -2.0, float(angle[1] - angle[0]), 30.0)


def seen(pose):
    return beams(box_scan(np.asarray(pose, float)), "none", None, BeamConfig())


def test_a_scan_is_found_where_it_was_taken():
    fe = FrontEnd(FrontEndConfig())
    for k in range(5):
        pose = np.array([0.1 * k, 0.0, 0.02 * k])
        fe.insert(seen(pose), pose)
    true = np.array([0.35, 0.12, 0.13])
    start = np.add(true, [0.06, -0.05, 0.04])
    found = fe.match(seen(true), start, np.array([0.1, 0.1, 0.1]))
    assert np.abs(found.pose - true).max() < 0.02
    assert found.matches > 0.8 * found.beams
    assert np.allclose(se2.compose(start, found.innovation), found.pose, atol=1e-9)


def test_a_turn_odometry_missed_is_found_by_the_wide_search():
    fe = FrontEnd(FrontEndConfig())
    fe.insert(seen([0, 0, 0]), np.zeros(3))
    found = fe.match(seen([0.0, 0.0, 0.28]), np.zeros(3), np.array([0.05, 0.05, 0.05]))
    assert abs(found.pose[2] - 0.28) < 0.03


def test_a_turn_is_searched_as_far_as_odometry_is_unsure_of_it():
    """Stamps that lag in a fast turn: odometry told another turn than the scan, and knows that it may be off."""
    fe = FrontEnd(FrontEndConfig())
    rng = np.random.default_rng(3)
    for pose in np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.1]]):
        fe.insert(seen(pose), pose)
    scan = box_scan(np.array([0.0, 0.0, 0.15]))
    scan = replace(scan, ranges=scan.ranges + rng.normal(0.0, 0.02, len(scan.ranges)))
    found = fe.match(beams(scan, "none", None, BeamConfig()), np.array([0.0, 0.0, -0.6]), np.array([0.03, 0.03, 0.4]))
    assert abs(found.pose[2] - 0.15) < 0.03
    assert found.matches > 0.8 * found.beams


def test_what_is_taken_out_of_the_map_leaves_no_trace():
    rng = np.random.default_rng(0)
    sums, lines = np.zeros((64, 64, 9), np.float32), np.zeros((64, 64, 6), np.float32)
    a, b = rng.uniform(-3, 3, (2, 40, 2))
    normals, q = np.tile([1.0, 0.0], (40, 1)), rng.random(40)
    add_points(sums, 0.1, a, normals, q, 1.0)
    fit_lines(sums, lines, 0.1, a)
    alone = lines.copy()
    add_points(sums, 0.1, b, normals, q, 1.0)
    fit_lines(sums, lines, 0.1, b)
    add_points(sums, 0.1, b, normals, q, -1.0)
    fit_lines(sums, lines, 0.1, b)
    held = alone.any(axis=2)
    assert np.array_equal(held, lines.any(axis=2))
    assert np.allclose(lines[held][:, [0, 1, 4]], alone[held][:, [0, 1, 4]], atol=1e-5)


def test_the_information_of_a_match_is_small_along_a_corridor_and_large_across():
    sums, lines = np.zeros((256, 256, 9), np.float32), np.zeros((256, 256, 6), np.float32)
    x = np.arange(-4, 4, 0.04)
    wall = np.column_stack([np.concatenate([x, x]), np.repeat([-1.0, 1.0], len(x)) + 1e-3])
    normal = np.column_stack([np.zeros(2 * len(x)), -np.sign(wall[:, 1])])
    add_points(sums, 0.1, wall, normal, np.zeros(len(wall)), 1.0)
    fit_lines(sums, lines, 0.1, wall)
    sd = np.array([0.1, 0.1, 0.1])
    pose, H, _ = align_scan(
        lines,
        0.1,
        ScanPoints(wall, normal, np.zeros(len(wall)), np.zeros(len(wall))),
        MatchCost(1.0, 0.5, 60 / 0.02**2, 0.0, 0.1, 1.0),
        np.array([0.03, 0.04, 0.01]),
        np.zeros(3),
        sd,
        20,
    )
    assert abs(pose[1]) < 0.005
    assert abs(pose[2]) < 0.002
    assert H[0, 0] < 1.2 / 0.1**2
    assert H[1, 1] > 100 / 0.1**2


def test_solving_three_equations_by_hand_is_solving_them():
    rng = np.random.default_rng(1)
    for _ in range(20):
        A = rng.normal(size=(3, 3))
        H = A @ A.T + 0.1 * np.eye(3)
        g = rng.normal(size=3)
        got = solve3(H[0, 0], H[0, 1], H[0, 2], H[1, 1], H[1, 2], H[2, 2], *g)
        assert np.allclose(got, np.linalg.solve(H, g))
    assert solve3(0.0, 0, 0, 1, 0, 1, 1, 1, 1) == (0.0, 0.0, 0.0)


def test_what_a_step_may_err_grows_with_the_way_and_with_the_turning_either_way_round():
    c = FrontEndConfig()
    still = allowed_sd(np.zeros(3), c)
    np.testing.assert_allclose(still, [c.sd_xy, c.sd_xy, c.sd_turn])
    ahead, spun = allowed_sd(np.array([1.0, 0.0, 0.0]), c) - still, allowed_sd(np.array([0.0, 0.0, 1.0]), c) - still
    assert (ahead > 0).all()
    assert spun[2] > 0
    np.testing.assert_allclose(allowed_sd(np.array([-0.3, 0.4, -0.2]), c), still + 0.5 * ahead + 0.2 * spun)


@pytest.mark.skipif(sys.platform != "linux", reason="reads how much memory is resident from /proc")
def test_a_local_map_takes_memory_only_where_something_was_seen():
    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE

    FrontEnd(FrontEndConfig()).insert(seen([0, 0, 0]), np.zeros(3))  # what the first one ever brings
    before = resident()
    fe = FrontEnd(FrontEndConfig())
    fe.insert(seen([0, 0, 0]), np.zeros(3))
    whole = sum(level.nbytes for level in (*fe.sums, *fe.lines))
    assert resident() - before < 0.1 * whole
