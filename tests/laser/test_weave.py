"""Many robots' maps woven: components, frames, and one graph over all."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from laser_pairs import PairConfig, drive_pair

from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.laser.robot_graph import RobotGraph
from mapweave.mapping import weave as weaving
from mapweave.mapping.map_overlap import keyframe_map
from mapweave.mapping.weave import weave
from mapweave.sim.laser_worlds import office_floor

CFG = PairConfig(keyframes=130, beams=120)


def robot_graph(m, name):
    """A graph of steps alone, as the map has them."""
    n = len(m.pose)
    counts = [len(p) for p in m.points]
    points = np.concatenate(m.points)
    return RobotGraph(
        robot=name,
        t=np.arange(n, dtype=float),
        pose=m.pose,
        cov=np.zeros((n, 3, 3)),
        path=m.path,
        step=se2.between(m.pose[:-1], m.pose[1:]),
        step_information=np.repeat(np.diag([4e4, 4e4, 1e6])[None], n - 1, 0),
        closures=(),
        start=np.concatenate([[0], np.cumsum(counts)]),
        points=points,
        normals=np.zeros_like(points),
        q=None,
        lined=np.zeros(len(points), dtype=bool),
        sensor=np.zeros((n, 2)),
    )


@pytest.mark.slow
def test_robots_that_meet_are_woven_and_a_stranger_stays_alone():
    floor = office_floor(600.0, 3)
    made = drive_pair(
        Walls.of(floor.world.segments), floor.lower + 4.0, floor.upper - 4.0, 0.8, np.random.default_rng([3, 3]), CFG
    )
    other = office_floor(600.0, 21)
    stranger = drive_pair(
        Walls.of(other.world.segments), other.lower + 4.0, other.upper - 4.0, 0.5, np.random.default_rng(5), CFG
    )
    robots = [robot_graph(m, str(k + 1)) for k, m in enumerate((made.a, stranger.a, made.b))]
    assert np.array_equal(keyframe_map(robots[0]).points[7], made.a.points[7])
    woven = weave(robots)
    assert woven.component.tolist() == [0, 1, 0]
    assert [(m.a, m.b, m.merged) for m in woven.merges] == [("1", "2", False), ("1", "3", True), ("2", "3", False)]
    assert np.allclose(woven.pose[0][0], robots[0].pose[0])
    assert np.allclose(woven.pose[1], robots[1].pose, atol=1e-6)
    there = se2.compose(made.transform, made.b.pose)
    assert np.median(np.hypot(*(woven.pose[2] - there)[:, :2].T)) < 0.25
    assert woven.joint.converged
    with ThreadPoolExecutor(3) as pool:
        beside = weave(robots, executor=pool)
    assert [m.row() for m in beside.merges] == [m.row() for m in woven.merges]
    assert all((one == other).all() for one, other in zip(beside.pose, woven.pose, strict=True))
    alone = weave(robots[::2], merge=False)
    assert alone.component.tolist() == [0, 1]
    assert not alone.merges


def test_ties_of_submaps_that_overlap_count_as_so_many_measurements_as_they_are(monkeypatch):
    floor = office_floor(600.0, 3)
    walls = Walls.of(floor.world.segments)
    made = drive_pair(walls, floor.lower + 4.0, floor.upper - 4.0, 0.8, np.random.default_rng([3, 3]), CFG)
    robots = [robot_graph(m, str(k + 1)) for k, m in enumerate((made.a, made.b))]
    woven = weave(robots)
    held = [c for c in woven.merges[0].closures if c.accepted]
    assert len(held) > 4
    within = sum(len(r) - 1 for r in robots)
    ties = woven.joint.graph.information[within:]
    least = min(weaving.TIES_ALIKE, len(held))
    assert np.allclose(ties, np.array([c.information for c in held]) / least)
    sd = np.sqrt(np.trace(woven.joint.covariances()[len(robots[0])][:2, :2]))
    monkeypatch.setattr(weaving, "TIES_ALIKE", 1.0)
    each = weave(robots)
    assert sd > 1.2 * np.sqrt(np.trace(each.joint.covariances()[len(robots[0])][:2, :2]))
