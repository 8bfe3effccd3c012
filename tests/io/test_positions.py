"""The network that `locate` writes is read back whole."""

import numpy as np
import scipy.sparse as sp

from mapweave.io.positions import read_network, write_network
from mapweave.swarm.result import JointInformation


def test_the_joint_information_read_back_is_that_which_was_written_on_both_sides_of_its_diagonal(tmp_path):
    root = np.random.default_rng(0).normal(size=(6, 6))
    told = JointInformation(sp.csc_matrix(root @ root.T), np.array([True, True, False, False, False, False]), 2)
    write_network(tmp_path / "network.npz", np.array([[0, 1], [2, 0]]), told)
    pairs, known = read_network(tmp_path / "network.npz", 3)
    assert pairs.tolist() == [[0, 1], [2, 0]]
    np.testing.assert_array_equal(known.matrix.toarray(), root @ root.T)
    assert (known.held.tolist(), known.width) == (told.held.tolist(), 2)
