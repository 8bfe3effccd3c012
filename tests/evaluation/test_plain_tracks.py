"""Two TUM files are scored as evo scores them."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mapweave


def written(path, t, xyz, q):
    np.savetxt(path, np.column_stack([t, xyz, q]), fmt="%.17g", header="t x y z qx qy qz qw")
    return path


@pytest.fixture
def tracks(tmp_path):
    """A true trajectory in space, and an estimate of other stamps, frame and length that wanders off."""
    rng = np.random.default_rng(7)
    t = 1.3e9 + np.arange(200) * 0.1
    xyz = np.column_stack([np.cos(0.05 * np.arange(200)), np.sin(0.05 * np.arange(200)), 0.01 * np.arange(200)]) * 5
    turn = Rotation.from_euler("zyx", np.column_stack([0.05 * np.arange(200), 0.1 * np.sin(t), 0.05 * np.cos(t)]))
    away = Rotation.from_euler("zyx", [0.7, 0.1, -0.2])
    noisy = np.array([3.0, -2.0, 0.5]) + away.apply(xyz + np.cumsum(rng.normal(0, 0.02, xyz.shape), 0))
    estimate = np.column_stack([noisy, (away * turn * Rotation.from_rotvec(rng.normal(0, 0.02, (200, 3)))).as_quat()])
    late = t + rng.uniform(-0.008, 0.008, 200)
    late[50:60] += 0.03  # with none of the truth
    keep = np.arange(200) % 7 != 3
    truth = written(tmp_path / "truth.tum", t, xyz, turn.as_quat())
    return written(tmp_path / "estimate.tum", late[keep], estimate[keep, :3], estimate[keep, 3:]), truth


def by_the_formulas(estimate, truth):
    """[Sturm12] eqs. 1 to 6 one pose after the other, and the motion that fits best by Kabsch on its own."""
    a, b = np.loadtxt(estimate), np.loadtxt(truth)
    pairs = [(k, int(np.argmin(abs(b[:, 0] - t)))) for k, t in enumerate(a[:, 0]) if abs(b[:, 0] - t).min() <= 0.01]
    matrices = []
    for row in [a[k] for k, _ in pairs], [b[k] for _, k in pairs]:
        T = np.tile(np.eye(4), (len(row), 1, 1))
        for k, x in enumerate(row):
            T[k, :3, :3], T[k, :3, 3] = Rotation.from_quat(x[4:]).as_matrix(), x[1:4]
        matrices.append(T)
    E, T = matrices
    turn, _ = Rotation.align_vectors(T[:, :3, 3] - T[:, :3, 3].mean(0), E[:, :3, 3] - E[:, :3, 3].mean(0))
    moved = turn.apply(E[:, :3, 3] - E[:, :3, 3].mean(0)) + T[:, :3, 3].mean(0)
    inv = np.linalg.inv
    F = [inv(inv(T[k]) @ T[k + 1]) @ (inv(E[k]) @ E[k + 1]) for k in range(len(T) - 1)]
    angle = lambda M: np.degrees(np.arccos(np.clip((np.trace(M[:3, :3]) - 1) / 2, -1, 1)))
    return len(pairs), {
        "ape": np.linalg.norm(E[:, :3, 3] - T[:, :3, 3], axis=1),
        "ape_aligned": np.linalg.norm(moved - T[:, :3, 3], axis=1),
        "ape_rotation": np.array([angle(inv(t) @ e) for t, e in zip(T, E, strict=True)]),
        "rpe": np.array([np.linalg.norm(f[:3, 3]) for f in F]),
        "rpe_rotation": np.array([angle(f) for f in F]),
    }


def test_ape_and_rpe_are_those_of_the_formulas(tracks):
    n, errors = by_the_formulas(*tracks)
    score = mapweave.evaluate(*tracks).as_json()
    assert score["n"] == n < 171
    for name, e in errors.items():
        near = 1e-6 if "rotation" in name else 1e-9  # an arc cosine loses half the digits
        assert score[name]["rmse"] == pytest.approx(np.sqrt((e**2).mean()), abs=near)
        assert score[name]["std"] == pytest.approx(e.std(), abs=near)
        assert (score[name]["median"], score[name]["max"]) == pytest.approx((np.median(e), e.max()), abs=near)
    assert score["ape_aligned"]["rmse"] < 0.3 < score["ape"]["rmse"]
    assert json.loads(json.dumps(score)) == score


def test_the_numbers_are_those_of_evo(tracks):
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    estimate, truth = (file_interface.read_tum_trajectory_file(str(path)) for path in tracks)
    truth, estimate = sync.associate_trajectories(truth, estimate)
    score = mapweave.evaluate(*tracks).as_json()
    relation = metrics.PoseRelation
    for name, metric in {
        "ape": metrics.APE(relation.translation_part),
        "ape_rotation": metrics.APE(relation.rotation_angle_deg),
        "rpe": metrics.RPE(relation.translation_part),
        "rpe_rotation": metrics.RPE(relation.rotation_angle_deg),
    }.items():
        metric.process_data((truth, estimate))
        statistics = metric.get_all_statistics()
        assert {k: statistics[k] for k in score[name]} == pytest.approx(score[name], abs=1e-9)
    estimate.align(truth)
    aligned = metrics.APE(relation.translation_part)
    aligned.process_data((truth, estimate))
    assert aligned.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(score["ape_aligned"]["rmse"], abs=1e-9)


def test_a_planar_trajectory_a_pair_of_one_pose_and_other_times(tmp_path):
    q = np.tile([0.0, 0.0, 0.0, 1.0], (4, 1))
    flat = np.column_stack([np.arange(4.0), [0.0, 1.0, 0.0, 2.0], np.zeros(4)])
    a = written(tmp_path / "a.tum", np.arange(4.0), flat, q)
    turned = written(tmp_path / "b.tum", np.arange(4.0), flat[:, [1, 0, 2]] * [-1, 1, 1], q)
    assert mapweave.evaluate(a, turned).as_json()["ape_aligned"]["max"] < 1e-12
    one = written(tmp_path / "one.tum", [2.0], [[0.0, 0.0, 0.0]], q[:1])
    score = mapweave.evaluate(one, a).as_json()
    assert (score["n"], score["ape"]["rmse"], score["rpe"]) == (1, 2.0, None)
    late = written(tmp_path / "late.tum", np.arange(4.0) + 0.5, flat, q)
    with pytest.raises(mapweave.DataError, match=r"no stamp of late\.tum is within 10 ms of one of the truth"):
        mapweave.evaluate(late, a)
    with pytest.raises(mapweave.UsageError, match="expected one TUM trajectory"):
        mapweave.evaluate(a, [a, a])


def test_a_mirrored_truth_is_told_though_turning_it_over_fits(tmp_path):
    t, q = np.arange(50.0), np.tile([0.0, 0.0, 0.0, 1.0], (50, 1))
    bent = np.column_stack([t, 3.0 * np.sin(t / 7) + t**2 / 50, np.zeros(50)])
    away = np.array([9.0, 2.0, 0.0])
    for way, mirrored in ((bent, True), (bent * [1.0, 1e-9, 1.0], False)):  # a straight way is its own mirror image
        own, turned = (
            written(tmp_path / "own.tum", t, way, q),
            written(tmp_path / "b.tum", t, way[:, [1, 0, 2]] + away, q),
        )
        score = mapweave.evaluate(own, turned)
        assert score.as_json()["ape_aligned"]["max"] < 1e-6
        assert [line for line in score.lines() if "mirrored" in line] == [f"warning: {w}" for w in score.doubts]
        assert (len(score.doubts) == 1) == mirrored
