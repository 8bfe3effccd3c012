"""Fusing the maps of real robot teams: error against the survey, and honesty about it, with defaults alone."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.truth import Survey
from mapweave.evaluation.landmarks import rmse_after_alignment, score_landmarks
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.identities import match_maps
from mapweave.fusion.join import fuse
from mapweave.fusion.online import OnlineFuser
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.io.landmark_truth import read_survey
from mapweave.landmarks.mapping import local_map

pytestmark = [pytest.mark.data, pytest.mark.slow]
SETS = (1, 3, 4, 6)
LIMITS = {1: 0.045, 3: 0.048, 4: 0.042, 6: 0.045}
SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)


@pytest.fixture(scope="module")
def teams(data):
    """Logs, whole maps and survey of every set; in set 1 the survey's 11 and 17 are exchanged back."""
    out = {}
    for k in SETS:
        path = data / "mrclam" / f"MRCLAM_Dataset{k}.zip"
        survey = read_survey(path)
        if k == 1:
            back = {"11": "17", "17": "11"}
            survey = Survey(tuple(back.get(i, i) for i in survey.ids), survey.xy)
        logs = read_landmark_logs(path)
        out[k] = (logs, [local_map(log) for log in logs], survey)
    return out


def test_the_fused_map_of_every_set_is_right_and_says_how_right(teams):
    nees = []
    for k, (_, maps, survey) in teams.items():
        fused = fuse(maps)
        assert len(fused.components) == 1
        assert not fused.warnings
        score = score_landmarks(fused.components[0].map, survey)
        assert score.rmse <= LIMITS[k]
        assert 0.5 <= score.nees_per_dof <= 3.0
        nees.append(score.nees_per_dof)
        singles = [rmse_after_alignment(m.submap.landmarks, survey) for m in maps]
        assert score.rmse < 0.75 * np.mean(singles)
    assert np.mean(nees) <= 1.8


def test_unequal_maps_are_fused_far_better_than_by_averaging(teams):
    errors = {"naive": [], "diagonal": [], "full-scaled": []}
    for logs, _, survey in teams.values():
        driven = [log for log in logs if log.odometry is not None]
        parts = {(log.robot, s): local_map(log.share(s)) for log in driven for s in SHARES}
        for turn in range(len(SHARES)):
            maps = [parts[log.robot, SHARES[(i + turn) % len(SHARES)]] for i, log in enumerate(driven)]
            for weights, found in errors.items():
                found.append(score_landmarks(fuse(maps, FuseConfig(weights=weights)).components[0].map, survey).rmse)
    mean = {weights: np.mean(found) for weights, found in errors.items()}
    assert len(errors["naive"]) == 20
    assert mean["full-scaled"] <= 0.65 * mean["naive"]
    assert mean["full-scaled"] <= 0.85 * mean["diagonal"]


def test_whole_maps_find_out_which_landmarks_are_the_same(teams):
    for _, maps, _ in teams.values():
        for a, b in itertools.combinations(maps, 2):
            one, two = a.submap.landmarks, b.submap.landmarks
            match = match_maps(one, two)
            assert match.accepted
            names = [(one.ids[i], two.ids[j]) for i, j in match.links]
            assert all(i == j for i, j in names)
            assert len(names) == len(set(one.ids) & set(two.ids))


def test_recordings_of_different_rooms_stay_apart_and_of_the_same_room_are_joined(teams):
    """Sets 3 and 4 were recorded in one room; all sets use the same names."""
    room = {1: 1, 3: 3, 4: 3, 6: 6}
    for one, two in itertools.combinations(SETS, 2):
        maps = [replace(m, robot=f"{k}/{m.robot}") for k in (one, two) for m in teams[k][1]]
        fused = fuse(maps, recordings={m.robot: m.robot[0] for m in maps})
        of = [{robot[0] for robot in c.robots} for c in fused.components]
        if room[one] == room[two]:
            assert of == [{str(one), str(two)}]
            assert score_landmarks(fused.components[0].map, teams[one][2]).rmse <= LIMITS[one]
            continue
        assert [len(robots) for robots in of] == [1, 1]
        assert [len(c.robots) for c in fused.components] == [5, 5]
        assert score_landmarks(fused.components[0].map, teams[one][2]).rmse <= LIMITS[one]
        assert all("contradicts" in d.reason for d in fused.decisions[5:])


def test_a_robot_alone_in_another_room_joins_no_team(teams):
    for one, two in ((3, 1), (3, 6), (6, 1), (1, 4)):
        for stranger in teams[two][1]:
            maps = [*teams[one][1], replace(stranger, robot="other/robot1")]
            fused = fuse(maps, recordings={"other/robot1": "other"})
            assert [c.robots for c in fused.components][1:] == [("other/robot1",)]


def test_labels_exchanged_in_one_robot_are_found_in_real_maps(teams):
    found, rng = 0, np.random.default_rng(0)
    for _, maps, _ in teams.values():
        for k in range(3):
            submap = maps[k].submap
            apart = np.hypot(*np.moveaxis(submap.mean[:, None] - submap.mean[None], -1, 0))
            a, b = (int(i) for i in rng.permutation(np.argwhere(apart > 1.0))[0])
            ids = list(submap.ids)
            ids[a], ids[b] = ids[b], ids[a]
            wrong = [*maps[:k], replace(maps[k], submap=replace(submap, ids=tuple(ids))), *maps[k + 1 :]]
            found += fuse(wrong).labels == {maps[k].robot: {ids[a]: ids[b], ids[b]: ids[a]}}
    assert found >= 11


def test_a_map_that_went_mad_does_not_spoil_the_others(teams):
    _, maps, survey = teams[6]
    rng = np.random.default_rng(1)
    mad = replace(maps[2], submap=replace(maps[2].submap, mean=maps[2].submap.mean + rng.normal(0, 4, (15, 2))))
    fused = fuse([*maps[:2], mad, *maps[3:]])
    assert len(fused.components[0].robots) == 4
    assert fused.decisions[2].decision == "refused"
    assert score_landmarks(fused.components[0].map, survey).rmse < 0.05


def test_online_fusion_of_growing_logs_ends_with_the_offline_map(teams):
    logs, maps, _ = teams[4]
    fuser, growth = OnlineFuser(), []
    for share in (0.2, 0.5):
        fuser = fuser.update(*(local_map(log.share(share)) for log in logs))
        growth.append(fuser)
    fuser = fuser.update(*maps)
    np.testing.assert_array_equal(fuser.largest.map.mean, fuse(maps).components[0].map.mean)
    assert fuser.log_det < growth[1].log_det < growth[0].log_det
    assert fuser.tied_in == 5
