"""Landmark and trajectory scores of a team."""

import itertools

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.core.truth import Survey
from mapweave.evaluation.landmarks import exchanges_told, find_exchanges, naive_mean, score_landmarks
from mapweave.evaluation.team import RobotTruth, as_json, score_team
from mapweave.evaluation.trajectory import ate, paired, rpe
from mapweave.landmarks.landmark_map import LandmarkMap
from mapweave.team.team_map import TeamMap

T_SURVEY_MAP = np.array([2.0, -1.0, 0.7])


def a_survey(n=10, seed=0):
    rng = np.random.default_rng(seed)
    return Survey(tuple(str(6 + i) for i in range(n)), rng.uniform(-5, 5, (n, 2)))


def a_map(survey, sigma=0.02, seed=1, ids=None):
    rng = np.random.default_rng(seed)
    mean = se2.act(se2.inverse(T_SURVEY_MAP), survey.xy) + rng.normal(0, sigma, survey.xy.shape)
    whole = LandmarkMap(survey.ids, mean, sigma**2 * np.eye(2 * len(survey)))
    return whole if ids is None else whole.select(ids)


def test_the_error_is_what_is_left_after_the_best_rigid_alignment():
    survey = a_survey()
    score = score_landmarks(a_map(survey), survey)
    assert np.allclose(score.alignment, T_SURVEY_MAP, atol=0.02)
    assert 0.01 < score.rmse < 0.04
    assert abs(score.rmse - np.sqrt((score.errors**2).sum(1).mean())) < 1e-15
    assert score.dof == 17


def test_a_mirrored_map_is_not_mirrored_back():
    survey = a_survey()
    mirrored = LandmarkMap(survey.ids, survey.xy * [1, -1], np.eye(20))
    assert score_landmarks(mirrored, survey).rmse > 1


def test_landmarks_without_a_survey_are_left_out_and_counted():
    survey = a_survey()
    partial = Survey(survey.ids[:6], survey.xy[:6])
    score = score_landmarks(a_map(survey), partial)
    assert score.unsurveyed == 4
    assert len(score.ids) == 6


def test_fewer_than_two_surveyed_landmarks_give_no_figure():
    survey = a_survey()
    score = score_landmarks(a_map(survey), Survey(("6",), survey.xy[:1]))
    assert score.rmse is None
    assert score.nees_per_dof is None


def test_exchanged_labels_are_named_and_swapped_back():
    survey = a_survey(15)
    names = list(survey.ids)
    names[3], names[9] = names[9], names[3]
    found, mended = find_exchanges(a_map(survey), Survey(tuple(names), survey.xy))
    assert [(e.a, e.b) for e in found] == [("9", "15")]
    assert found[0].before > 0.5
    assert found[0].after < 0.04
    assert exchanges_told(found)[0].startswith("9 and 15 look exchanged: ")
    assert score_landmarks(a_map(survey), mended).rmse == pytest.approx(found[0].after, rel=1e-9)


def test_two_exchanges_are_both_found():
    survey = a_survey(15)
    names = list(survey.ids)
    for i, j in ((3, 9), (1, 12)):
        names[i], names[j] = names[j], names[i]
    found, _ = find_exchanges(a_map(survey), Survey(tuple(names), survey.xy))
    assert {frozenset((e.a, e.b)) for e in found} == {frozenset(("9", "15")), frozenset(("7", "18"))}


@pytest.mark.parametrize("rings", [((3, 9, 1),), ((0, 5, 11, 2, 7),), ((3, 9, 1), (4, 6)), (tuple(range(15)),)])
def test_rings_of_labels_are_named_and_put_back(rings):
    survey = a_survey(15)
    names = list(survey.ids)
    for ring in rings:
        for k, following in zip(ring, (*ring[1:], ring[0]), strict=True):
            names[k] = survey.ids[following]
    found, mended = find_exchanges(a_map(survey), Survey(tuple(names), survey.xy))
    assert len(found) == sum(len(ring) - 1 for ring in rings)
    assert {name for e in found for name in (e.a, e.b)} == {survey.ids[k] for ring in rings for k in ring}
    assert score_landmarks(a_map(survey), mended).rmse == pytest.approx(found[-1].after, rel=1e-9)
    assert found[-1].after < 0.04
    assert dict(zip(mended.ids, mended.xy.tolist(), strict=True)) == dict(
        zip(survey.ids, survey.xy.tolist(), strict=True)
    )
    sentences = exchanges_told(found)
    assert len(sentences) == len(rings)
    assert all(", each for the next: " in s for s, ring in zip(sentences, sorted(rings), strict=True) if len(ring) > 2)


