"""Robots that do not know where the others start: each for itself, until two maps are of one place."""

import json

import numpy as np
import pytest

from mapweave.api.explore import explore
from mapweave.core import se2
from mapweave.core.walls import Walls
from mapweave.exploration.laser.config import LaserPlan, find_laser_scenario
from mapweave.exploration.laser.experiment import LaserMission, explore_laser_once
from mapweave.exploration.laser.planners import candidate_commands, steer
from mapweave.kernels.exploration.wavefront import arc_clearance
from mapweave.laser.keyframes import KeyframeScan
from mapweave.mapping.laser_team import LaserTeam
from mapweave.mapping.merge import merge_maps
from mapweave.sim.laser import LaserWorld
from mapweave.sim.laser_team import LaserTeamSim

APART = """
sensor = "laser"
walls = [
  [0, 0, 6, 0], [6, 0, 6, 5], [6, 5, 0, 5], [0, 5, 0, 0], [2, 5, 2, 4],
  [10, 0, 17, 0], [17, 0, 17, 4], [17, 4, 10, 4], [10, 4, 10, 0], [13, 0, 13, 1.5],
]
starts = [[1.5, 2.5, 0.0], [11.5, 2.0, 0.0]]
"""
HALL = Walls(
    np.array(
        [[0, 0, 9, 0], [9, 0, 9, 6], [9, 6, 0, 6], [0, 6, 0, 0], [4, 6, 4, 4.5], [6, 0, 6, 1.5], [0, 2, 1, 2]], float
    ),
    np.full(7, 0.5),
)


@pytest.mark.slow
def test_robots_that_know_no_starts_find_each_other_and_make_one_true_map():
    """Office 24 has rooms that look alike: by their maps alone robots would be joined 13.5 m off."""
    told, record = explore_laser_once(LaserMission(find_laser_scenario("office-1000"), 4, apart=True), 24)
    assert told.finished
    assert record.maps == (("robot1", "robot2", "robot3", "robot4"),)
    assert sum(m.joined for m in record.meetings) == 3
    assert told.area_mapped >= 0.99
    assert told.collisions == 0
    assert told.misassociations == 0
    assert told.trajectory_rmse <= 0.12
    assert told.nees_per_dof < 1.5
    alike = [m for m in record.meetings if not m.joined and m.through >= 50]
    assert alike
    assert all(m.wrong < 0.1 and m.seen <= 2 for m in alike)
    assert "would have seen each other there" in alike[0].reason


def test_robots_in_two_buildings_stay_apart_and_are_told_so(tmp_path):
    path, out = tmp_path / "apart.toml", tmp_path / "out"
    path.write_text(APART)
    result = explore(path, out, unknown_starts=True)
    (told,) = result.runs
    assert not told.finished
    assert told.maps == 2
    assert "robot2: not found in the map of robot1, nor is what they mapped" in result.lines()
    assert [p.name for p in (out / "trajectories").iterdir()] == ["robot1.tum"]
    assert np.isfinite(result.first.moments[-1].poses[0]).all()
    assert np.isnan(result.first.moments[-1].poses[1]).all()  # nobody knows where it is in the map
    assert (out / "log" / "robot2.mcap").exists()
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["unknown_starts"] is True
    assert metrics["first_run"]["maps"] == [["robot1"], ["robot2"]]
    (tried,) = metrics["first_run"]["meetings"]
    assert not tried["joined"]
    assert tried["reason"] == "too little overlap: none of 1 submaps is found in the other map"
    assert tried["robots"] == ["robot1", "robot2"]
    assert "not found in the map of robot1" in (out / "report.html").read_text()


def two_in_a_hall():
    """A team that has met nobody, after both robots drove a while; and its true poses at the start."""
    starts = np.array([[2.0, 1.0, 0.3], [7.0, 4.0, 2.0]])
    sim = LaserTeamSim(LaserWorld(HALL.segments, HALL.reflectance), starts, seed=3)
    team = LaserTeam(None, np.zeros((2, 3)), apart=True)
    for k in range(40):
        for j in range(2):
            team.add_scan(j, sim.t, sim.scan(j))
            team.deliver(j)
        team.optimise()
        sim.step(np.array([[0.3, 0.25 if k < 20 else -0.2], [0.3, 0.2]]))
    return team, starts


