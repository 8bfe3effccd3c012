"""Smoothing while logs play: the answer of smoothing at the end, from nothing but what was there by then."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.map_landmarks import closing_start, smooth_online
from mapweave.api.team import times_of
from mapweave.core import se2
from mapweave.core.workers import no_progress
from mapweave.evaluation.team import score_team
from mapweave.fusion.config import FuseConfig
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import grow
from mapweave.sim import landmarks as simulator
from mapweave.team.config import ONLINE_FAR, OnlineConfig, SmoothingConfig
from mapweave.team.smooth import smooth

from .teams import world

CFG, ONLINE = SmoothingConfig(), OnlineConfig()


def played(logs, online=ONLINE, cfg=CFG):
    looks = times_of(logs, online.fuse_every)
    grown = [grow(log, EkfSlamConfig(), looks, tracks=True) for log in logs]
    return smooth_online(logs, grown, FuseConfig(), cfg, online, {}, looks, no_progress)


@pytest.fixture(scope="module")
def run():
    return played(world(31, robots=3, minutes=2.0).logs)


def apart(a, b):
    """Root mean square distance [m] of two maps' landmarks and of their ways, laid over each other."""
    ids = [name for name in a.landmarks.ids if name in b.landmarks.ids]
    p, q = a.landmarks.select(ids).mean, b.landmarks.select(ids).mean
    T = se2.align(p, q)
    ways = []
    for robot in a.robots:
        track, other = a.tracks[robot], b.tracks[robot]
        there = se2.interpolate(other.t, track.t, se2.compose(T, track.pose))
        ways.append(np.square(there[:, :2] - other.pose[:, :2]).sum(axis=1))
    off = np.square(se2.act(T, p) - q).sum(axis=1)
    return float(np.sqrt(off.mean())), float(np.sqrt(np.concatenate(ways).mean()))


def test_what_stands_when_the_logs_end_is_what_smoothing_at_the_end_gives(run):
    """Within 15 mm of landmarks and ways on a log of two minutes; the filters' map that both begin from is far off."""
    w = world(31, robots=3, minutes=2.0)
    batch = smooth(w.map, w.logs, w.fusion.labels, CFG).map
    online = closing_start(run, w.map, ONLINE_FAR)
    landmarks, ways = apart(online, batch)
    assert landmarks < 0.015
    assert ways < 0.015
    filters = apart(w.map, batch)
    assert filters[0] > 3 * landmarks
    assert filters[1] > 10 * ways
    closed = smooth(online, w.logs, w.fusion.labels, CFG).map
    landmarks, ways = apart(closed, batch)
    assert landmarks < 0.015  # distances at the start weigh ranges, so that even this minimum is not quite the other
    assert ways < 0.01


def test_the_map_on_the_way_knows_nothing_of_what_came_later(run):
    w = world(31, robots=3, minutes=2.0)
    begin = min(log.span[0] for log in w.logs)
    cut = [log.until(begin + 65.0) for log in w.logs]
    early = played(cut)
    assert len(early.growth) >= 4
    for a, b in zip(early.growth, run.growth, strict=False):
        assert a.landmarks.ids == b.landmarks.ids
        np.testing.assert_allclose(a.landmarks.mean, b.landmarks.mean, atol=1e-6)


def test_a_step_costs_the_latest_stretches_and_not_the_log(run):
    settled = run.linearised[len(run.linearised) // 2 :]
    assert run.stretches >= 12
    assert settled.mean() < run.stretches / 2
    assert len(run.seconds) == len(run.lag) == 120
    assert (run.lag >= ONLINE.step).all()
    assert run.timing()["step_max"] >= run.timing()["step_p99"] >= run.timing()["step_mean"] > 0


def test_a_team_smoothed_online_is_as_sure_as_it_may_be(run):
    """The covariances are those of smoothing at the end (which other tests judge over many runs), to a quarter."""
    w = world(31, robots=3, minutes=2.0)
    batch = smooth(w.map, w.logs, w.fusion.labels, CFG).map
    done = smooth(closing_start(run, w.map, ONLINE_FAR), w.logs, w.fusion.labels, CFG).map
    np.testing.assert_allclose(np.diag(done.landmarks.cov), np.diag(batch.landmarks.cov), rtol=0.25)
    nees = score_team([done], {}, w.truth.survey, w.truth.robots).landmarks.nees_per_dof
    assert 0.3 < nees < 2.0


def test_robots_without_wheels_wait_for_the_end_and_it_is_told():
    w = world(31, robots=3, minutes=2.0)
    short = [log.until(log.span[0] + 25.0) for log in w.logs]
    logs = [replace(log, odometry=None) for log in short]
    run = played(logs)
    assert "no robot with wheels" in run.findings[0].text
    assert closing_start(run, w.map, ONLINE_FAR) is w.map
    mixed = played([short[0], short[1], logs[2]])
    assert tuple(f.text for f in mixed.findings) == ("--online: no wheels: smoothed when the logs ended: robot 3",)
    assert mixed.team.members
    assert "robot3" not in mixed.team.members


@pytest.mark.slow
def test_a_robot_put_down_elsewhere_is_cut_there_while_the_logs_play_too(monkeypatch, tmp_path):
    drive = simulator.drive_team

    def carried(*args, **options):
        first, own, *rest = drive(*args, **options)
        moved = se2.compose(np.array([1.5, 1.0, np.pi]), own.pose)
        return [first, replace(own, pose=np.where((own.t >= 90.0)[:, None], moved, own.pose)), *rest]

    monkeypatch.setattr(simulator, "drive_team", carried)
    mapweave.simulate_landmarks(tmp_path / "logs", robots=3, minutes=3, seed=101)
    done = mapweave.map(tmp_path / "logs", online=True, truth=[tmp_path / "logs"])
    assert done.maps[0].robots == ("robot1", "robot2", "robot3")
    assert any(w.startswith("robot 2: ") and "put down elsewhere at" in w for w in done.warnings)
    assert done.score.landmarks.rmse < 0.1
    assert max(score.ate for score in done.score.robots.values()) < 0.2
    assert done.run.ways_moved < 0.2  # of the stretch that was smoothed under way; the other has come in since
