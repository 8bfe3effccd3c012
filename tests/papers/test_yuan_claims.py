"""Claims of Yuan, Huang, Tao and Xi on their planner, judged on the first of the claims' own 30 layouts."""

from functools import cache

import numpy as np
import pytest

from mapweave.exploration.landmarks.experiment import explore_many
from mapweave.papers.yuan.experiments import PRINTED, run


@cache
def runs(runs=8, robots=2, **objective):
    return explore_many(run(robots=robots, **objective), runs, 0)


def alone():
    """One robot on the first 16 layouts."""
    return runs(16, 1)


def ratio(a, b, what):
    """The mean of `a` over that of `b`."""
    mean_a, mean_b = (np.mean([getattr(r, what) for r in some]) for some in (a, b))
    return mean_a / mean_b


@pytest.mark.slow
@pytest.mark.eq("Yuan09:20", "Yuan09:21")
def test_the_papers_planner_finishes_every_run_within_its_figures():
    assert all(r.finished for r in runs() + alone())
    assert np.mean([r.steps for r in runs()]) <= 330
    assert np.mean([r.map_error for r in runs()]) <= 0.40
    assert ratio(alone()[:8], runs(), "steps") >= 1.5


@pytest.mark.slow
def test_without_the_distance_to_the_others_the_team_takes_no_more_steps():
    """Measured: 0.96 times as many here, 0.91 and 1.03 on seeds 1000 to 1007 and 100 to 107."""
    without = runs(w_apart=0.0)
    assert all(r.finished for r in without)
    assert 0.8 < ratio(without, runs(), "steps") < 1.05


@pytest.mark.slow
def test_without_the_accuracy_term_the_map_errs_no_more():
    """Measured: error 0.89 and C/N 0.70 times; 0.88 and 0.95 on seeds 1000 to 1007, 1.19 and 1.00 on 100 to 107."""
    without = runs(w_accuracy=0.0)
    assert all(r.finished for r in without)
    assert ratio(without, runs(), "map_error") < 1.05
    assert ratio(without, runs(), "c_per_n") < 1.05


@pytest.mark.slow
def test_one_robot_maps_less_well_than_two():
    """Measured: error 1.84 and C/N 3.5 times; 1.49 and 1.94 on seeds 1000 to 1007, 1.59 and 3.9 on 100 to 107."""
    assert ratio(alone()[:8], runs(), "map_error") > 1.15
    assert ratio(alone()[:8], runs(), "c_per_n") > 1.3


@pytest.mark.slow
def test_one_robot_errs_and_is_unsure_by_more_than_a_quarter_beyond_the_print():
    """The claim's own 30 layouts: 1.61 and 1.45 times as printed; here the first 16."""
    error, spread = PRINTED[1][3:]
    assert np.mean([r.map_error for r in alone()]) > 1.25 * error
    assert np.mean([r.c_per_n for r in alone()]) > 1.25 * spread
    assert 0.85 < np.mean([r.nees_per_dof for r in alone()]) < 1.2  # it is as sure as it may be
