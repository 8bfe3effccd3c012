"""Mapping by a graph: loops found again, what it hands over, and the files it leaves."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.laser_log import LaserLog
from mapweave.core.records import Track
from mapweave.io.g2o import read_g2o
from mapweave.io.laser_map import write_laser_map
from mapweave.io.robot_graph import NAME, read_robot_graph
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.keyframe_graph import KeyframeGraph, KeyframeGraphConfig
from mapweave.mapping.laser_mapping import map_laser

from .buildings import drive, lap, ring

GRAPH = LaserConfig(method="graph", feature="none")


def without(**switches):
    return replace(GRAPH, graph=replace(GRAPH.graph, **switches))


@pytest.fixture(scope="module")
def log_and_truth():
    way = lap()
    run = drive(ring(seed=1), [(*way[0], 0.0)], [way[1:]], 1)
    scans = tuple(scan[0] for scan in run.scans)
    t = np.array(run.t)
    log = LaserLog("1", "ring", t, scans, Track(t, np.array([s.odometry for s in scans])))
    return log, run.truth[:, 0]


@pytest.fixture(scope="module")
def mapped(log_and_truth):
    return map_laser(log_and_truth[0], GRAPH, 0)


def errors(made, truth):
    """[m] of the position at every scan, both ways seen from the first pose."""
    e = se2.between(truth[0], truth)[:, :2] - se2.between(made.scans.pose[0], made.scans.pose)[:, :2]
    return np.hypot(*e.T)


def test_a_loop_is_closed_and_the_way_round_it_ends_where_it_began(log_and_truth, mapped):
    log, truth = log_and_truth
    open_ = map_laser(log, without(loops=False), 0)
    assert not open_.graph.closures
    accepted = [c for c in mapped.graph.closures if c.accepted]
    assert accepted
    at = np.searchsorted(log.scan_t, mapped.graph.t)
    for c in accepted:
        true = se2.between(truth[at[c.first]], truth[at[c.second]])
        assert np.hypot(*se2.between(true, c.measured)[:2]) < 0.15
    ended = slice(-20, None)
    assert errors(mapped, truth)[ended].max() < 0.3
    assert errors(mapped, truth)[ended].mean() < max(0.5 * errors(open_, truth)[ended].mean(), 0.1)


@pytest.mark.slow
def test_the_same_log_gives_the_same_bytes_whatever_seed_and_threads(log_and_truth, mapped):
    again = map_laser(log_and_truth[0], replace(GRAPH, threads=1), 5)
    assert np.array_equal(again.track.pose, mapped.track.pose)
    assert np.array_equal(again.track.cov, mapped.track.cov)


def test_every_pose_has_a_covariance_that_grows_from_the_start(log_and_truth, mapped):
    cov = mapped.track.cov
    assert cov.shape == (len(mapped.track.t), 3, 3)
    assert (np.linalg.eigvalsh(cov) > 0).all()
    sd = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
    assert sd[0] < 0.01
    assert 5 * sd[0] < sd.max() < 5.0
    e = errors(mapped, log_and_truth[1])
    assert np.mean(e**2 / np.maximum(sd[np.searchsorted(mapped.track.t, mapped.scans.t)] ** 2, 1e-6)) < 2.0


def test_the_graph_of_keyframes_is_what_the_files_hold(mapped, tmp_path):
    write_laser_map(tmp_path, mapped)
    graph = read_g2o(tmp_path / "pose_graph.g2o")
    n, accepted = len(mapped.graph), sum(c.accepted for c in mapped.graph.closures)
    assert (len(graph), graph.edges) == (n, n - 1 + accepted)
    back = read_robot_graph(tmp_path / NAME)
    assert np.array_equal(back.pose, mapped.graph.pose)
    assert np.abs(back.points - mapped.graph.points).max() < 1e-5
    lines = (tmp_path / "closures.csv").read_text().splitlines()
    assert lines[0] == "robot_a,stamp_a,robot_b,stamp_b,x,y,theta,score,second,share,nis,accepted,reason"
    assert len(lines) == 1 + len(mapped.graph.closures)
    assert np.isin(mapped.graph.t, mapped.track.t).all()


def test_an_empty_graph_has_no_covariances():
    assert KeyframeGraph(KeyframeGraphConfig(), np.zeros((1, 3))).covariances().shape == (0, 3, 3)
