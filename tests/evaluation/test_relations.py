"""Relations: the score as the contract says it, on made and on real trajectories."""

import gzip

import numpy as np
import pytest

from mapweave.api.evaluate import evaluate
from mapweave.core import se2
from mapweave.core.errors import ReaderError
from mapweave.core.records import Track
from mapweave.core.truth import Relations
from mapweave.evaluation.trajectory import exact_pairs, score_relations
from mapweave.io.landmark_truth import read_relations
from mapweave.io.tum import write_tum

KEYS = ["n", "used", "trans_mean", "trans_std", "trans_max", "rot_mean_deg", "rot_std_deg"]


def wander(n=40, seed=0):
    rng = np.random.default_rng(seed)
    return Track(np.arange(n) * 0.5, np.column_stack([rng.normal(0, 3, (n, 2)), rng.uniform(-3, 3, n)]))


def relations_of(track, pairs):
    i, j = np.array(pairs).T
    return Relations(track.t[i], track.t[j], se2.between(track.pose[i], track.pose[j]))


def test_a_trajectory_that_keeps_the_relations_scores_zero_wherever_it_lies():
    track = wander()
    moved = Track(track.t, se2.compose(np.array([5.0, -2.0, 1.0]), track.pose))
    score = score_relations(moved, relations_of(track, [(0, 3), (7, 2), (11, 30)]))
    assert (score.n, score.used) == (3, 3)
    assert score.trans_max < 1e-9
    assert score.rot_mean_deg < 1e-9


def test_an_error_is_the_estimate_seen_from_the_relation():
    track = wander()
    relations = relations_of(track, [(4, 9), (9, 4), (1, 2)])
    wrong = track.pose.copy()
    wrong[9] = se2.compose(wrong[9], np.array([0.3, 0.4, 0.1]))
    score = score_relations(Track(track.t, wrong), relations)
    by_hand = [
        se2.compose(se2.inverse(r), se2.compose(se2.inverse(a), b))
        for r, a, b in zip(relations.pose, wrong[[4, 9, 1]], wrong[[9, 4, 2]], strict=True)
    ]
    trans = [np.hypot(e[0], e[1]) for e in by_hand]
    rot = [abs(np.degrees(e[2])) for e in by_hand]
    assert trans[0] == pytest.approx(0.5)
    assert score.trans_mean == pytest.approx(np.mean(trans))
    assert score.trans_std == pytest.approx(np.std(trans))
    assert score.trans_max == pytest.approx(max(trans))
    assert score.rot_mean_deg == pytest.approx(np.mean(rot))
    assert score.rot_std_deg == pytest.approx(np.std(rot))


def test_a_relation_counts_only_with_a_pose_within_6_ms_at_both_ends():
    track = wander()
    t1 = np.array([1.0, 1.0055, 1.0065, -0.0055, 500.0])
    relations = Relations(t1, np.full(5, 2.0), np.zeros((5, 3)))
    assert score_relations(track, relations).used == 3
    nothing = score_relations(track, relations.select(np.arange(5) == 4))
    assert nothing.as_json() == dict.fromkeys(KEYS) | {"n": 1, "used": 0}


def test_exact_pairs_have_both_ends_within_a_millisecond_of_a_scan_with_right_stamps():
    relations = Relations(np.array([1.0, 1.0, 1.0]), np.array([2.0005, 3.0, 4.002]), np.zeros((3, 3)))
    t, hosts = np.array([1.0, 2.0, 3.0, 4.0]), ["flirt", "gfs", "mrpt", "gfs"]
    assert exact_pairs(relations, t, hosts).tolist() == [True, False, False]
    assert not exact_pairs(relations, t, ["robot"] * 4).any()


def written_result(folder, track, hosts):
    (folder / "metrics.json").write_text('{"version": "0"}')
    write_tum(folder / "trajectories" / "robot1.tum", track)
    rows = "".join(f"{t:.6f},{h}\n" for t, h in zip(track.t, hosts, strict=True))
    (folder / "scans.csv").write_text("t,host\n" + rows)


def test_evaluate_finds_the_robot_and_the_hosts_in_a_result_folder(tmp_path):
    track = wander()
    written_result(tmp_path, track, ["flirt"] * 20 + ["mrpt"] * 20)
    relations = relations_of(track, [(0, 3), (5, 30), (31, 32)])
    path = tmp_path / "some.relations.gz"
    rows = [
        f"{a:.6f} {b:.6f} {p[0]} {p[1]} 0 0 0 {p[2]}"
        for a, b, p in zip(relations.t1, relations.t2, relations.pose, strict=True)
    ]
    path.write_bytes(gzip.compress("\n".join(["# t1 t2", *rows]).encode()))
    found = evaluate(tmp_path, path)
    told = found.as_json()
    assert list(told["relations"]) == KEYS
    assert told["relations"]["used"] == 3
    assert told["relations_exact"]["n"] == 1
    assert told["relations"]["trans_max"] < 1e-5
    assert len(found.lines()) == 2


def test_a_row_that_is_no_relation_is_named(tmp_path):
    path = tmp_path / "bad.relations"
    path.write_text("1 2 0 0 0 0 0 0\n1 2 0 0\n")
    with pytest.raises(ReaderError, match=r"bad\.relations:2: expected 8 finite numbers"):
        read_relations(path)


@pytest.mark.data
def test_the_trajectory_of_another_program_scores_what_was_published_of_it(data):
    relations = read_relations(data / "carmen" / "intel.relations.gz")
    rows = []
    with gzip.open(data / "carmen" / "intel.gfs.log.gz", "rt") as file:
        for line in file:
            w = line.split()
            if w[0] == "ODOM" and float(w[7]) > 0:
                rows.append([w[7], *w[1:4]])
            elif w[0] == "FLASER":
                rows.append([w[-3], *w[185:188]])
    poses = np.array(rows, float)
    poses = poses[np.argsort(poses[:, 0], kind="stable")]
    poses = poses[np.append(np.diff(poses[:, 0]) > 0, True)]
    score = score_relations(Track(poses[:, 0] + 976052857.337284, poses[:, 1:]), relations)
    assert score.used == len(relations) == 2984
    assert abs(score.trans_mean - 0.057) < 0.008
    assert abs(score.rot_mean_deg - 2.3) < 0.3


@pytest.mark.data
def test_raw_odometry_scores_metres_on_the_real_relations_and_373_of_them_are_exact(data):
    from mapweave.io.laser_logs import read_laser

    log = read_laser(data / "carmen" / "intel.clf.gz")
    relations = read_relations(data / "carmen" / "intel.relations.gz")
    t = np.concatenate([log.odometry.t, log.scan_t])
    pose = np.concatenate([log.odometry.pose, [s.odometry for s in log.scans]])
    order = np.argsort(t, kind="stable")
    last = np.append(np.diff(t[order]) > 0, True)
    track = Track(t[order][last], pose[order][last])
    exact = relations.select(exact_pairs(relations, log.scan_t, [s.host for s in log.scans]))
    assert len(exact) == 373
    assert score_relations(track, exact).trans_mean == pytest.approx(3.3, abs=0.1)
    assert score_relations(track, relations).trans_mean == pytest.approx(7, abs=0.5)
