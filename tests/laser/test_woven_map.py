"""Components of woven robots: frames, ways, covariances, grids and closures, from graphs made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core import se2
from mapweave.core.records import Track
from mapweave.laser.closures import Closure
from mapweave.laser.laser_map import GridMap, LaserMap, ScanRecords
from mapweave.laser.pose_graph import PoseGraph
from mapweave.laser.robot_graph import RobotGraph
from mapweave.laser.robust_graph import RobustGraphConfig, solve_graph
from mapweave.mapping import woven_map
from mapweave.mapping.merge import MapClosure, Merge
from mapweave.mapping.weave import Woven
from mapweave.mapping.woven_map import DROPPED, contradictions, own_map, woven_maps

N, EVERY = 21, 5  # stamps, and stamps between keyframes
T = np.array([2.0, 1.0, 0.5])  # where robot 2's map lies in robot 1's
TIGHT = np.diag([1e4, 1e4, 1e5])
ROWS = np.arange(0, N, EVERY)


def robot(key, *, laid=0.0, feature="none"):
    """A robot that drove a bow; between keyframes its scans were laid `laid` [m] beside the graph's poses."""
    t = 100.0 + np.arange(N)
    pose = np.column_stack([0.3 * np.arange(N), 0.01 * np.arange(N) ** 2, 0.05 * np.arange(N)])
    pose = se2.between(pose[0], pose)
    graph_pose = pose[ROWS]
    track = se2.compose(pose, np.array([0.0, laid, 0.0]))
    n = len(ROWS)
    seen = np.tile([[1.0, 0.5], [1.0, -0.5]], (n, 1))
    cov = np.array([np.diag([1e-4, 4e-4, 1e-5]) * (1 + k) for k in range(n)])
    light = feature != "none"
    graph = RobotGraph(
        robot=key,
        t=t[ROWS],
        pose=graph_pose,
        cov=cov,
        path=0.3 * ROWS,
        step=se2.between(graph_pose[:-1], graph_pose[1:]),
        step_information=np.tile(TIGHT, (n - 1, 1, 1)),
        closures=(
            Closure((0, 0), 0, 4, False, "too few returns", np.zeros(3), np.eye(3), np.zeros(3), 0.2, None, 0.4, 0.1),
        ),
        start=2 * np.arange(n + 1),
        points=seen,
        normals=np.tile([-1.0, 0.0], (2 * n, 1)),
        q=np.full(2 * n, 0.7) if light else None,
        lined=np.ones(2 * n, dtype=bool),
        sensor=np.zeros((n, 2)),
        feature=feature,
    )
    none, count = np.zeros(N), np.zeros(N, dtype=np.int64)
    scans = ScanRecords(t, ("",) * N, track, np.zeros((N, 3)), count, count, ("matched",) * N, none, count > 0)
    empty = np.zeros((2, 2))
    grid = GridMap(0.1, np.zeros(2), empty.astype(int), empty.astype(int), np.zeros((2, 2, 2)), empty, empty)
    return LaserMap(key, "graph", feature, Track(t, track, np.tile(cov[0], (N, 1, 1))), grid, scans, graph=graph)


def tie(first, second, accepted, measured):
    reason = "it confirms the transform" if accepted else "it scores too little"
    return MapClosure(first, second, measured, TIGHT, 0.9, 0.4, 0.8, 1.0, accepted, reason)


def woven_of(maps, *, false=False):
    """Robots 1 and 2 tied three times (a fourth tie is false, where asked for); further robots alone."""
    graphs = [m.graph for m in maps]
    a, b = graphs[0].pose, se2.compose(T, graphs[1].pose)
    ties = [tie(k, k, True, se2.between(a[k], b[k])) for k in (0, 2, 4)]
    ties += [tie(1, 3, True, np.array([9.0, 0.0, 0.0]))] if false else [tie(1, 3, False, np.zeros(3))]
    merges = [Merge("1", "2", True, "merged on 3 closures", transform=T, closures=tuple(ties))]
    if len(maps) > 2:
        merges.append(Merge("1", "3", False, "too little", closures=(tie(0, 0, True, np.zeros(3)),)))
    n = len(ROWS)
    pose = np.concatenate([a, b, *(g.pose for g in graphs[2:])])
    graph = PoseGraph.of(pose, [], [], [])
    for k, g in enumerate(graphs):
        steps = g.steps()
        graph = graph.joined(
            PoseGraph(pose, steps.first + k * n, steps.second + k * n, steps.measured, steps.information)
        )
    within = graph.edges
    held = [c for c in ties if c.accepted]
    pairs = [(c.first, n + c.second) for c in held]
    graph = graph.joined(PoseGraph.of(pose, pairs, [c.measured for c in held], [c.information for c in held]))
    joint = solve_graph(graph, RobustGraphConfig(method="cauchy"), doubtful=np.arange(graph.edges) >= within)
    component = np.array([0, 0, *range(1, len(maps) - 1)])
    return Woven(tuple(merges), component, (a, b, *(g.pose for g in graphs[2:])), joint)


