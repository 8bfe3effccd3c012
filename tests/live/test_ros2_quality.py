"""What joins from a ROS graph maps as well as its recording: a robot with two scanners, and another beside it."""

import threading
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mapweave.api.live import live_robots
from mapweave.api.live_ros2 import RosOptions
from mapweave.api.map_laser import map_logs
from mapweave.api.map_options import MapOptions
from mapweave.core import se2
from mapweave.live.transport import Network
from mapweave.sim.laser import drive
from mapweave.sim.laser_worlds import OfficeConfig, office_route, office_world

from .processes import free_endpoint
from .ros_peer import SENSOR, RosDrive, open_session, scan, transforms, wait_for
from .test_ros2_processes import record

RATE = 20.0  # times as fast as robots drive
OFFICE = OfficeConfig(rooms=2, visited=2)
FRONT, REAR = (0.2, 0.05, 0.3), (-0.2, -0.05, 3.0)
LASER = "sensor_msgs/msg/LaserScan"


@cache
def driven(k, mounts=(FRONT,)):
    """Robot k's way through the office: what its scanners saw, one after the other, as one log; and the truth."""
    world, cfg = office_world(OFFICE, 3), replace(OFFICE.drive, scan_every=0.15)
    made = [drive(world, office_route(OFFICE, k), replace(cfg, sensor_pose=mount), k) for mount in mounts]
    log = made[0].log
    scans = tuple(replace(made[row % len(made)].log.scans[row], intensities=None) for row in range(len(log.scans)))
    return replace(log, robot=f"robot{k}", source=f"r{k}", scans=scans), made[0].truth


class TwoScanners(RosDrive):
    """Scans come from `scan` and `rear/scan` by turns, each in a frame of its own."""

    def __init__(self, session, space, log):
        super().__init__(session, space, log, FRONT)
        self.node.publisher(f"/{space}/rear/scan", LASER, SENSOR)
        still = ((1.0, f"{space}/base_link", f"{space}/{name}", at) for name, at in (("laser", FRONT), ("rear", REAR)))
        self.node.say("/tf_static", transforms(*still))

    def tell(self, t, what, k):
        if what == "odometry" or k % 2 == 0:
            super().tell(t, what, k)
        else:
            s = self.log.scans[k]
            seen = np.where(s.hit, s.ranges, np.inf).tolist()
            made = scan(t, f"{self.space}/rear", seen, s.angle_min, s.angle_increment, s.range_max)
            self.node.say(f"/{self.space}/rear/scan", made)


def recorded(ones, folder, at):
    """What two robots of one process kept of all that `ones` told it: their logs."""
    stop, said = threading.Event(), []
    arguments = {
        "ros": RosOptions(all_scanners=True),
        "network": Network(connect=(at,)),
        "stop": stop,
        "say": said.append,
    }
    thread = threading.Thread(target=live_robots, args=(["r1", "r2"], ["tb1", "tb2"]), kwargs=arguments)
    thread.start()
    wait_for(lambda: "r1: hears /tb1/scan and /tb1/rear/scan, odometry from /tb1/odom" in said)
    wait_for(lambda: "r2: hears /tb2/scan, odometry from /tb2/odom" in said)
    ones[0].wait_for_a_listener()
    wait_for(lambda: ones[0].node.is_heard("/tb1/rear/scan"))
    playing = [threading.Thread(target=one.play, args=(RATE,)) for one in ones]
    for each in playing:
        each.start()
    for each in playing:
        each.join()
    for one, topic, payload, words in (
        (ones[0], "/tb1/scan", b"", "r1: refused: malformed"),
        (ones[0], "/tb1/rear/scan", scan(500.0, "tb1/rear", [1.0, 2.0], 0.0, 0.1, 10.0), "r1: refused: clock"),
        (ones[1], "/tb2/scan", b"", "r2: refused: malformed"),
    ):  # what each told last is refused and told of: all before was heard
        one.node.say(topic, payload)
        wait_for(lambda words=words: any(line.startswith(words) for line in said))
    stop.set()
    thread.join(60)
    return [record(folder / f"mapweave-live/team-{name}.sqlite", name)[0] for name in ("r1", "r2")]


def only(log, heard):
    """The log of the scans that were heard: what robots tell at best effort may be lost on a busy machine."""
    kept = np.isin(np.round(log.scan_t, 6), np.round(heard.scan_t, 6))
    assert kept.sum() == len(heard.scans)
    scans = tuple(scan for scan, here in zip(log.scans, kept, strict=True) if here)
    return replace(log, scan_t=log.scan_t[kept], scans=scans)


def woven(logs):
    """The one map of both robots."""
    (made,) = map_logs(logs, MapOptions(start={"1": (0.0, 0.0, 0.0), "2": (0.0, 0.0, 0.0)})).components
    return made


@pytest.mark.slow
def test_two_scanners_and_two_robots_through_ros_map_as_well_as_their_recordings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulated = [driven(1, (FRONT, REAR)), driven(2)]
    logs = [log for log, _ in simulated]
    at = free_endpoint()
    router = open_session(at, "router")
    with open_session(at) as session:
        ones = TwoScanners(session, "tb1", logs[0]), RosDrive(session, "tb2", logs[1], FRONT)
        heard = recorded(ones, tmp_path, at)
    router.close()
    assert all(len(log.scans) >= 0.98 * len(told.scans) for log, told in zip(heard, logs, strict=True))
    logs = [only(log, told) for log, told in zip(logs, heard, strict=True)]
    for ours, theirs in zip(heard[0].scans, logs[0].scans, strict=True):
        np.testing.assert_allclose(ours.T_robot_sensor, theirs.T_robot_sensor, atol=1e-6)
    assert {tuple(np.round(scan.T_robot_sensor, 3)) for scan in heard[0].scans} == {FRONT, REAR}
    through, direct = woven(heard), woven(logs)
    begin = simulated[0][1].pose[0]
    for key, (_, truth) in zip("12", simulated, strict=True):
        ours, theirs = through.tracks[key], direct.tracks[key]
        same = np.isin(theirs.t, ours.t)  # the first and last wheels may be lost
        assert len(ours.t) == same.sum() > len(theirs.t) - 5
        np.testing.assert_allclose(ours.pose, theirs.pose[same], atol=2e-3)
        off = ours.pose - se2.between(begin, se2.interpolate(ours.t, truth.t, truth.pose))
        assert np.hypot(off[:, 0], off[:, 1]).mean() < 0.05
