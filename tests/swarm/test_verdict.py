"""What is said against an answer, and that nothing is said against a good one."""

import numpy as np

from mapweave.core.gaussian import chi2_quantile
from mapweave.swarm import posterior
from mapweave.swarm.posterior import (
    barely_determined,
    chi2_warnings,
    close_remarks,
    doubtful_warnings,
    faint_remarks,
    fallen_warnings,
    layout_warnings,
    share_warnings,
    support_warnings,
    trust_warnings,
)

from .swarms import PAPER, complete

MUTUAL = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1))
SINGLE = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1), single=True)


def called(net, count):
    return np.arange(len(net.observer)) < count


def test_a_chi_square_is_doubted_above_its_limit_and_remarked_on_below_the_other():
    high, low = chi2_quantile(0.999, 30.0), chi2_quantile(0.001, 30.0)
    assert chi2_warnings(1.01 * high, 30)
    assert not chi2_warnings(0.99 * high, 30)
    assert faint_remarks(0.99 * low, 30)
    assert not faint_remarks(1.01 * low, 30)


def test_without_degrees_of_freedom_the_answer_is_doubted_and_called_no_copy():
    assert "no sightings are left over" in chi2_warnings(0.0, 0)[0]
    assert not faint_remarks(0.0, 0)


def test_more_than_a_quarter_called_wrong_proves_nothing_whoever_saw_whom():
    assert not share_warnings(called(MUTUAL, 5))
    assert "too many to say which" in share_warnings(called(MUTUAL, 6))[0]
    assert trust_warnings(MUTUAL, called(MUTUAL, 6)) == share_warnings(called(MUTUAL, 6))
    assert not share_warnings(np.zeros(0, dtype=bool))


def test_some_called_wrong_prove_nothing_only_where_robots_are_seen_from_one_end(monkeypatch):
    assert not trust_warnings(MUTUAL, called(MUTUAL, 2))
    assert "not sighted from both ends" in trust_warnings(SINGLE, called(SINGLE, 1))[0]
    monkeypatch.setattr(posterior, "VERDICT_MANY", 0.1)
    assert not trust_warnings(SINGLE, called(SINGLE, 1))


def test_robots_that_may_be_elsewhere_are_named_the_likeliest_first_and_no_others():
    outside = np.array([0.0, 0.0, 0.02, 0.6, 0.005])
    (told,) = doubtful_warnings(MUTUAL, outside, 0.01)
    assert told.endswith("3 (60 %), 2 (2 %)")
    assert "2 robots" in told
    assert not doubtful_warnings(MUTUAL, outside, 0.6)


def test_warnings_name_at_most_ten_and_are_silent_about_none():
    assert not fallen_warnings(MUTUAL, np.zeros(0, dtype=int))
    assert not support_warnings(MUTUAL, np.zeros(0, dtype=int))
    (pairs,) = fallen_warnings(MUTUAL, np.arange(11))
    assert pairs.startswith("11 sightings")
    assert pairs.endswith(", ..")
    assert pairs.count("-") == 10
    (robots,) = support_warnings(MUTUAL, np.array([2, 4]))
    assert robots.endswith("prove nothing: 2, 4")


def test_a_robot_known_no_better_than_a_sighting_is_long_is_barely_determined_but_not_where_most_are():
    wide = np.repeat(1e-4 * np.eye(2)[None], 5, axis=0)
    everyone = np.ones(5, dtype=bool)
    assert not barely_determined(MUTUAL, PAPER, wide, everyone)
    wide[3] = 1e4 * np.eye(2)
    assert "nearly parallel: 1;" in barely_determined(MUTUAL, PAPER, wide, everyone)[0]
    assert not barely_determined(MUTUAL, PAPER, np.repeat(wide[3:4], 5, axis=0), everyone)


def test_close_pairs_lines_and_robots_not_located_are_remarked_on():
    assert not close_remarks(0)
    assert close_remarks(1)[0].startswith("a pair")
    assert close_remarks(2)[0].startswith("2 pairs")
    everyone = np.ones(5, dtype=bool)
    assert not layout_warnings(MUTUAL, everyone, 0)
    assert "3 robots stand on one line" in layout_warnings(MUTUAL, everyone, 3)[0]
    assert layout_warnings(MUTUAL, np.arange(5) < 3, 0) == ["2 of 5 robots cannot be located from these sightings"]