def test_a_robot_is_carried_into_the_frame_of_the_first_with_what_its_scans_were_laid_by():
    maps = [robot("1", laid=0.02), robot("2", laid=0.02)]
    (made,) = woven_maps(maps, woven_of(maps), 0.1)
    assert made.robots == ("1", "2")
    assert np.allclose(made.tracks["1"].pose, maps[0].track.pose, atol=1e-9)
    assert np.allclose(made.tracks["2"].pose, se2.compose(T, maps[1].track.pose), atol=1e-9)
    assert made.tracks["2"].frame == made.grid.frame == "map"


def test_covariances_grow_from_the_first_pose_in_the_axes_of_the_map():
    maps = [robot("1"), robot("2")]
    woven = woven_of(maps)
    (made,) = woven_maps(maps, woven, 0.1)
    assert np.allclose(made.tracks["1"].cov[0], maps[0].graph.cov[0])
    joint = woven.joint.covariances()
    rows = len(ROWS) + np.arange(len(ROWS))
    assert np.allclose(made.tracks["2"].cov[ROWS], joint[rows] + maps[0].graph.cov[0], atol=1e-12)
    (wide,) = woven_maps(maps, woven, 0.1, unsure=3.0)
    assert np.allclose(wide.tracks["2"].cov[ROWS], 3.0 * joint[rows] + maps[0].graph.cov[0], atol=1e-12)
    turned = replace(woven, pose=tuple(se2.compose(np.array([0.0, 0.0, 1.2]), p) for p in woven.pose))
    (other,) = woven_maps(maps, turned, 0.1)
    expected = se2.turned_covariance(1.2, joint[rows]) + maps[0].graph.cov[0]
    assert np.allclose(other.tracks["2"].cov[ROWS], expected, atol=1e-12)


def test_the_grid_holds_every_keyframes_returns_where_the_map_puts_them():
    maps = [robot("1"), robot("2")]
    (made,) = woven_maps(maps, woven_of(maps), 0.1)
    assert made.grid.hits.sum() == 2 * len(maps[0].graph.points)
    graph = maps[1].graph
    there = np.concatenate([se2.act(se2.compose(T, p), graph.points[graph.rows(k)]) for k, p in enumerate(graph.pose)])
    at = np.floor((there - made.grid.origin) / made.grid.resolution).astype(int)
    assert (made.grid.hits[at[:, 1], at[:, 0]] > 0).all()


@pytest.mark.parametrize(
    ("features", "held"), [(("normalised", "normalised"), "normalised"), (("normalised", "none"), "none")]
)
def test_light_is_in_the_map_only_where_every_robot_has_it(features, held):
    maps = [robot(k, feature=f) for k, f in zip("12", features, strict=True)]
    (made,) = woven_maps(maps, woven_of(maps), 0.1)
    assert made.feature == held
    assert made.grid.feature.max() == pytest.approx(0.7 if held == "normalised" else 0.0, abs=1e-4)


def test_closures_tell_what_was_believed_refused_and_dropped():
    maps = [robot("1"), robot("2")]
    (made,) = woven_maps(maps, woven_of(maps, false=True), 0.1)
    told = [(c.robot_a, c.robot_b, c.accepted) for c in made.closures]
    assert told == [("1", "1", False), ("2", "2", False), *[("1", "2", True)] * 3, ("1", "2", False)]
    assert made.closures[-1].reason.startswith(DROPPED)
    assert made.closures[0].reason == "too few returns"
    assert made.graph.edges == 2 * (len(ROWS) - 1) + 3
    first = made.closures[2]
    assert (first.stamp_a, first.stamp_b) == (100.0, 100.0)
    assert np.allclose(first.at, [[0.0, 0.0], T[:2]], atol=1e-9)
    assert (first.score, first.second, first.share, first.nis) == (0.9, 0.4, 0.8, 1.0)


def test_robots_are_asked_for_contradictions_where_the_map_has_them(monkeypatch):
    maps = [robot("1"), robot("2")]
    asked = []
    monkeypatch.setattr(woven_map, "drawn_twice", lambda placed: asked.extend(placed) or iter(["told"]))
    (made,) = woven_maps(maps, woven_of(maps), 0.1)
    assert list(contradictions(maps, made)) == ["told"]
    assert [m.robot for m in asked] == ["1", "2"]
    assert np.concatenate([m.pose for m in asked]).tobytes() == made.graph.pose.tobytes()
    asked.clear()
    assert list(contradictions(maps, own_map(maps[0]))) == ["told"]
    assert asked == []  # nobody: a robot alone tells what it contradicts of itself


def test_a_robot_alone_keeps_its_own_map_and_the_component_of_most_robots_comes_first():
    maps = [robot("1"), robot("2"), robot("3")]
    woven = woven_of(maps)
    big, alone = woven_maps(maps, woven, 0.1)
    assert (big.robots, alone.robots) == (("1", "2"), ("3",))
    assert alone.tracks["3"] is maps[2].track
    assert alone.grid is maps[2].grid
    refused = [c for c in big.closures if c.robot_b == "3"]
    assert [(c.accepted, c.reason) for c in refused] == [(False, "the maps are not merged: too little")]
    assert not [c for c in alone.closures if c.robot_a != "3"]
    swapped = replace(woven, component=np.array([0, 1, 1]), merges=())
    first, second = woven_maps(maps, swapped, 0.1)
    assert (first.robots, second.robots) == (("2", "3"), ("1",))
