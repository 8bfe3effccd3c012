"""A recording of several robots is mapped as a team: each robot of it by its own scans and odometry."""

import json

import numpy as np
import pytest

import mapweave
from mapweave.api.map_options import LaserOptions
from mapweave.core.errors import DataError

from ..io.ros_logs import N, Recording

SPEED = {"carter1": 0.5, "carter2": -0.25}


def team(path, n=8, also=()):
    """Robots that drive along x at a speed of their own towards the end of a corridor; also: texts on these topics."""
    out = Recording(path)
    for topic in also:
        out.text(9.8, topic=topic)
    out.tf(9.9, "base_link", "laser", topic="/tf_static")
    angle = np.linspace(-1.5, 1.5, N)
    side = 1.2 / np.maximum(np.abs(np.sin(angle)), 1e-6)
    for k in range(n):
        for name, v in SPEED.items():
            out.odom(10.0 + 0.5 * k, v * 0.5 * k, topic=f"/{name}/odom")
            beams = np.minimum(side, (4.0 - v * 0.5 * k) / np.cos(angle))
            out.scan(10.0 + 0.5 * k, beams, topic=f"/{name}/scan")
    return out.write()


def test_every_robot_of_a_recording_is_mapped_and_called_by_name(tmp_path):
    path = team(tmp_path / "team.mcap")
    result = mapweave.map(path, tmp_path / "out", method="icp")
    told = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert {k: robot["name"] for k, robot in told["robots"].items()} == {"1": "carter1", "2": "carter2"}
    for made, (k, v) in zip(result.maps, enumerate(SPEED.values(), 1), strict=True):
        assert (tmp_path / "out" / "trajectories" / f"robot{k}.tum").is_file()
        way = made.track.pose[-1, 0] - made.track.pose[0, 0]
        assert way == pytest.approx(3.5 * v, abs=0.3)
    assert result.maps[0].log_hash != result.maps[1].log_hash


@pytest.mark.parametrize(
    ("robots", "unused"),
    [
        (None, {"/log": "no reader for this type", "/carter1/status": "no reader for this type"}),
        (
            ["1"],
            {
                "/log": "no reader for this type",
                "/carter1/status": "no reader for this type",
                "/carter2/scan": "of another robot, or not chosen",
                "/carter2/odom": "of another robot, or not chosen",
            },
        ),
    ],
)
def test_what_no_robot_used_is_told_in_the_metrics_and_on_the_page(tmp_path, robots, unused):
    path = team(tmp_path / "team.mcap", also=["/log", "/carter1/status"])
    mapweave.map(path, tmp_path / "out", method="icp", robots=robots)
    told = json.loads((tmp_path / "out" / "metrics.json").read_text())["unused"]
    assert {row["topic"]: row["reason"] for row in told} == unused
    page = (tmp_path / "out" / "report.html").read_text()
    assert all(page.count(f">{topic}<") == 1 for topic in unused)


def test_robots_of_a_recording_are_chosen_by_number_or_by_topic(tmp_path):
    path = team(tmp_path / "team.mcap")
    second = mapweave.map(path, robots=["2"], method="icp")
    assert [made.robot for made in second.maps] == ["2"]
    assert second.metrics["robots"]["2"]["name"] == "carter2"
    by_topic = mapweave.map(path, method="icp", laser=LaserOptions(scan_topic="/carter2/scan"))
    assert np.allclose(by_topic.maps[0].track.pose, second.maps[0].track.pose)
    with pytest.raises(DataError, match="there is no robot 3 among 2 robots of 1 logs"):
        mapweave.map(path, robots=["3"])