def test_who_is_in_view_is_seen_where_the_maps_truly_lie_and_not_elsewhere():
    team, starts = two_in_a_hall()
    true = se2.between(starts[0], starts[1])
    seen, through = team.in_view(0, 1, true)
    assert seen > 20
    assert through == 0
    back = team.in_view(1, 0, se2.inverse(true))
    assert back == (seen, through)
    mirrored = se2.between(starts[0], np.array([9.0 - starts[1, 0], 6.0 - starts[1, 1], starts[1, 2] + np.pi]))
    seen, through = team.in_view(0, 1, mirrored)
    assert through > 20
    assert seen <= 0.1 * through


@pytest.mark.parametrize(
    ("ranges", "told"),
    [([2.8, 2.8, 2.8], 1), ([4.0, 4.0, 4.0], -1), ([2.8, 4.0, 4.0], 0), ([1.0, 1.0, 1.0], 0), ([2.8], 0)],
)
def test_a_robot_in_view_is_seen_where_most_beams_end_at_it_and_missing_where_all_go_on(ranges, told):
    team = LaserTeam(None, np.zeros((2, 3)), apart=True)
    at = np.array([0.0, 0.03, -0.03])[: len(ranges)]
    points = np.array(ranges)[:, None] * np.column_stack([np.cos(at), np.sin(at)])
    scan = KeyframeScan(0, 0, 0.0, np.zeros(3), points, np.zeros((0, 2)), np.zeros(2))
    assert team._sees(scan, np.array([3.0, 0.0])) == told


def test_crews_that_met_share_a_map_that_is_right_and_says_how_well():
    team, starts = two_in_a_hall()
    merge = merge_maps(team.keyframe_map(1), team.keyframe_map(0))
    assert merge.transform is not None
    np.testing.assert_allclose(merge.transform, se2.between(starts[1], starts[0]), atol=0.1)
    before = [sum(len(scan.points) for scan in team.scans if scan.robot == j) for j in range(2)]
    local = team.team.pose.copy()
    team.meet(1, 0, merge)
    assert team.team.crew.tolist() == [0, 0]
    for j in range(2):  # what they saw of each other is gone
        assert sum(len(scan.points) for scan in team.scans if scan.robot == j) < before[j]
    np.testing.assert_allclose(team.starts[1], se2.between(starts[0], starts[1]), atol=0.1)
    ties = [c for c in team.closures if c.robots in {(0, 1), (1, 0)}]
    assert sum(c.accepted for c in ties) >= 3
    (tie,) = [c for c in ties if c.reason == merge.reason]
    T, P = se2.inverse(merge.transform), np.asarray(merge.covariance)
    there = local[tie.second]  # in its own map

    def moved(e):  # as the maps lie when the transform errs by e in the frame of the first map of the merge
        other = se2.compose(merge.transform, se2.exp(e))
        return se2.log(se2.between(se2.compose(T, there), se2.compose(se2.inverse(other), there)))

    J = np.column_stack([(moved(h) - moved(-h)) / 2e-5 for h in 1e-5 * np.eye(3)])
    np.testing.assert_allclose(np.linalg.inv(tie.information), J @ P @ J.T, rtol=1e-3, atol=1e-9)
    first = team.team.of[1][0]
    error = se2.between(se2.between(starts[0], starts[1]), team.team.pose[first])
    assert np.hypot(*error[:2]) < 0.06
    P = team.covariances()[first]
    e = team.team.pose[first] - se2.between(starts[0], starts[1])
    e[2] = se2.wrap_angle(e[2])
    assert e @ np.linalg.solve(P, e) < 16.0
    assert P[0, 0] < 0.1**2


def test_no_arc_leads_more_than_half_the_way_to_a_robot_that_nobody_knows():
    cfg = LaserPlan()
    ahead = np.array([[0.62, 0.0], [0.63, 0.05], [0.63, -0.05]])
    pose, target, nobody = np.zeros(3), np.array([3.0, 0.0]), np.zeros((0, 2))
    as_walls = steer(pose, target, ahead, nobody, cfg)
    command = steer(pose, target, ahead, nobody, cfg, ahead)
    commands, _ = candidate_commands(cfg)
    assert (commands == command).all(axis=1).any()

    def left(u):
        return arc_clearance(u[None], cfg.period, ahead, 0.02)[0] - cfg.radius

    gap = 0.62 - cfg.radius
    assert left(command) >= 0.5 * gap - 1e-9
    assert left(as_walls) < 0.5 * gap
