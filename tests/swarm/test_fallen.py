"""What is asked of sightings that fit only because robots fell in with them, piece by piece."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from mapweave.swarm.config import SwarmConfig
from mapweave.swarm.locate import locate
from mapweave.swarm.result import JointInformation
from mapweave.swarm.robust import detection_threshold, fallen_together, unchecked

from .swarms import PAPER, complete, small

ROBUST = SwarmConfig(method="robust")
LIMIT = 3.5**2


def test_the_gain_asked_for_is_bayes_rule_with_a_wrong_sighting_pointing_anywhere():
    net = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1))  # 20 sightings
    inlier = np.ones(20, dtype=bool)
    inlier[:3] = False
    share, density = 3.5 / 21.0, np.sqrt(2 * np.pi) / np.radians(1.0)
    gain = detection_threshold(net, inlier, 0.25)
    odds = share / (1 - share) / density * np.exp(gain / 2)
    np.testing.assert_allclose(odds, 0.25 / 0.75)


def test_the_more_were_found_wrong_the_less_is_asked_of_the_next():
    net = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1))
    none, some = np.ones(20, dtype=bool), np.arange(20) > 4
    assert detection_threshold(net, some, 0.015).max() < detection_threshold(net, none, 0.015).min()


def test_a_sighting_across_a_short_distance_that_the_others_contradict_is_told():
    rng = np.random.default_rng(4)
    truth = np.vstack([PAPER, [[10.0, 4.0], [10.6, 4.0]]])
    net = complete(truth, 0.5, rng, anchors=(0, 1, 2), single=True)
    row = int(np.flatnonzero((net.observer == 5) & (net.target == 6))[0])
    turned = net.bearing.copy()
    turned[row] += np.pi / 2
    net = replace(net, bearing=turned)
    found = locate(net)
    fallen = fallen_together(net, np.ones(len(turned), dtype=bool), found, LIMIT, SwarmConfig())
    assert fallen.wrong[0] == row
    clean = locate(net.select(np.arange(len(turned)) != row))
    kept = np.ones(len(turned), dtype=bool)
    kept[row] = False
    assert not len(fallen_together(net, kept, clean, LIMIT, SwarmConfig()).undecided)


def test_where_the_information_is_singular_every_doubtful_sighting_is_one_that_nothing_checks():
    net = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1), single=True)  # each pair once
    found = locate(net)
    A = found.information
    nothing = replace(found, information=JointInformation(sp.csc_matrix(A.matrix.shape), A.held, A.width))
    wide = replace(nothing, cov=np.where(found.anchor[:, None, None], 0.0, 1e6 * np.eye(2)))
    everyone = np.ones(len(net.observer), dtype=bool)
    known = net.is_anchor[net.observer] & net.is_anchor[net.target]  # their distance is no question
    assert unchecked(net, everyone, wide).tolist() == (~known).tolist()


@pytest.mark.parametrize("seed", [3])
def test_rows_that_leave_a_robot_to_one_sighting_end_in_a_verdict_and_in_no_error(seed):
    net, _ = small(seed)
    found = locate(net, ROBUST)
    assert not found.reliable
    assert found.warnings
    assert np.isfinite(found.cov[found.localisable]).all()


def test_a_network_without_noise_has_no_doubtful_sightings():
    net = complete(PAPER, 1.0, np.random.default_rng(0), anchors=(0, 1), exact=True)
    found = locate(net)
    assert not unchecked(net, np.ones(20, dtype=bool), found).any()
