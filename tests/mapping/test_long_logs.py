"""Work that must not grow faster than a log: which places are asked, and among what a submap is searched for."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.laser.robust_graph import solve_graph
from mapweave.mapping import graph_slam, keyframe_graph, known_places
from mapweave.mapping.graph_slam import LoopFinder
from mapweave.mapping.known_places import KnownPlaces, KnownPlacesConfig
from mapweave.mapping.places import PlaceIndex

from .test_spoilt_logs import LOOPS, graph_with, keyframe, match

STEP_COV = np.diag(np.square([0.003, 0.003, 0.001]))


@pytest.fixture
def asked(monkeypatch):
    """How many closures each decision asked."""
    out = []

    def counted(graph, cfg, *, doubtful, unasked):
        out.append(int((doubtful & ~unasked).sum()))
        return solve_graph(graph, cfg, doubtful=doubtful, unasked=unasked)

    monkeypatch.setattr(keyframe_graph, "solve_graph", counted)
    return out


def with_false_places(n=60):
    """A lap with as many true places as false ones, which lie five metres elsewhere."""
    graph, true = graph_with(loops=LOOPS, n=n)
    for a, b in LOOPS:
        graph.tie(a, b, match(a, b, se2.compose(np.array([5.0, 1.0, 0.3]), se2.between(true[a], true[b]))))
    return graph, true


def test_places_that_did_not_hold_are_asked_again_only_once_the_graph_has_grown(asked):
    graph, true = with_false_places()
    graph.settle(for_now=True)
    many = len(LOOPS)
    assert [c.accepted for c in graph.closures] == [True] * many + [False] * many
    asked.clear()
    for a, b in ((3, 43), (5, 45)):
        graph.tie(a, b, match(a, b, se2.between(true[a], true[b])))
        graph.settle(for_now=True)
    assert asked == [many + 1, many + 2]
    assert [c.accepted for c in graph.closures] == [True] * many + [False] * many + [True, True]
    asked.clear()
    for k in range(60, 80):
        graph.add(keyframe(k, np.array([0.5, 0.0, 0.0]), STEP_COV))
    graph.settle(for_now=True)
    assert asked == [2 * many + 2]


def test_a_place_that_did_not_hold_holds_again_where_it_fits_what_the_others_say(asked):
    graph, _ = with_false_places()
    graph.settle(for_now=True)
    graph.closures[0] = replace(graph.closures[0], accepted=False, reason="it contradicts the other measurements")
    asked.clear()
    graph.settle(for_now=True)
    assert asked == [len(LOOPS) - 1]
    assert [c.accepted for c in graph.closures] == [True] * len(LOOPS) + [False] * len(LOOPS)


def test_of_many_places_that_did_not_hold_the_least_far_alone_are_asked(asked, monkeypatch):
    monkeypatch.setattr(keyframe_graph, "ASKED", 3)
    graph, _ = with_false_places()
    graph.settle()
    asked.clear()
    graph.settle()
    steps = len(graph) - 1
    assert asked == [len(LOOPS) + 3, len(LOOPS) + 3 + steps]  # the second time with every step doubtful too
    assert [c.accepted for c in graph.closures] == [True] * len(LOOPS) + [False] * len(LOOPS)


def lapped():
    graph, _ = graph_with(loops=LOOPS)
    known = KnownPlaces(KnownPlacesConfig(enough=1), settled=39, checked=39)
    return graph, known, lambda first, last: graph.pose[first : last + 1]


def test_keyframes_that_leave_wait_for_the_next_decision_and_ask_for_one_where_many_do(asked, monkeypatch):
    monkeypatch.setattr(known_places, "WAITING", 0.3)
    graph, known, lay = lapped()
    for i in (50, 56):
        assert known.step(graph, i, lay) is None
    assert not asked
    assert known.step(graph, 59, lay) == (40, 57)
    assert len(asked) == 1
    assert known.step(graph, len(graph) - 1, lay) is None
    assert len(asked) == 1


def test_where_the_map_knows_a_place_no_more_those_that_were_decided_on_leave_and_the_rest_stays(asked, monkeypatch):
    monkeypatch.setattr(known_places, "WAITING", 0.3)
    graph, known, lay = lapped()
    assert known.step(graph, 50, lay) is None
    graph.settle(for_now=True)
    asked.clear()
    for _ in range(10):
        graph.add(keyframe(len(graph), np.array([0.5, 0.0, 0.0]), STEP_COV))
    graph.path[60:] = graph.path[59]  # nothing before has been driven long ago: no place is known
    assert known.step(graph, 69, lay) == (40, 49)
    assert not asked
    assert known.settled == known.checked == len(graph) - 1 == 59


def test_a_submap_is_searched_for_among_the_nearest_where_there_are_many(monkeypatch):
    monkeypatch.setattr(graph_slam, "SEARCHED", 3)
    graph, true = graph_with()
    finder = LoopFinder(PlaceIndex(), anchors=list(range(0, 40, 2)), way=[0.5 * k for k in range(60)])
    near = finder._old(graph, 50, 48)
    away = np.hypot(*(true[np.array(finder.anchors), :2] - true[50, :2]).T)
    assert near.tolist() == sorted(np.argsort(away, kind="stable")[:3].tolist())
    finder.segment = 45  # nothing holds this segment yet: it may be anywhere
    assert len(finder._old(graph, 50, 48)) == 20


def test_of_many_places_of_one_submap_those_nearest_to_the_estimate_are_kept(monkeypatch):
    monkeypatch.setattr(graph_slam, "FOUND", 2)
    graph, true = graph_with()
    finder = LoopFinder(PlaceIndex(), anchors=[2, 4, 6, 42])
    shift = [np.array([x, 0.0, 0.0]) for x in (3.0, 0.1, 0.2)]
    found = [match(k, 3, se2.compose(s, se2.between(true[2 + 2 * k], true[42]))) for k, s in enumerate(shift)]
    assert finder._nearest(graph, 3, found) == found[1:]
    assert finder._nearest(graph, 3, found[:2]) == found[:2]
