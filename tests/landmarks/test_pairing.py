"""How probable pairings are, against an enumeration of all hypotheses."""

import itertools

import numpy as np
import pytest

from mapweave.landmarks.association import pairing_probabilities


def enumerated(pairs, e, S, density):
    """Every set of pairs without a landmark in two of them, weighed by its joint density at once."""
    total, out = 0.0, np.zeros(len(pairs))
    for n in range(len(pairs) + 1):
        for chosen in itertools.combinations(range(len(pairs)), n):
            used = [label for k in chosen for label in pairs[k]]
            if len(set(used)) < len(used):
                continue
            rows = np.array([2 * k + a for k in chosen for a in (0, 1)], dtype=int)
            C, d = S[np.ix_(rows, rows)], e.ravel()[rows]
            weight = np.exp(-0.5 * d @ np.linalg.solve(C, d)) / np.sqrt(np.linalg.det(2 * np.pi * C)) / density**n
            total += weight
            out[list(chosen)] += weight
    return out / total


@pytest.mark.parametrize("seed", range(5))
def test_probabilities_are_those_of_all_joint_hypotheses(seed):
    rng = np.random.default_rng(seed)
    pairs = np.array([[0, 5], [0, 6], [1, 5], [1, 6], [2, 7], [5, 7]])
    A = rng.normal(size=(12, 12))
    S, e = A @ A.T * 0.1, rng.normal(size=(6, 2)) * 0.5
    got = pairing_probabilities(pairs, e, S, 0.05)
    assert np.allclose(got, enumerated(pairs, e, S, 0.05), atol=1e-7)
    assert got[0] + got[1] <= 1 + 1e-12


def test_pairs_that_agree_on_a_shift_are_surer_than_either_alone():
    S = np.kron(np.ones((2, 2)), np.eye(2)) * 4.0 + 0.01 * np.eye(4)
    e = np.array([[2.0, -1.0], [2.1, -0.9]])
    alone = pairing_probabilities(np.array([[0, 2]]), e[:1], S[:2, :2], 0.01)[0]
    both = pairing_probabilities(np.array([[0, 2], [1, 3]]), e, S, 0.01)
    assert alone < 0.9
    assert both.min() > 0.98


def test_which_of_two_landmarks_at_one_place_is_a_coin_toss():
    pairs = np.array([[0, 2], [0, 3], [1, 2], [1, 3]])
    p = pairing_probabilities(pairs, np.zeros((4, 2)), 0.1 * np.eye(8), 1e-4)
    assert np.allclose(p, 0.5, atol=0.01)
    assert pairing_probabilities(pairs[:0], np.zeros((0, 2)), np.zeros((0, 0)), 1e-4).shape == (0,)


@pytest.mark.parametrize("density", [1e-300, 1e300])
def test_two_places_that_fit_as_well_share_the_probability_however_rare_or_common_landmarks_are(density):
    p = pairing_probabilities(np.array([[0, 1], [0, 2]]), np.zeros((2, 2)), 0.1 * np.eye(4), density)
    assert np.allclose(p, 0.5 if density < 1 else 0.0, atol=1e-9)
    many = np.array([[k, 20 + k] for k in range(6)])
    p = pairing_probabilities(many, np.zeros((6, 2)), 0.1 * np.eye(12), density)
    assert np.allclose(p, 1.0 if density < 1 else 0.0, atol=1e-9)
