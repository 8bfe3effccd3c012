"""Data association inside a submap."""

import numpy as np

from mapweave.landmarks.association import certain, jcbb, nearest_neighbour

R = np.diag([0.04, 0.0016])


def test_both_rules_find_the_obvious_matches_and_the_new_landmark():
    zhat = np.array([[5.0, 0.1], [8.0, -0.4], [3.0, 1.0]])
    z = np.array([[8.05, -0.41], [12.0, 0.9], [5.02, 0.12]])
    S = 1e-3 * np.eye(6)
    for rule in (nearest_neighbour, jcbb):
        found = rule(z, zhat, S, R, 9.21, 25.0, (1,))
        assert found.landmark == (1, None, 0)
        assert found.new == (False, True, False)


def test_an_observation_too_far_to_match_and_too_near_to_be_new_is_dropped():
    zhat = np.array([[5.0, 0.0]])
    z = np.array([[5.0 + 0.2 * 4.0, 0.0]])  # D^2 = 16
    for rule in (nearest_neighbour, jcbb):
        found = rule(z, zhat, 1e-9 * np.eye(2), R, 9.21, 25.0, (1,))
        assert found.landmark == (None,)
        assert found.new == (False,)


def test_joint_compatibility_sees_a_common_shift_where_nearest_neighbour_is_fooled():
    zhat = np.array([[5.0, 0.00], [5.0, 0.30], [5.0, 0.60]])
    shared = np.zeros((6, 6))
    shared[1::2, 1::2] = 0.3**2  # the robot's heading error moves all bearings together
    S = shared + 1e-6 * np.eye(6)
    z = zhat + np.array([0.0, 0.28])  # all turned by nearly one spacing
    assert jcbb(z, zhat, S, R, 9.21, 25.0, (1,)).landmark == (0, 1, 2)
    assert nearest_neighbour(z[:2], zhat, S, R, 9.21, 25.0, (1,)).landmark == (1, 2)


def test_bearings_are_compared_across_the_cut_at_pi():
    found = nearest_neighbour(np.array([[5.0, -3.13]]), np.array([[5.0, 3.14]]), 1e-6 * np.eye(2), R, 9.21, 25.0, (1,))
    assert found.landmark == (0,)


def test_without_landmarks_every_observation_is_new():
    for rule in (nearest_neighbour, jcbb):
        found = rule(np.array([[5.0, 0.0], [6.0, 0.0]]), np.zeros((0, 2)), np.zeros((0, 0)), R, 9.21, 25.0, (1,))
        assert found.new == (True, True)


def test_an_observation_that_two_landmarks_explain_as_well_is_dropped_and_the_others_stay():
    zhat = np.array([[5.0, 0.0], [5.0, 0.02], [9.0, 0.8]])
    z = np.array([[5.0, 0.01], [9.05, 0.81], [5.1, 0.0]])
    S = 1e-3 * np.eye(6)
    found = jcbb(z, zhat, S, R, 9.21, 25.0, (1,))
    assert None not in found.landmark
    kept = certain(found, z, zhat, S, R, 9.21, 25.0, (1,), np.full(3, 1e-5), 0.95)
    assert kept.landmark == (None, 2, None)
    assert kept.new == (False, False, False)


def test_a_second_observation_beside_a_sure_one_is_another_landmark():
    zhat = np.array([[5.0, 0.0]])
    z = np.array([[5.0, 0.0], [5.0, 0.17]])  # the second at D^2 = 18: too near to be new, were the first not there
    found = jcbb(z, zhat, 1e-9 * np.eye(2), R, 9.21, 25.0, (1,))
    assert found == ((0, None), (False, False))
    kept = certain(found, z, zhat, 1e-9 * np.eye(2), R, 9.21, 25.0, (1,), np.full(2, 1e-5), 0.95)
    assert kept == ((0, None), (False, True))


def test_matches_that_fit_one_by_one_but_not_together_are_not_both_believed():
    zhat = np.array([[5.0, 0.0], [7.0, 0.8]])
    shared = np.zeros((4, 4))
    shared[1::2, 1::2] = 0.3**2  # the robot's heading error moves both bearings together
    z = zhat + np.array([[0.0, 0.5], [0.0, -0.5]])  # but they went apart: D^2 = 2.7 each, over 300 together
    found = jcbb(z, zhat, shared, R, 9.21, 25.0, (1,))
    assert sum(a is not None for a in found.landmark) == 1


def test_the_joint_gate_grows_with_the_number_of_matches():
    zhat = np.array([[5.0, 0.0], [7.0, 0.8], [9.0, -0.8], [11.0, 0.3]])
    z = zhat + np.array([0.2 * 2.0, 0.0])  # D^2 = 4 each, 16 together: above the gate of one, below that of four
    assert jcbb(z, zhat, 1e-12 * np.eye(8), R, 9.21, 25.0, (1,)).landmark == (0, 1, 2, 3)
    further = zhat + np.array([0.2 * 2.4, 0.0])  # 23 together: above that of four, 17 below that of three no more
    found = jcbb(further, zhat, 1e-12 * np.eye(8), R, 9.21, 25.0, (1,))
    assert 0 < sum(a is not None for a in found.landmark) < 4