def test_labels_of_a_place_that_looks_the_same_in_any_order_are_left():
    at = np.stack(np.meshgrid(np.arange(4.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    names = tuple(str(k) for k in range(16))
    ours = LandmarkMap(names, at, 1e-4 * np.eye(32))
    turned = Survey(tuple(np.roll(names, 3)), at)
    assert not any(", each for" in s for s in exchanges_told(find_exchanges(ours, turned)[0]))


def test_the_swap_chosen_is_the_best_of_all_swaps():
    survey = a_survey(8)
    names = list(survey.ids)
    names[0], names[5] = names[5], names[0]
    wrong = Survey(tuple(names), survey.xy)
    ours = a_map(survey, 0.1)
    by_hand = {}
    for i, j in itertools.combinations(range(8), 2):
        swapped = list(wrong.ids)
        swapped[i], swapped[j] = swapped[j], swapped[i]
        by_hand[frozenset((wrong.ids[i], wrong.ids[j]))] = score_landmarks(ours, Survey(tuple(swapped), survey.xy)).rmse
    found, _ = find_exchanges(ours, wrong)
    best = min(by_hand, key=by_hand.get)
    assert frozenset((found[0].a, found[0].b)) == best
    assert found[0].after == pytest.approx(by_hand[best], rel=1e-9)


def test_a_map_with_no_exchange_names_none():
    survey = a_survey(15)
    assert find_exchanges(a_map(survey, 0.3), survey)[0] == ()


def test_the_naive_mean_of_partial_maps_lies_between_them():
    survey = a_survey()
    maps = [a_map(survey, 0.05, k, survey.ids[k : k + 7]) for k in range(4)]
    moved = [m.moved(np.array([k, -k, 0.5 * k]), "local") for k, m in enumerate(maps)]
    mean = naive_mean(moved)
    assert set(mean.ids) == set(survey.ids)
    assert score_landmarks(mean, survey).rmse < 0.06


def a_track(offset=0.0, step=0.1, n=200):
    t = step * np.arange(n)
    return Track(t, np.column_stack([np.cos(t), np.sin(t) + offset, t]))


def test_dense_truth_counts_once_a_second_and_sparse_truth_always():
    truth, ours = a_track(), a_track()
    assert len(paired(ours, truth, dense=True)[0]) == 20
    assert len(paired(ours, truth, dense=False)[0]) == 200


def test_truth_outside_the_trajectory_does_not_count():
    ours = a_track(n=100)
    assert ate(ours, a_track(), np.zeros(3), dense=True)[1] == 10


def test_ate_is_taken_under_the_alignment_given():
    ours = a_track(0.3)
    assert ate(ours, a_track(), np.zeros(3), dense=False)[0] == pytest.approx(0.3)
    assert ate(ours, a_track(), np.array([0, -0.3, 0.0]), dense=False)[0] == pytest.approx(0, abs=1e-12)


def test_rpe_needs_no_alignment():
    moved = a_track()
    moved = Track(moved.t, se2.compose(np.array([5.0, 1.0, 1.0]), moved.pose))
    trans, rot = rpe(moved, a_track(), 5.0, dense=True)
    assert trans < 1e-9
    assert rot < 1e-9


def test_without_landmarks_the_trajectories_are_aligned_together():
    moved = Track(a_track().t, se2.compose(np.array([5.0, 1.0, 1.0]), a_track().pose))
    empty = LandmarkMap((), np.zeros((0, 2)), np.zeros((0, 0)))
    team = TeamMap(("robot1",), empty, {"robot1": moved})
    score = score_team([team], {}, Survey((), np.zeros((0, 2))), {"robot1": RobotTruth("TUM", a_track())})
    assert score.robots["robot1"].ate < 1e-9
    assert as_json(score)["landmark_rmse"] is None


def test_the_json_holds_the_documented_keys():
    survey = a_survey()
    team = TeamMap(("robot1", "robot2"), a_map(survey), {"robot1": a_track()})
    told = as_json(score_team([team], {"robot1": a_map(survey), "robot2": a_map(survey, 0.1)}, survey, {}))
    keys = [
        "landmark_rmse",
        "landmark_n",
        "nees_per_dof",
        "dof",
        "alignment",
        "mean_single_rmse",
        "naive_rmse",
        "exchanged",
        "landmark_rmse_exchanged",
        "nees_per_dof_exchanged",
        "robots",
    ]
    assert set(keys) <= set(told)
    assert told["ratio_to_naive"] == pytest.approx(told["landmark_rmse"] / told["naive_rmse"])
    assert told["ratio_to_mean_single"] == pytest.approx(told["landmark_rmse"] / told["mean_single_rmse"])
    assert told["exchanged"] == []
    assert told["landmark_rmse_exchanged"] is None
    assert set(told["robots"]) == {"1", "2"}
    assert {"ate", "n", "truth", "single_map_rmse"} <= set(told["robots"]["1"])


def test_truth_inside_spans_that_the_map_leaves_out_is_counted_and_does_not_count():
    survey, t = a_survey(), np.arange(0.0, 100.0, 0.1)
    true = np.column_stack([np.cos(0.1 * t), np.sin(0.1 * t), np.zeros(len(t))])
    own = se2.compose(se2.inverse(T_SURVEY_MAP), true)
    kept = (t <= 30.0) | (t >= 60.0)
    track, truths = Track(t[kept], own[kept]), {"robot1": RobotTruth("Groundtruth", Track(t, true))}
    whole = TeamMap(("robot1",), a_map(survey, sigma=1e-4), {"robot1": track})
    told = TeamMap(("robot1",), a_map(survey, sigma=1e-4), {"robot1": track}, left_out={"robot1": ((30.0, 60.0),)})
    across, outside = (score_team([m], {}, survey, truths).robots["robot1"] for m in (whole, told))
    assert across.ate > 0.3
    assert outside.ate < 0.01
    assert across.left_out == 0
    assert outside.left_out == 29
    assert outside.n == across.n - 29
    assert as_json(score_team([told], {}, survey, truths))["robots"]["1"]["left_out"] == 29
