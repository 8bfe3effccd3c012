"""Laps over laps of one hall: the graph grows no further, and what it says stays true."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.slam import LaserSlam
from mapweave.core import se2
from mapweave.io.robot_graph import read_robot_graph, write_robot_graph
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.known_places import KnownPlacesConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.mapping.woven_map import placed_track
from mapweave.sim.laser import DriftConfig, DriveConfig, Scanner, WallStyle, WorldBuilder, drive, ring

WIDE, HIGH, CORNER = 6.0, 4.0, 1.0
LAP = 2 * (WIDE + HIGH) - (8 - 2 * np.pi) * CORNER
LAPS, SETTLED = 8, 5
GRAPH = LaserConfig(method="graph", feature="none")
EASY = replace(GRAPH, graph=replace(GRAPH.graph, known_places=KnownPlacesConfig(enough=12)))


def laps():
    """A bare hall with a few boxes, and a robot that goes round and round in it."""
    build = WorldBuilder("hall", WallStyle(), np.random.default_rng(5))
    x0, y0, x1, y1 = -4.0, -2.0, 6.0, 6.0
    for a, b in (((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)), ((x0, y1), (x0, y0))):
        build.plain(a, b)
    for box in ((-3.8, -2.0, 0.7, 0.5), (0.3, 1.4, 0.9, 0.6), (5.2, 1.0, 0.8, 1.3), (-1.0, 5.4, 1.6, 0.6)):
        build.box(*box, 0.5)
    cfg = DriveConfig(
        scanner=Scanner(beams=48, far=8.0), drift=DriftConfig(end_error=None), odometry_every=0.25, scan_every=0.25
    )
    return drive(build.world(), ring(WIDE, HIGH, CORNER, LAPS * LAP, 2.0), cfg, 1)


@pytest.fixture(scope="module")
def sim():
    return laps()


@pytest.fixture(scope="module")
def sizes_and_slam(sim):
    """(keyframes, closures tried, scans kept with their ranges) at the end of each lap, and what was fed."""
    slam, sizes = LaserSlam(EASY), []
    ends = sim.log.scan_t[0] + np.arange(1, LAPS + 1) * LAP / DriveConfig().speed
    for t, scan in zip(sim.log.scan_t.tolist(), sim.log.scans, strict=True):
        slam.add_scan(t, scan.ranges, scan.angles(), odometry=scan.odometry, range_max=scan.range_max)
        if len(sizes) < LAPS and t >= ends[len(sizes)] - 1e-6:
            graph = slam.graph()
            kept = sum(bool(len(scan.ranges)) for scan in slam._session.scans)
            sizes.append((len(graph), len(graph.closures), kept))
    return np.array(sizes), slam


@pytest.fixture(scope="module")
def mapped(sim):
    return map_laser(sim.log, EASY, 0)


def missed(made, sim):
    """(n, 3) of the poses at every stamp, seen from the first, and NEES a degree of freedom."""
    true = sim.truth.pose[np.searchsorted(sim.truth.t, made.track.t)]
    e = se2.between(made.track.pose[0], made.track.pose) - se2.between(true[0], true)
    e[:, 2] = se2.wrap_angle(e[:, 2])
    return e, np.einsum("ni,nij,nj->n", e, np.linalg.inv(made.track.cov), e)[1:] / 3.0


@pytest.mark.slow
def test_keyframes_closures_and_scans_are_bounded_whatever_the_laps(sizes_and_slam):
    sizes, _ = sizes_and_slam
    lap = sizes[0, 0]
    assert (np.diff(sizes[:3, 0]) > 0.7 * lap).all()  # at first every lap tells something
    assert (sizes[SETTLED:, 0] <= sizes[SETTLED - 1, 0] + 20).all()
    assert (sizes[SETTLED:, 1] <= sizes[SETTLED - 1, 1] + 8).all()
    assert (sizes[SETTLED:, 2] <= sizes[SETTLED - 1, 2] + 0.7 * len(sizes_and_slam[1]) / LAPS).all()


@pytest.mark.slow
def test_what_left_is_told_and_the_way_is_as_true_as_with_all_keyframes(sim, mapped):
    whole = map_laser(sim.log, replace(EASY, graph=replace(EASY.graph, known_places=KnownPlacesConfig(enough=0))), 0)
    assert "keyframe in a place known well" not in whole.dropped
    left = mapped.dropped["keyframe in a place known well"]
    assert left == len(mapped.graph.revisits) == len(whole.graph) - len(mapped.graph) > 2 * LAP / 0.4
    assert mapped.dropped["closure of such a keyframe"] > 10
    (ours, sure), (all_, _) = missed(mapped, sim), missed(whole, sim)
    rms = [np.sqrt(np.mean(e[:, :2] ** 2) * 2) for e in (ours, all_)]
    assert rms[0] < rms[1] + 0.02  # the map is made of a third of the keyframes, and its first pose holds the frame
    assert sure.mean() < 1.0
    assert np.abs(ours[:, :2]).max() < 0.25


def test_poses_that_left_hang_on_the_map_and_are_never_surer_than_it(mapped):
    graph = mapped.graph
    revisits = graph.revisits
    cov = revisits.covariances(graph.pose, graph.cov)
    turn = se2.wrap_angle(revisits.poses(graph.pose)[:, 2] - graph.pose[revisits.at, 2])
    assert (np.linalg.eigvalsh(cov) > 0).all()
    assert (cov[:, 2, 2] > graph.cov[revisits.at, 2, 2]).all()
    assert np.abs(turn).max() < np.pi
    at = np.searchsorted(mapped.track.t, revisits.t)
    assert np.allclose(mapped.track.cov[at], cov)
    moved = graph.moved(np.array([3.0, -2.0, 1.0]))
    t, pose, _ = moved.way()
    assert (np.diff(t) > 0).all()
    assert np.allclose(pose, se2.compose(np.array([3.0, -2.0, 1.0]), graph.way()[1]))


@pytest.mark.slow
def test_scans_one_by_one_and_from_a_log_give_the_same_way(sizes_and_slam, mapped, sim):
    made = sizes_and_slam[1].result().maps[0]
    assert np.array_equal(made.track.pose, mapped.track.pose)
    assert np.array_equal(made.track.cov, mapped.track.cov)
    assert made.scan_hash == sim.log.scan_hash()
    assert made.warnings == mapped.warnings


@pytest.mark.slow
def test_of_scans_that_were_let_go_numbers_alone_are_kept_and_the_log_has_them(sizes_and_slam, sim):
    slam = sizes_and_slam[1]
    gone = [k for k, raw in enumerate(slam._stream._raw) if not raw.kept]
    assert len(gone) > 0.3 * len(slam)
    assert len({id(slam._stream._raw[k]) for k in gone}) == 1
    assert len({id(slam._session.scans[k]) for k in gone}) == 1
    log = slam._stream.log()
    assert np.array_equal(log.scan_t, sim.log.scan_t)
    assert all(np.array_equal(a.odometry, b.odometry) for a, b in zip(log.scans, sim.log.scans, strict=True))
    assert {len(log.scans[k].ranges) for k in gone} == {0}


def test_where_the_map_is_moved_among_others_the_whole_way_moves_with_it(mapped):
    shift, graph = np.array([-3.0, 8.0, 2.0]), mapped.graph
    moved = placed_track(mapped, np.asarray(se2.compose(shift, graph.pose)), graph.moved(shift).cov)
    e = se2.between(moved.pose, se2.compose(shift, mapped.track.pose))
    assert np.abs(e).max() < 1e-9
    assert np.allclose(moved.cov, se2.turned_covariance(2.0, mapped.track.cov))


def test_a_file_holds_the_poses_that_left(mapped, tmp_path):
    write_robot_graph(tmp_path / "g.npz", mapped.graph)
    back = read_robot_graph(tmp_path / "g.npz").revisits
    for name in ("t", "at", "step", "cov", "closures"):
        assert np.array_equal(getattr(back, name), getattr(mapped.graph.revisits, name))
