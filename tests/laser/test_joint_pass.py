"""The last pass: scans matched against scans, all together, and what bare walls may not tell."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import frozen
from mapweave.kernels.laser.joint_scans import LineGate, beams_by_direction, match_beam, match_pairs, refine_poses
from mapweave.laser import joint_pass as pass_module
from mapweave.laser.joint_pass import (
    JOINT_PASS_AGREE,
    JOINT_PASS_BLUR,
    JOINT_PASS_GATE,
    JOINT_PASS_REACH,
    JOINT_PASS_SECTORS,
    JointPassConfig,
    joint_pass,
    keyframe_cloud,
    lay_scans,
    neighbours,
    paired,
    scan_cloud,
    without_scatter,
)
from mapweave.laser.pose_graph import PoseGraph

from ..io.test_robot_graph import graph
from .test_closures import seen

CFG = JointPassConfig()


def around(n=16):
    """Poses on a round through the room, looking along the way."""
    a = 2 * np.pi / n * np.arange(n)
    return np.column_stack([1.2 * np.cos(a), 0.9 * np.sin(a), se2.wrap_angle(a + 0.5 * np.pi)])


def steps_of(truth, pose, sd=0.05):
    """The chain of `pose`s with the steps it shows itself."""
    n = len(pose) - 1
    information = np.tile(np.diag([sd**-2, sd**-2, 0.03**-2]), (n, 1, 1))
    return PoseGraph(pose, np.arange(n), np.arange(1, n + 1), se2.between(pose[:-1], pose[1:]), information)


def cloud_at(truth, most=120):
    return scan_cloud([seen(p) for p in truth], np.zeros((len(truth), 2)), most)


@pytest.mark.kernel
def test_a_pair_of_scans_is_matched_as_by_trying_every_return():
    poses = np.array([[0.0, 0.0, 0.0], [0.5, -0.3, 0.6]])
    cloud = cloud_at(poses)
    relative = np.add(se2.between(poses[0], poses[1]), [0.03, -0.02, 0.02])
    gate, width = 0.3, 0.1
    H, g, matched, near = match_pairs(
        np.array([0]), np.array([1]), relative[None], cloud.lines, cloud.index(720), LineGate(gate, 0.5), width
    )
    a, b = slice(0, cloud.start[1]), slice(cloud.start[1], cloud.start[2])
    lines, normals = cloud.points[a][cloud.lined[a]], cloud.normals[a][cloud.lined[a]]
    R = se2.rotation(float(relative[2]))
    H_all, g_all, count, close = np.zeros((3, 3)), np.zeros(3), 0, 0
    for p, n in zip(cloud.points[b][cloud.lined[b]], cloud.normals[b][cloud.lined[b]], strict=True):
        x, m = relative[:2] + R @ p, R @ n
        d = np.where(normals @ m >= 0.5, np.hypot(*(lines - x).T), np.inf)
        k = int(np.argmin(d))
        if d[k] >= gate:
            continue
        e = float(normals[k] @ (x - lines[k]))
        j = np.array([*normals[k], normals[k] @ np.array([-(R @ p)[1], (R @ p)[0]])])
        w = (width**2 / (width**2 + e**2)) ** 2
        H_all, g_all = H_all + w * np.outer(j, j), g_all + w * j * e
        count, close = count + 1, close + (abs(e) < width)
    assert count > 60
    assert (matched[0], near[0]) == (count, close)
    assert np.allclose(H[0], H_all, rtol=1e-9, atol=1e-9)
    assert np.allclose(g[0], g_all, rtol=1e-9, atol=1e-9)


@pytest.mark.kernel
def test_a_point_finds_the_nearest_return_as_by_trying_every_one_wherever_it_lies():
    cloud = cloud_at(np.array([[0.4, -0.2, 0.3]]), most=240)
    sensor = frozen([[0.15, -0.1]])
    table = beams_by_direction(cloud.start, cloud.points, cloud.lined, sensor, 720)[0]
    lines, normals = cloud.points[cloud.lined], cloud.normals[cloud.lined]
    rng = np.random.default_rng(7)
    missed = 0
    for k in rng.integers(0, len(lines), 80):
        for reach in (0.05, 0.3):
            at = lines[k] + rng.normal(0, 0.8 * reach, 2)
            d = np.where(normals @ normals[k] >= 0.5, np.hypot(*(lines - at).T), np.inf)
            got = match_beam(
                table, cloud.points, cloud.normals, tuple(sensor[0]), tuple(at), tuple(normals[k]), reach, 0.5
            )
            if d.min() >= reach:
                assert got == -1
                missed += 1
            else:
                np.testing.assert_array_equal(cloud.points[got], lines[np.argmin(d)])
    assert 0 < missed < 120


@pytest.mark.kernel
@pytest.mark.parametrize("r", [0.9, 1.0, 1.5, 3.0])
def test_a_lone_return_nearly_a_gate_aside_is_found_in_every_direction(r):
    start, lined = frozen([0, 1], np.int64), frozen([True], np.bool_)
    sensor, normal, gate = frozen([[0.3, -0.2]]), frozen([[1.0, 0.0]]), 0.3
    for direction in np.linspace(-np.pi, np.pi, 33):
        for side in (-1, 1):
            at = sensor[0] + r * np.array([np.cos(direction), np.sin(direction)])
            aside = direction + side * 2 * np.arcsin(0.5 * 0.98 * gate / r)
            point = frozen(sensor + r * np.array([[np.cos(aside), np.sin(aside)]]))
            table = beams_by_direction(start, point, lined, sensor, 200)[0]
            assert match_beam(table, point, normal, tuple(sensor[0]), tuple(at), (1.0, 0.0), gate, 0.5) == 0
            assert match_beam(table, point, normal, tuple(sensor[0]), tuple(at), (1.0, 0.0), 0.95 * gate, 0.5) == -1


@pytest.mark.kernel
def test_a_step_of_laying_a_scan_on_keyframes_is_the_dense_one():
    keyframes = np.array([[0.0, 0.0, 0.0], [0.5, -0.3, 2.6], [-0.4, 0.2, -1.0]])
    true = np.array([0.3, 0.25, 0.4])
    cloud, scan = cloud_at(keyframes), cloud_at(true[None], most=60)
    near = np.array([[2, 0, -1, 1]])
    start, width, gate, per_return = true + np.array([0.03, -0.02, 0.015]), 0.08, 3.0, 400.0
    sd = np.array([0.05, 0.05, 0.02])

    def laid(widths, begun=start):
        return refine_poses(
            begun[None], scan.lines, near, keyframes, cloud.lines, cloud.index(720), LineGate(gate, 0.5),
            np.array(widths), per_return, sd,
        )[0]  # fmt: skip

    def step(pose):
        W = np.diag(sd**-2)
        H, g = W.copy(), W @ (pose - start)
        for i in (2, 0, 1):
            rows = slice(cloud.start[i], cloud.start[i + 1])
            held = cloud.lined[rows]
            lines = se2.act(keyframes[i], cloud.points[rows][held])
            normals = cloud.normals[rows][held] @ se2.rotation(float(keyframes[i, 2])).T
            R = se2.rotation(float(pose[2]))
            for p, n in zip(scan.points[scan.lined], scan.normals[scan.lined], strict=True):
                x = pose[:2] + R @ p
                d = np.where(normals @ (R @ n) >= 0.5, np.hypot(*(lines - x).T), np.inf)
                k = int(np.argmin(d))
                if d[k] >= gate * width:
                    continue
                e = float(normals[k] @ (x - lines[k]))
                j = np.array([*normals[k], normals[k] @ np.array([-(R @ p)[1], (R @ p)[0]])])
                w = per_return * (width**2 / (width**2 + e**2)) ** 2
                H, g = H + w * np.outer(j, j), g + w * j * e
        return pose - np.linalg.solve(H, g)

    once = step(start)
    np.testing.assert_allclose(laid([width]), once, atol=1e-9)
    np.testing.assert_allclose(laid([width, width]), step(once), atol=1e-9)
    assert np.abs(se2.between(true, laid([width] * 6))).max() < 0.02


def test_keyframes_that_stand_wrong_are_moved_to_where_their_walls_agree():
    truth = around()
    rng = np.random.default_rng(1)
    wrong = truth + rng.normal(0, [0.04, 0.04, 0.02], truth.shape)
    wrong[0] = truth[0]
    back = joint_pass(steps_of(truth, wrong), cloud_at(truth), CFG)
    before, after = se2.between(truth, wrong), se2.between(truth, back)
    assert np.abs(after[0]).max() < 1e-3  # the first stays
    assert np.hypot(*after[:, :2].T).mean() < 0.25 * np.hypot(*before[:, :2].T).mean()
    assert np.hypot(*after[:, :2].T).max() < 0.025


def test_a_round_is_the_dense_step_of_steps_ties_and_all_pairs_that_enough_returns_tell(monkeypatch):
    truth = around(8)
    rng = np.random.default_rng(3)
    pose = truth + rng.normal(0, [0.02, 0.02, 0.01], truth.shape)
    steps, cloud = steps_of(truth, pose), cloud_at(truth, most=60)
    drift = se2.compose(steps.measured, rng.normal(0, 0.02, (7, 3)))
    steps = replace(steps, measured=np.asarray(drift))
    ties = PoseGraph.of(pose, [(1, 6)], [se2.between(truth[1], truth[6])], [np.diag([2e4, 1e4, 3e4])])
    given = {"BEFORE": 2, "AROUND": 2, "LEAST_MATCHES": 20, "LEAST_SHARE": 0.7, "SIGMA": 0.03, "TEMPER": 0.2}
    for name, value in given.items():
        monkeypatch.setattr(pass_module, f"JOINT_{name}", value)
    cfg = JointPassConfig(widths=(0.08,))
    x, n = pose.ravel(), len(pose)
    H, g = np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    H[:3, :3] = 1e8 * np.eye(3)
    edges = [(i, i + 1, drift[i], steps.information[i] + np.diag([400.0, 400.0, 1 / 0.03**2])) for i in range(7)]
    edges.append((1, 6, ties.measured[0], ties.information[0]))

    def added(i, j, W, pull):
        at, h = np.r_[3 * i : 3 * i + 3, 3 * j : 3 * j + 3], 1e-6
        moved = x[at] + np.concatenate([h * np.eye(6), -h * np.eye(6)])
        there = se2.between(moved[:, :3], moved[:, 3:])
        J = (there[:6] - there[6:]).T / (2 * h)
        H[np.ix_(at, at)] += J.T @ W @ J
        g[at] += J.T @ pull

    for i, j, z, information in edges:
        here, R = se2.between(pose[i], pose[j]), se2.turn(-float(z[2]))  # residuals are in the frame that is measured
        added(i, j, R.T @ information @ R, R.T @ information @ se2.between(z, here))
    counted, index, pairs = 0, cloud.index(JOINT_PASS_SECTORS), paired(pose)
    for i, j in [*pairs.tolist(), *pairs[:, ::-1].tolist()]:
        ends = np.array([i]), np.array([j]), np.asarray(se2.between(pose[i], pose[j]))[None]
        W, pull, _, near = match_pairs(
            *ends, cloud.lines, index, LineGate(JOINT_PASS_GATE * 0.08, JOINT_PASS_AGREE), 0.08
        )
        if near[0] >= 20 and near[0] >= 0.7 * cloud.lined[cloud.start[j] : cloud.start[j + 1]].sum():
            W, pull = without_scatter(W, pull, JOINT_PASS_BLUR)
            added(i, j, 0.2 / 0.03**2 * W[0], 0.2 / 0.03**2 * pull[0])
            counted += 1
    assert 4 < counted < 2 * len(pairs)
    wanted = (x - np.linalg.solve(H, g)).reshape(-1, 3)
    moved = se2.between(wanted, joint_pass(steps, cloud, cfg, ties))
    np.testing.assert_allclose(moved, 0.0, atol=1e-6)
    assert np.abs(wanted - pose).max() > 1e-3


def test_scans_are_laid_on_the_keyframes_around_them_but_not_on_themselves(monkeypatch):
    monkeypatch.setattr(pass_module, "SCAN_WIDTHS", (0.1, 0.06, 0.04, 0.04))
    truth = around()
    cloud = cloud_at(truth)
    rng = np.random.default_rng(2)
    poses = np.array([[0.2, 0.1, 0.4], [-0.6, 0.3, 2.0], *truth[:2]])
    scans = scan_cloud([seen(p) for p in poses], np.zeros((4, 2)), 90)
    start = poses + rng.normal(0, [0.03, 0.03, 0.015], poses.shape)
    own = np.array([-1, -1, 0, 1])
    laid = lay_scans(start, scans, truth, cloud, own)
    assert np.abs(se2.between(poses, laid)).max() < 0.02
    near = neighbours(poses, truth, 5, own)
    assert 0 not in near[2]
    assert 1 not in near[3]


@pytest.mark.parametrize("most", [1, 3, 90])
def test_a_cloud_holds_so_many_returns_of_every_keyframe_of_all_robots_from_its_first_to_its_last(most):
    robots = [graph(n=4), graph(n=6, light=False)]
    cloud = keyframe_cloud(robots, most)
    assert len(cloud) == 10
    keyframes = [(r, i) for r in robots for i in range(len(r))]
    for k, (r, i) in enumerate(keyframes):
        here, own = slice(cloud.start[k], cloud.start[k + 1]), r.rows(i)
        n = own.stop - own.start
        assert here.stop - here.start == min(n, most)
        at = own.start + np.arange(n) if n <= most else own.start + np.linspace(0, n - 1, most).round().astype(int)
        for name in ("points", "normals", "lined"):
            np.testing.assert_array_equal(getattr(cloud, name)[here], getattr(r, name)[at])
        np.testing.assert_array_equal(cloud.sensor[k], r.sensor[i])
    assert cloud.start[-1] == len(cloud.points)


def test_keyframes_are_paired_once_with_neighbours_in_the_drive_and_in_space(monkeypatch):
    pose = np.column_stack([np.arange(40) % 20, np.zeros(40), np.zeros(40)])  # the same way twice
    monkeypatch.setattr(pass_module, "JOINT_BEFORE", 2)
    monkeypatch.setattr(pass_module, "JOINT_AROUND", 3)
    pairs = paired(pose)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    held = {tuple(p) for p in pairs.tolist()}
    assert {(0, 1), (0, 2), (5, 25)} <= held
    assert (0, 3) not in held or JOINT_PASS_REACH >= 3  # by space only
    turned = pose.copy()
    turned[20:, 2] = np.pi  # looking back: nothing in common
    assert (5, 25) not in {tuple(p) for p in paired(turned).tolist()}


def test_information_along_a_bare_wall_that_only_noise_in_normals_gives_is_taken_away():
    H = np.array([np.diag([40.0, 1000.0, 300.0]), np.diag([900.0, 1000.0, 300.0])])
    g = np.array([[4.0, 10.0, 1.0], [4.0, 10.0, 1.0]])
    kept, gradient = without_scatter(H, g, 0.1)
    assert kept[0, 0, 0] == pytest.approx(0.0, abs=1e-9)
    assert gradient[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert kept[1, 0, 0] == pytest.approx(900.0 - 0.05 * 1900.0)
    assert kept[0, 2, 2] == 300.0
    assert kept[1, 1, 1] == pytest.approx(1000.0 - 0.05 * 1900.0)
    same, _ = without_scatter(H, g, 0.0)
    assert np.allclose(same, H)
    R = se2.turn(0.7)
    turned, pull = without_scatter(R @ H @ R.T, g @ R.T, 0.1)
    assert np.allclose(turned, R @ kept @ R.T)
    assert np.allclose(pull, gradient @ R.T)


def test_one_keyframe_or_scans_without_returns_are_no_error():
    truth = around(4)
    assert np.array_equal(joint_pass(steps_of(truth, truth[:1]), cloud_at(truth[:1]), CFG), truth[:1])
    blind = [b._replace(s=b.s[:0], normal=b.normal[:0], q=b.q[:0], support=b.support[:0]) for b in map(seen, truth)]
    cloud = scan_cloud(blind, np.zeros((4, 2)), 90)
    assert np.abs(joint_pass(steps_of(truth, truth), cloud, CFG) - truth).max() < 1e-9


def test_the_ends_of_two_robots_logs_are_no_neighbours_in_the_drive(monkeypatch):
    pose = np.column_stack([20.0 * np.arange(8), np.zeros(8), np.zeros(8)])
    monkeypatch.setattr(pass_module, "JOINT_BEFORE", 2)
    one = {tuple(p) for p in paired(pose).tolist()}
    two = {tuple(p) for p in paired(pose, np.array([0, 0, 0, 0, 1, 1, 1, 1])).tolist()}
    assert one - two == {(3, 4), (2, 4), (3, 5)}
    assert two < one
