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
from mapweave.laser import submap_loops
from mapweave.laser.config import LaserConfig
from mapweave.laser.keyframe_graph import KeyframeGraph, KeyframeGraphConfig
from mapweave.laser.mapping import map_laser
from mapweave.laser.submap_loops import SubmapLoopConfig, SubmapLoops
from mapweave.laser.submaps import query_at, submap_around

from .buildings import drive, lap, ring
from .test_closures import seen

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


def test_the_same_log_gives_the_same_bytes_however_few_submaps_are_kept_built(log_and_truth, mapped, monkeypatch):
    monkeypatch.setattr(submap_loops, "BUILT", 1)
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


def test_two_places_that_fit_alike_are_told_and_refused():
    """A query laid between two copies of its room: either could be meant."""
    b = seen([0.0, 0.0, 0.0])
    poses = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0]])
    cfg = SubmapLoopConfig(window=2.0)
    submap = submap_around(poses, [b.s, b.s], 0, None, cfg.submap, cfg.place)
    query = query_at(np.zeros((1, 3)), [b.s], 0, None, cfg.submap)
    wide = np.diag([1.0, 1.0, 0.1])
    loops = SubmapLoops(cfg)
    both = loops.match(submap, query, np.array([0.6, 0.0, 0.0]), wide, 2.0)
    assert not both.accepted
    assert "two places fit alike" in both.reason
    alone = submap_around(poses[:1], [b.s], 0, None, cfg.submap, cfg.place)
    one = loops.match(alone, query, np.array([0.6, 0.0, 0.0]), wide, 2.0)
    assert one.accepted
    assert np.hypot(*one.measured[:2]) < 0.05
    sure = loops.match(alone, query, np.array([0.6, 0.0, 0.0]), np.diag([1e-4, 1e-4, 1e-4]), 2.0)
    assert not sure.accepted
    assert "standard deviations" in sure.reason


def test_an_empty_graph_has_no_covariances():
    assert KeyframeGraph(KeyframeGraphConfig(), np.zeros((1, 3))).covariances().shape == (0, 3, 3)
