"""Sightings that the same robot's others contradict: found without a map, and none where nothing is wrong."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

import mapweave
from mapweave.api.evaluate import read_team_truth
from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry
from mapweave.evaluation.consistency import mean_or_none
from mapweave.evaluation.team import score_team
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.agreement import sifted, witnesses
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import local_map

EKF = EkfSlamConfig()
TEAM = {"lasers": 0, "cameras": 2, "bearings": 0, "calibration": "random", "minutes": 3.0, "seed": 11}


@cache
def logs(outliers: float) -> tuple[LandmarkLog, ...]:
    with TemporaryDirectory() as folder:
        mapweave.simulate_team(Path(folder) / "team", outliers=outliers, **TEAM)
        return tuple(read_landmark_logs(Path(folder) / "team", None))


def rows(log: LandmarkLog) -> set[tuple[float, str, float]]:
    seen = log.sightings
    return {(t, seen.ids[k], r) for t, k, r in zip(seen.t, seen.what, seen.range, strict=True)}


def test_wrong_sightings_go_and_right_ones_stay():
    for clean, dirty in zip(logs(0.0), logs(0.3), strict=True):
        right, left = rows(clean) & rows(dirty), rows(sifted(dirty, EKF))
        assert len(right) < 0.75 * len(rows(dirty))
        assert len(left & right) > 0.97 * len(right)
        assert len(left & right) > 0.94 * len(left)


@pytest.mark.parametrize("looked_at", ["robot2", "L1"])
def test_a_name_read_a_few_times_off_another_is_kept_where_it_truly_stands_alone(looked_at):
    rng = np.random.default_rng(4)
    seen = [(0.2 * k, looked_at, 5.0, 0.3) for k in range(50)]
    seen += [(t, "L2", 5.0, 0.3) for t in (4.0, 4.4, 4.8)]  # what was looked at, misread
    seen += [(40.0 + 0.2 * k, "L2", 3.0, -1.0) for k in range(8)]
    scattered = rng.uniform((1, -3), (9, 3), (30, 2))
    seen += [(10.0 + k, "L2", *z) for k, z in enumerate(scattered.tolist())]
    seen.sort()
    t, names, ranges, bearings = zip(*seen, strict=True)
    ids = (looked_at, "L2")
    table = SightingTable(
        np.array(t), np.array([ids.index(n) for n in names]), np.array(ranges), np.array(bearings), ids
    )
    still = Odometry(np.arange(0.0, 50.0, 0.5), np.zeros(100), np.zeros(100))
    kept = sifted(LandmarkLog("robot1", still, table), EKF).sightings
    l2 = kept.select(kept.what == 1)
    assert len(kept) - len(l2) == 50
    np.testing.assert_array_equal(l2.range, np.full(8, 3.0))
    assert (l2.t >= 40.0).all()


def test_what_is_left_out_is_counted_and_told():
    dirty = logs(0.3)[0]
    done = sifted(dirty, EKF)
    gone = len(dirty.sightings) - len(done.sightings)
    assert done.dropped["sighting: contradicted"] == gone
    assert done.warnings[-1].startswith(f"{gone} of {len(dirty.sightings)} sightings contradict")


def test_a_clean_log_comes_back_as_it_is():
    for log in logs(0.0):
        assert sifted(log, EKF) is log


def mislabelled(log: LandmarkLog, share: float) -> LandmarkLog:
    """The log with that share of its names drawn anew."""
    rng = np.random.default_rng(7)
    seen = log.sightings
    wrong = rng.random(len(seen)) < share
    return replace(log, sightings=replace(seen, what=np.where(wrong, rng.permutation(seen.what), seen.what)))


@pytest.mark.parametrize("share", [0.08, 0.2])
def test_wrong_names_scattered_over_all_are_found(share):
    """Most have no sighting of their name near that could contradict them: few contradictions tell of many."""
    clean = logs(0.0)[0]
    dirty = mislabelled(clean, share)
    right, left = rows(clean) & rows(dirty), rows(sifted(dirty, EKF))
    assert len(right) < (1 - 0.8 * share) * len(rows(dirty))
    assert len(left - right) < 0.15 * len(rows(dirty) - right)
    assert len(left & right) > 0.95 * len(right)


def test_a_log_without_wheels_is_judged_by_moments():
    clean = replace(logs(0.0)[0], odometry=None)
    assert sifted(clean, EKF) is clean
    dirty = mislabelled(clean, 0.1)
    right, left = rows(clean) & rows(dirty), rows(sifted(dirty, EKF))
    assert len(left - right) < 0.25 * len(rows(dirty) - right)
    assert len(left & right) > 0.85 * len(right)


@pytest.mark.parametrize("turns", [0.5, 0.65, 1.4])
def test_wheels_that_turn_otherwise_than_they_say_are_no_wrong_names(turns):
    log = logs(0.0)[0]
    wheels = log.odometry
    assert wheels is not None
    other = replace(log, odometry=replace(wheels, w=turns * wheels.w))
    assert sifted(other, EKF) is other


def test_a_filter_maps_what_was_sifted_as_if_nothing_had_been_wrong():
    clean, dirty = logs(0.0)[0], logs(0.3)[0]
    a, b = local_map(clean).submap.landmarks, local_map(sifted(dirty, EKF)).submap.landmarks
    assert len(b) >= len(a) - 1
    both = a.select([name for name in a.ids if name in b.ids])
    far = [np.linalg.norm(p - b.mean[b.ids.index(name)]) for name, p in zip(both.ids, both.mean, strict=True)]
    assert np.sqrt(np.mean(np.square(far))) < 0.25


@pytest.mark.slow
def test_a_team_with_three_in_ten_sightings_wrong_is_as_good_as_one_told_everything(tmp_path):
    team = {**TEAM, "minutes": 4.0, "seed": 12}
    mapweave.simulate_team(tmp_path / "bad", outliers=0.3, **team)
    mapweave.simulate_team(tmp_path / "good", **team)
    truth = read_team_truth([tmp_path / "good"], ["robot1", "robot2"])
    found = mapweave.map(tmp_path / "bad")
    best = mapweave.map(tmp_path / "good", calibration=tmp_path / "good" / "truth" / "calibration.json")
    a, b = (
        mean_or_none([r.ate for r in score_team(m.maps, {}, truth.survey, truth.robots).robots.values()])
        for m in (found, best)
    )
    assert len(found.maps[0].robots) == 2
    assert a < 1.2 * b
    assert any("contradict those of the same name" in w for w in found.warnings)


@pytest.mark.data
@pytest.mark.parametrize("number", [1, 3, 4, 6])
def test_real_logs_are_not_sifted(data, number):
    for log in read_landmark_logs(data / "mrclam" / f"MRCLAM_Dataset{number}.zip"):
        found = witnesses(log.sightings, log.odometry, EKF) if log.odometry is not None else None
        if found is not None:
            assert found.contradicted().sum() < 0.01 * len(log.sightings)
        assert sifted(log, EKF) is log
