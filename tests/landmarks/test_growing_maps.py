"""Maps handed over while a log plays: each is what the log until then gives, though no row is played twice."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.landmarks import ekf_slam
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import grow, local_map

from .robot_worlds import drive

TIMES = [999.0, 1000.5, 1007.0, 1007.3, 1019.75, 1100.0]


def assert_same(a, b):
    assert a.robot == b.robot
    assert a.submap.ids == b.submap.ids
    for name in ("pose", "mean", "cov"):
        np.testing.assert_array_equal(getattr(a.submap, name), getattr(b.submap, name))
    np.testing.assert_array_equal(a.track.t, b.track.t)
    assert a.log_hash == b.log_hash
    assert a.robot_sightings.target == b.robot_sightings.target
    assert a.sightings == b.sightings


@pytest.mark.parametrize("odometry", [True, False])
def test_a_map_on_the_way_is_the_map_of_the_log_until_then(odometry):
    log, _ = drive(21, 40.0)
    seen = replace(log.sightings, ids=("robot2", *log.sightings.ids[1:]))
    log = replace(log, sightings=seen, odometry=log.odometry if odometry else None)
    maps = grow(log, EkfSlamConfig(), TIMES, tracks=True).maps
    assert len(maps) == len(TIMES)
    assert maps[0] is None
    assert maps[1] is None  # driven, and nothing seen often enough
    for t, m in zip(TIMES[2:], maps[2:], strict=True):
        assert_same(m, local_map(log.until(t)))
    assert len(maps[-1].robot_sightings.t) > 0


def test_every_row_is_played_once_however_many_maps_are_taken(monkeypatch):
    log, _ = drive(22, 40.0)
    rows = []
    step = ekf_slam.step

    def counted(state, event, cfg, rng):
        rows.append(len(event.record.t) + len(event.record.odometry.t))
        return step(state, event, cfg, rng)

    monkeypatch.setattr(ekf_slam, "step", counted)
    grown = grow(log, EkfSlamConfig(), np.linspace(1000.0, 1040.0, 50).tolist())
    assert sum(m is not None for m in grown.maps) > 40
    assert sum(rows) == len(log)
    monkeypatch.undo()
    whole = local_map(log)
    assert_same(grown.whole, whole)
    np.testing.assert_array_equal(grown.whole.track.pose, whole.track.pose)
    np.testing.assert_array_equal(grown.whole.track.cov, whole.track.cov)


def test_without_wheels_pieces_that_ended_are_not_played_again(monkeypatch):
    """Beyond the whole map's own two runs a piece, rows are handled a bounded number of times, however many maps."""
    log, _ = drive(24, 120.0)
    s = log.sightings
    blinks = (s.t - s.t[0]) % 20.0 < 12.0
    log = replace(log, sightings=s.select(blinks), odometry=None)
    rows = []
    step = ekf_slam.step

    def counted(state, event, cfg, rng):
        rows.append(len(event.record.t))
        return step(state, event, cfg, rng)

    monkeypatch.setattr(ekf_slam, "step", counted)
    handled = []
    for n in (40, 160):
        rows.clear()
        grow(log, EkfSlamConfig(), np.linspace(*log.span, n).tolist())
        handled.append(sum(rows))
    assert handled[1] < 1.5 * handled[0]
    assert handled[1] < 20 * len(log)


def test_a_landmark_that_moves_is_left_out_of_every_map_that_knows_it():
    log, _ = drive(23, 60.0)
    s, rng = log.sightings, np.random.default_rng(0)
    bearing, distance = np.array(s.bearing), np.array(s.range)
    moving = s.what == s.what[0]
    bearing[moving] = rng.uniform(-1.2, 1.2, moving.sum())
    distance[moving] = rng.uniform(0.5, 5.0, moving.sum())
    log = replace(log, sightings=replace(s, bearing=bearing, range=distance))
    name = s.ids[s.what[0]]
    *_, last = grow(log, EkfSlamConfig(agree=1), [1030.0, 1060.0], tracks=True).maps
    assert name not in last.submap.ids
    assert len(last.submap.ids) >= 3
    assert last.submap.cov.shape == (3 + 2 * len(last.submap.ids),) * 2
    assert np.linalg.eigvalsh(last.submap.cov).min() > -1e-9
