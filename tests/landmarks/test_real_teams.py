"""Local maps of real teams, joined: landmark errors and honesty with defaults alone, and under abuse."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mapweave.core.records import Odometry
from mapweave.core.truth import Survey
from mapweave.evaluation.landmarks import score_landmarks
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.landmark_truth import read_survey
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import local_map

pytestmark = pytest.mark.data

SETS = (1, 3, 4, 6)
MAP_ALONE = EkfSlamConfig(smooth=False)  # poses are not asked for here
SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)


@cache
def logs(data: Path, number: int):
    return read_landmark_logs(data / "mrclam" / f"MRCLAM_Dataset{number}.zip")


@cache
def survey(data: Path, number: int) -> Survey:
    truth = read_survey(data / "mrclam" / f"MRCLAM_Dataset{number}.zip")
    if number != 1:
        return truth
    back = {"11": "17", "17": "11"}  # exchanged in this set's table
    return Survey(tuple(back.get(name, name) for name in truth.ids), truth.xy)


def joined(maps, weights="full-scaled"):
    return fuse(maps, FuseConfig(weights=weights)).components[0].map


def score(maps, truth, weights="full-scaled"):
    s = score_landmarks(joined(maps, weights), truth)
    return s.rmse, s.nees_per_dof


@pytest.mark.parametrize(("number", "most"), [(1, 0.040), (3, 0.040), (4, 0.036), (6, 0.036)])
def test_fused_local_maps_are_right_and_honest(data, number, most):
    maps = [local_map(log) for log in logs(data, number)]
    rmse, nees = score(maps, survey(data, number))
    assert rmse <= most
    assert 0.5 <= nees <= 3.0
    singles = [score_landmarks(m.submap.landmarks, survey(data, number)).rmse for m in maps]
    assert rmse < 0.7 * np.mean(singles)
    assert not any(m.down_weighted > 0.3 * sum(m.sightings.values()) for m in maps)


@pytest.mark.slow
@pytest.mark.parametrize("number", SETS)
def test_odometry_that_turns_six_tenths_of_what_it_says_does_not_matter(data, number):
    maps = []
    for log in logs(data, number):
        o = log.odometry
        turned = log if o is None else replace(log, odometry=Odometry(o.t, o.v, o.w / 0.6))
        maps.append(local_map(turned))
        if o is not None:
            assert 0.45 < maps[-1].calibration["turn_scale"][0] < 0.65
    rmse, nees = score(maps, survey(data, number))
    assert rmse <= 0.045
    assert 0.5 <= nees <= 3.0


@pytest.mark.parametrize(("number", "most"), [(1, 0.08), (3, 0.06), (4, 0.07)])
def test_a_team_without_any_odometry_still_gets_its_map(data, number, most):
    maps = [local_map(replace(log, odometry=None)) for log in logs(data, number)]
    rmse, nees = score(maps, survey(data, number))
    assert rmse <= most
    assert 0.3 <= nees <= 3.0
    assert {m.odometry for m in maps} == {"none"}


def test_without_odometry_what_cannot_be_tied_is_left_out_rather_than_guessed(data):
    maps = [local_map(replace(log, odometry=None)) for log in logs(data, 6)]
    for m in maps:
        assert any("share too little" in w for w in m.warnings)
        assert score_landmarks(m.submap.landmarks, survey(data, 6)).rmse < 0.15


@pytest.mark.slow
def test_on_unequal_maps_full_covariance_beats_the_plain_mean_and_the_diagonal(data):
    rmse = {"naive": [], "diagonal": [], "full-scaled": []}
    for number in SETS:
        moving = [log for log in logs(data, number) if log.odometry is not None]
        for k in range(len(SHARES)):
            parts = [log.share(SHARES[(i + k) % len(SHARES)]) for i, log in enumerate(moving)]
            maps = [local_map(part, MAP_ALONE) for part in parts]
            for weights, values in rmse.items():
                values.append(score(maps, survey(data, number), weights)[0])
    mean = {weights: np.mean(values) for weights, values in rmse.items()}
    assert mean["full-scaled"] <= 0.65 * mean["naive"]
    assert mean["full-scaled"] <= 0.85 * mean["diagonal"]


def test_a_robot_that_is_not_in_the_team_is_no_landmark(data):
    (log,) = (log for log in logs(data, 6) if log.robot == "robot5")
    ids = tuple("5000" if name == "robot3" else name for name in log.sightings.ids)
    m = local_map(replace(log, sightings=replace(log.sightings, ids=ids)))
    assert "5000" not in m.submap.ids
    assert score_landmarks(m.submap.landmarks, survey(data, 6)).rmse < 0.09
