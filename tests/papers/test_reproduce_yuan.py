"""`reproduce yuan`: every case is run and told, with the paper's own figures beside."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapweave.exploration.landmarks.experiment import explore_many
from mapweave.papers.yuan import reproduce as module
from mapweave.papers.yuan.experiments import (
    GOALS,
    HEAD,
    PRINTED,
    as_it_is,
    cases,
    expected_error,
    moved,
    moving,
    plain_neighbour,
    run,
)
from mapweave.papers.yuan.reproduce import AREA, TITLES, implied_error, reproduce_yuan


def short(case, steps=12):
    """The case with runs that end after a few steps, laps not searched."""
    mission = replace(case.mission, until=steps, planner="paper")
    return replace(case, mission=mission)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """The whole command with short runs."""
    out = tmp_path_factory.mktemp("yuan") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "cases", lambda *, quick: tuple(short(c) for c in cases(quick=quick)))
        patch.setattr(module, "run", lambda **more: replace(run(**more), until=12))
        return out, reproduce_yuan(out, quick=True)


def test_the_tables_hold_the_papers_figures_and_every_case_ours(told):
    out, result = told
    rows = result.table("table1")
    assert rows[0][0] == "two robots, paper"
    assert rows[0][3:6] == ("208 / 371 / 296", 0.282, 0.327)
    assert [r[0] for r in rows].count("one robot, paper") == 1
    assert {r[0] for r in rows} >= {"two robots, calibrated noise, nn", "two robots, calibrated noise, nn as printed"}
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["printed"]["1"]["map_error_m"] == PRINTED[1][3]
    assert len(metrics["cases"]) == len(cases(quick=True))
    assert {f.name for f in (out / "figures").iterdir()} == {"one.png", "two.png", "planners.png", "ablation.png"}
    assert len((out / "claims.md").read_text().splitlines()) == 2 + len(result.claims)
    tables = {f.stem: f.read_text().splitlines() for f in (out / "tables").iterdir()}
    assert set(tables) == {*TITLES, "area", "goals", "changes"}
    assert tables["table1"][2].startswith("| two robots, paper |  | 30/30 | 208 / 371 / 296 | 0.282 |")
    assert all(len(tables[group]) == 2 + len(result.table(group)) for group in TITLES)
    assert all(len(row) == len(HEAD) for group in TITLES for row in result.table(group))


def test_goals_are_judged_on_seeds_that_nothing_was_chosen_on(told):
    _, result = told
    _, rows = result.goals()
    assert [row[0] for row in rows] == list(GOALS)
    assert {row[1] for row in rows} == {"100-104"}
    assert [row[3] for row in rows] == ["≤ 180", "≤ 195", ""]
    assert all(row[-1] == "reached" or row[-1].startswith("missed: ") for row in rows)
    assert not {c.first_seed for c in cases()} - {0, 100}


def test_words_on_claims_change_with_the_runs_that_they_are_judged_by(told):
    _, result = told

    def words(of):
        return {claim.here: row[5] for claim, row in zip(of.claims, of.claims_table()[1], strict=True)}

    def runs_of(name, **what):
        return replace(
            result,
            outcomes=tuple(
                replace(o, runs=tuple(replace(r, **what) for r in o.runs)) if o.case.name == name else o
                for o in result.outcomes
            ),
        )

    one = "one robot, calibrated noise"
    assert words(runs_of(one, steps=503))["efficiency"] == "holds"
    assert words(runs_of(one, steps=1))["efficiency"] == "does not hold"
    assert words(runs_of(one, map_error=0.361, c_per_n=0.49))["accuracy_one"] == "holds"
    assert words(runs_of(one, map_error=0.361, c_per_n=4.9))["accuracy_one"] == "in part"
    assert words(runs_of(one, map_error=3.61, c_per_n=4.9))["accuracy_one"] == "does not hold"
    assert words(runs_of("no distance to others", steps=500))["apart"] == "holds"
    dead = "one of two dead after 100 steps"
    assert words(runs_of(dead, finished=True, nees_per_dof=1.0))["dead"] == "holds"
    assert words(runs_of(dead, finished=False, nees_per_dof=1.0))["dead"] == "in part"


def test_what_1_percent_moves_by_more_than_1_percent_is_named_with_its_standard_error(told):
    _, result = told
    more, less, runs = moved(result.outcomes)
    assert (more, runs) == ("none", 2)
    assert "steps of joint (joint.rate x 0.99: +0.0 ± 0.0 of 12.0 steps, goal 180)" in less
    longer = tuple(
        replace(o, runs=tuple(replace(r, steps=r.steps + 2 * k) for k, r in enumerate(o.runs)))
        if o.case.name == "joint.rate x 0.99"
        else o
        for o in result.outcomes
    )
    more, less, _ = moved(longer)
    assert more == "steps of joint (joint.rate x 0.99: +1.0 ± 1.0 of 12.0 steps, goal 180)"
    assert "steps of joint" not in less
    assert more in " ".join(replace(result, outcomes=longer).differences())


def test_a_change_is_told_with_the_standard_error_of_the_runs_on_the_same_seeds(told):
    _, result = told
    head, rows = result.changes()
    changed = [o for o in result.outcomes if o.case.group == "stability"]
    assert as_it_is(result.outcomes, "coverage").runs == result.get("unseen", "coverage").runs[:2]
    assert [row[:2] for row in rows] == [(o.case.name, len(o.runs)) for o in changed]
    assert all(len(row) == len(head) for row in rows)
    assert {row[-1] for row in rows} == {"nothing"}  # short runs without laps: no constant makes a difference
    first, other = result.get("unseen", "joint"), result.get("unseen", "coverage")
    swapped = replace(other, runs=other.runs[1:] + other.runs[:1])
    by, error = swapped.change(first, "map_error")
    more = np.array([b.map_error - a.map_error for a, b in zip(first.runs, swapped.runs, strict=True)])
    assert by == pytest.approx(more.mean())
    assert error == pytest.approx(more.std(ddof=1) / np.sqrt(len(more)))
    low, high = first.interval("map_error")
    assert low < first.mean("map_error") < high


def test_the_expected_error_is_the_mean_distance_that_the_covariance_draws():
    cov = np.diag([4.0, 0.25, 1.0, 1.0])
    cov[0, 2] = cov[2, 0] = 0.5  # what ties landmarks does not matter
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(4), cov, size=200_000)
    mean = 0.5 * (np.hypot(draws[:, 0], draws[:, 1]) + np.hypot(draws[:, 2], draws[:, 3])).mean()
    assert expected_error(cov) == pytest.approx(mean, rel=5e-3)
    assert expected_error(np.zeros((2, 2))) == 0.0
    assert expected_error(np.zeros((0, 0))) is None


def test_the_area_term_is_left_out_with_the_same_escape_on_both_sides():
    by = {c.name: c.mission.cfg for c in cases() if c.group == "ablation"}
    for _, whole, without in AREA:
        a, b = by[whole], by[without]
        assert b.objective.w_area == 0.0
        assert replace(a.objective, w_area=0.0) == b.objective
        assert replace(a, objective=b.objective, mission=b.mission) == b


def test_quick_runs_the_rows_of_table_1_whole_and_every_planner_with_a_constant_changed():
    whole, quick = ({(c.group, c.name): c for c in cases(quick=q)} for q in (False, True))
    assert {key for key in whole if key not in quick} == {
        key for key in whole if key[0] == "stability" and key[1] not in CHANGED
    }
    for key, case in quick.items():
        assert replace(case, share=whole[key].share) == whole[key]
        judged = key[0] == "table1" and (case.share == 1.0 or ", nn" in key[1])  # fewer runs change the verdict
        judged |= key[0] == "ablation" and "escape" not in key[1]
        assert case.share == whole[key].share if judged else case.share < whole[key].share
    for robots in ("two robots", "one robot"):
        assert quick["table1", f"{robots}, calibrated noise"].share == 1.0


CHANGED = {"coverage.rate x 0.99", "loop.rate x 0.99", "joint.rate x 0.99"}


def test_constants_are_changed_by_1_percent_and_nothing_else():
    changed = [c for c in cases() if c.group == "stability"]
    for case in changed:
        name, factor = case.name.split(" x ")
        planner, key = name.split(".")
        plain = run(planner=planner).cfg
        wanted = replace(getattr(plain, planner), **{key: float(factor) * getattr(getattr(plain, planner), key)})
        assert case.mission.cfg == replace(plain, **{planner: wanted})
    assert {c.mission.planner for c in changed} == set(GOALS)


def test_landmarks_as_uncertain_as_printed_err_by_more_than_printed():
    draws = np.random.default_rng(0).normal(size=(200_000, 2)) * np.sqrt(0.327 / np.pi)
    assert implied_error(0.327) == pytest.approx(np.hypot(*draws.T).mean(), rel=0.01)
    for robots in (1, 2):
        assert PRINTED[robots][3] < 0.75 * implied_error(PRINTED[robots][4])


@pytest.mark.slow
def test_with_all_noise_in_position_one_robot_errs_little_more_than_two():
    """On these seeds it errs 1.02 times as much, C/N 1.23 times; with the calibrated split 1.49 and 1.94 times, with
    this noise of position and the calibrated one of turning 1.42 and 3.10 times.
    """
    two, one = (explore_many(moving(run(robots=k), 0.06, 0.0), 8, 1000) for k in (2, 1))
    error, spread = (
        np.mean([getattr(r, what) for r in one]) / np.mean([getattr(r, what) for r in two])
        for what in ("map_error", "c_per_n")
    )
    assert error < 1.25
    assert spread < 1.5
    assert 0.1 < np.mean([r.c_per_n for r in two]) < 0.2  # with the calibrated noise of position 0.047
    assert 0.8 < np.mean([r.nees_per_dof for r in two + one]) < 1.25  # world and filter were given the same noise


@pytest.mark.long
def test_nearest_neighbours_make_an_honest_map_and_unsure_ones_most_of_the_wrong_matches():
    plain, sure = (explore_many(m(run(association="nn")), 10, 0) for m in (plain_neighbour, lambda m: m))
    assert sum(r.misassociations for r in sure) < 0.5 * sum(r.misassociations for r in plain)
    assert all(np.mean([r.nees_per_dof for r in runs]) < 1.5 for runs in (plain, sure))
