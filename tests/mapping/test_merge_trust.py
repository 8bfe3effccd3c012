"""The probability that a decision on two maps is wrong: what it follows, and whether it comes true."""

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.mapping.merge import merge_as_said, merge_maps
from mapweave.mapping.merge_ambiguity import LEAST, Grounds
from mapweave.mapping.merge_search import Start

from ..laser.test_merge import office_pair

STRONG = Grounds(
    clear=0.99,
    unlike=0.03,
    walled=1.0,
    own=0.02,
    votes=8,
    others=1,
    rival=0.1,
    allowed=False,
    pushed=0.2,
    held=0.5,
)


@pytest.fixture(scope="module")
def pair():
    return office_pair(3, 0.8)


@pytest.fixture(scope="module")
def merge(pair):
    return merge_maps(pair.a, pair.b)


def test_a_merge_tells_what_it_rests_on_and_is_hardly_ever_wrong_where_all_speaks_for_it(merge):
    told = merge.grounds
    assert merge.alike <= told.clear <= 1.0
    assert told.rival == pytest.approx(0.0)
    assert merge.probability_wrong == pytest.approx(1.0 - told.probability())
    assert merge.probability_wrong < 0.03
    assert merge.row()["probability_wrong"] == merge.probability_wrong


def test_strangers_are_hardly_ever_wrongly_refused(pair):
    told = merge_maps(pair.a, office_pair(29, 0.8).b)
    assert not told.merged
    assert told.probability_wrong < 0.1


def test_maps_with_nothing_in_common_are_told_as_sure_as_anything_is():
    assert LEAST <= Grounds().probability() < 0.05


def test_where_a_start_or_somebody_decides_there_is_no_probability(pair):
    start = Start(pair.transform, np.array([0.5, 0.5, 0.1]))
    given = merge_maps(pair.a, pair.b, start=start)
    assert given.merged
    assert given.probability_wrong is None
    said = merge_as_said(pair.a, pair.b, pair.transform)
    assert said.row()["probability_wrong"] is None


def test_what_speaks_against_a_place_makes_it_less_likely():
    surest = STRONG.probability()
    assert surest > 0.9
    for worse in (
        STRONG._replace(allowed=True, rival=0.9),
        STRONG._replace(clear=0.8),
        STRONG._replace(unlike=0.3),
        STRONG._replace(walled=0.8),
        STRONG._replace(votes=1),
        STRONG._replace(others=30),
        STRONG._replace(pushed=1.0, held=0.0),
    ):
        assert worse.probability() < surest


def test_what_a_map_contradicts_of_itself_is_not_held_against_a_place():
    crowded = STRONG._replace(unlike=0.2, walled=0.97)
    assert crowded._replace(own=0.3).probability() > crowded._replace(own=0.0).probability()
    whole = STRONG._replace(clear=1.0, unlike=0.0)
    assert whole._replace(own=0.3).probability() == pytest.approx(whole.probability(), abs=1e-9)


def test_a_place_alone_and_one_that_nothing_contradicts_are_surer():
    doubted = STRONG._replace(allowed=True, unlike=0.3, walled=0.9, clear=0.8)
    assert doubted.probability() < doubted.alone().probability() < doubted.alone().uncontradicted().probability()


def test_no_decision_is_told_surer_than_trials_can_tell():
    sure = STRONG._replace(clear=1.0, rival=0.0, pushed=0.0)
    assert sure.probability() <= 1.0 - LEAST
    assert Grounds().probability() >= LEAST


@pytest.mark.slow
def test_of_small_maps_nobody_fitted_to_as_many_are_right_as_is_said():
    """Maps of fewer keyframes and beams than the fit had: the number right is within three sd of the sum of what is
    said, and what is said of those that are right is more than of others."""
    said, right = [], []
    for seed in range(40, 50):
        made = office_pair(seed, [0.0, 0.1, 0.3, 0.6][seed % 4])
        told = merge_maps(made.a, made.b)
        said.append(told.grounds.probability())
        e = np.full(3, np.inf) if told.best is None else se2.between(made.transform, told.best)
        right.append(bool(np.hypot(*e[:2]) < 0.5 and abs(e[2]) < 0.09))
    p, y = np.array(said), np.array(right, dtype=float)
    assert abs(p.sum() - y.sum()) < 3.0 * np.sqrt((p * (1.0 - p)).sum() + 0.25)
    assert 0 < y.sum() < len(y)
    assert p[y > 0].mean() > p[y == 0].mean() + 0.3
