"""Searches for places seen before that find none, one after the other."""

import numpy as np
import pytest

from mapweave.laser.closures import Closure
from mapweave.laser.config import GraphConfig
from mapweave.laser.log_warnings import unfound_places
from mapweave.laser.robot_graph import RobotGraph

IN_A_ROW = GraphConfig().unfound


def graph(*found, tries=2):
    """Keyframes 10 s apart of which all from number 3 on were searched for, each `tries` times; found: the last try."""
    n, none = 3 + len(found), np.zeros(0)
    closures = [
        Closure((0, 0), k % 2, k, good and k % 2 == tries - 1 - j, "", np.zeros(3), np.eye(3), np.zeros(3), 0.0, None)
        for k, good in enumerate(found, 3)
        for j in range(tries)
    ]
    return RobotGraph(
        robot="1",
        t=10.0 * np.arange(n),
        pose=np.zeros((n, 3)),
        cov=np.zeros((n, 3, 3)),
        path=np.arange(n, dtype=float),
        step=np.zeros((n - 1, 3)),
        step_information=np.tile(np.eye(3), (n - 1, 1, 1)),
        closures=tuple(closures),
        start=np.zeros(n + 1, np.int64),
        points=np.zeros((0, 2)),
        normals=np.zeros((0, 2)),
        q=None,
        lined=none.astype(bool),
        sensor=np.zeros((n, 2)),
    )


def test_searches_in_a_row_that_find_nothing_are_told_with_their_time():
    (said,) = unfound_places(graph(True, *[False] * IN_A_ROW, True, False), IN_A_ROW)
    assert said.startswith("from 40.0 s to 90.0 s places seen before were searched for 6 times in a row")


@pytest.mark.parametrize("found", [(), (False,) * (IN_A_ROW - 1), (*[False] * (IN_A_ROW - 1), True, *[False] * 3)])
def test_fewer_are_not(found):
    assert unfound_places(graph(*found), IN_A_ROW) == ()


def test_the_longest_stretch_is_told():
    (said,) = unfound_places(graph(*[False] * IN_A_ROW, True, *[False] * (IN_A_ROW + 2)), IN_A_ROW)
    assert said.startswith("from 100.0 s to 170.0 s")
    assert " 8 times in a row" in said
