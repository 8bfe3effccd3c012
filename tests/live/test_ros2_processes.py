"""A live robot beside nodes that speak the protocol of rmw_zenoh: scans in, map, poses and transforms back."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.live import live_robot, live_robots
from mapweave.api.live_ros2 import RosOptions
from mapweave.api.map_laser import map_logs
from mapweave.api.map_options import MapOptions
from mapweave.core import se2
from mapweave.core.errors import UsageError
from mapweave.core.laser_log import LaserLog
from mapweave.live.door import decode
from mapweave.live.driven import LaserRobot
from mapweave.live.laser_stream import scans_told
from mapweave.live.messages import Closed, GoalMessage, Topics, encode
from mapweave.live.store import Store
from mapweave.live.transport import Network, put, told_on
from mapweave.live.transport import session as transport_session
from mapweave.mapping.config import LaserConfig
from mapweave.sim.laser import DriveConfig
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

from ..io.made_spins import scans_of, truth_of
from .processes import Fleet, free_endpoint
from .ros_peer import (
    HASHES,
    SENSOR,
    BridgedNode,
    Node,
    RosDrive,
    fix,
    imu,
    open_session,
    read_goal,
    read_grid,
    read_pose,
    read_transforms,
    scan,
    wait_for,
)

MOUNT = (0.2, 0.05, 0.3)
SCAN, GRID = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid"
GOAL = "geometry_msgs/msg/PoseStamped"
POSE, TF = "geometry_msgs/msg/PoseWithCovarianceStamped", "tf2_msgs/msg/TFMessage"


def drive(seed):
    return simulate_corridor(CorridorConfig(distance=5.0, drive=DriveConfig(sensor_pose=MOUNT)), seed)


@pytest.fixture
def ros():
    """Where the router of a ROS graph stands, and a session in that graph."""
    at = free_endpoint()
    router = open_session(at, "router")
    session = open_session(at)
    yield at, session
    session.close()
    router.close()


@pytest.fixture
def fleet(tmp_path, ros):
    made = Fleet(tmp_path, "ros2")
    made.at = ros[0]
    yield made
    made.end()


def joins(fleet, name, *words):
    return fleet.start(name, "robot", "--name", name, "--source", "ros2", "--connect", fleet.at, *words)


def all_heard(one, said, times=1):
    """Everything `one` has told was heard: so was what it said last, which is refused and told of."""
    one.node.say(f"/{one.space}/scan", b"")
    wait_for(lambda: sum("refused: malformed" in words for words in said) >= times)


def record(path, name):
    """What a robot's history holds, as one log, and its last message."""
    with Store(path, f"robot {name} of team team") as store:
        kept = [decode(payload) for _, payload in store.get(name, 0, 1 << 30)]
    return scans_told(kept), kept[-1]


def same_scans(log, simulated):
    """Every scan with its odometry and place as it was driven; stamps to the nanosecond."""
    np.testing.assert_array_equal(log.scan_t, simulated.scan_t)
    for ours, driven in zip(log.scans, simulated.scans, strict=True):
        np.testing.assert_array_equal(ours.hit, driven.hit)
        np.testing.assert_array_equal(ours.ranges[ours.hit], driven.ranges[driven.hit])
        np.testing.assert_array_equal(ours.intensities, driven.intensities)
        np.testing.assert_allclose(ours.odometry, driven.odometry, atol=1e-12)
        np.testing.assert_allclose(ours.T_robot_sensor, MOUNT, atol=1e-6)


@pytest.mark.slow
def test_one_process_drives_several_robots_each_with_a_history_of_its_own(fleet, ros):
    session = ros[1]
    made = {"tb1": drive(1), "tb2": drive(2)}
    ones = [RosDrive(session, name, d.log, MOUNT) for name, d in made.items()]
    joins(fleet, "r1,r2", "--pattern", "tb1,*2")
    playing = [threading.Thread(target=one.play, args=(8.0,)) for one in ones]
    for thread in playing:
        thread.start()
    for thread in playing:
        thread.join()
    for one in ones:
        one.node.say(f"/{one.space}/scan", b"")
    for name in ("r1", "r2"):
        fleet.hears("r1,r2", f"{name}: refused: malformed")
    fleet.interrupt("r1,r2")
    assert fleet.wait("r1,r2") == 0, fleet.said("r1,r2")
    for name, d in zip(("r1", "r2"), made.values(), strict=True):
        log, end = record(fleet.folder / f"mapweave-live/team-{name}.sqlite", name)
        same_scans(log, d.log)
        assert isinstance(end, Closed)
        assert f"{name}: {end.seq + 1} messages" in fleet.said("r1,r2")


def ended(fleet, one):
    """The log of robot r1, which is interrupted once all that `one` said before was heard."""
    one.node.say("/tb1/scan", b"")
    fleet.hears("r1", "refused: malformed")
    fleet.interrupt("r1")
    assert fleet.wait("r1") == 0, fleet.said("r1")
    log, end = record(fleet.folder / "mapweave-live/team-r1.sqlite", "r1")
    assert isinstance(end, Closed)
    return log


@pytest.mark.slow
def test_a_robot_with_a_receiver_tells_its_fixes_and_its_map_lies_where_that_of_its_drive_does(fleet, ros):
    world = CorridorConfig(distance=8.0, drive=DriveConfig(sensor_pose=MOUNT))
    simulated = mapweave.simulate_laser(world=world, fixes=0.1, seed=1).log
    driven = replace(simulated, fixes=replace(simulated.fixes, antenna=np.array([-0.3, 0.1])))
    one = RosDrive(ros[1], "tb1", driven, MOUNT)
    joins(fleet, "r1")
    fleet.hears("r1", "hears /tb1/scan, odometry from /tb1/odom, position fixes from /tb1/fix")
    one.play(8.0)
    one.node.say("/tb1/fix", fix(2000.0, "tb1/gps", (35.0, 200.0, 0.0)))
    log = ended(fleet, one)
    same_scans(log, driven)
    np.testing.assert_allclose(log.odometry.t, driven.odometry.t, atol=1e-9)
    for column in ("t", "place", "cov"):
        np.testing.assert_allclose(getattr(log.fixes, column), getattr(driven.fixes, column), rtol=1e-12)
    np.testing.assert_allclose(log.fixes.antenna, [-0.3, 0.1], atol=1e-9)
    assert log.fixes.dropped == {"fix whose latitude or longitude cannot be": 1}
    ours, theirs = (map_logs([each], MapOptions()).components[0].georeference for each in (log, driven))
    (ours,), (theirs,) = (each.tracks.values() for each in (ours, theirs))
    np.testing.assert_array_equal(ours.t, theirs.t)
    np.testing.assert_allclose(ours.pose, theirs.pose, atol=2e-3)


@pytest.mark.slow
def test_a_robot_without_wheels_tells_headings_by_its_gyroscope(fleet, ros):
    truth, rate = truth_of(20.0, 1.0)
    t, scans = scans_of(truth)
    log = LaserLog("robot1", "spin", t, tuple(scans), replace(truth, pose=0.0 * truth.pose))
    one = Spinning(ros[1], "tb1", log, MOUNT, by_tf=True)
    one.rate = rate
    joins(fleet, "r1")
    fleet.hears("r1", "hears /tb1/scan, odometry from tf, if that tells any, turns of /tb1/imu without it")
    wait_for(lambda: one.node.is_heard("/tb1/imu"))
    one.play(4.0)
    heard = ended(fleet, one)
    assert heard.odometry_from == "none"
    assert "imu-turns" in {found.code for found in heard.findings}
    heading = np.array([np.nan if scan.heading is None else scan.heading for scan in heard.scans])
    true = np.diff(np.unwrap(se2.interpolate(heard.scan_t, truth.t, truth.pose)[:, 2]))
    known = np.isfinite(np.diff(heading))
    assert known.sum() > 0.7 * len(true)
    assert np.abs(np.diff(heading) - true)[known].max() < 0.02


class Spinning(RosDrive):
    """A robot whose IMU tells its turns in place of odometry."""

    def __init__(self, session, space, log, mount, *, by_tf):
        super().__init__(session, space, log, mount, by_tf=by_tf)
        self.node.publisher(f"/{space}/imu", "sensor_msgs/msg/Imu", SENSOR)

    def tell(self, t, what, k):
        if what == "odometry":
            self.node.say(f"/{self.space}/imu", imu(t, f"{self.space}/imu", (0.0, 0.0, self.rate[k])))
        else:
            super().tell(t, what, k)


@pytest.mark.slow
@pytest.mark.parametrize("type_hash", [None, ""])  # since ROS 2 Iron, and before it
def test_a_robot_of_any_middleware_joins_through_its_bridge_and_gets_map_and_transforms_back(fleet, ros, type_hash):
    session = ros[1]
    made = drive(1)
    one = RosDrive(session, "tb1", made.log, MOUNT, type_hash=type_hash, node=BridgedNode)
    joins(fleet, "r1")
    fleet.hears("r1", "hears /tb1/scan through zenoh-bridge-ros2dds, odometry from /tb1/odom")
    shown = BridgedNode(session, "rviz")
    shown.hear("/tb1/pose", POSE, type_hash=type_hash)
    shown.hear("/tf", TF, type_hash=type_hash)
    one.play(4.0)
    wait_for(lambda: shown.heard["/tb1/pose"] and shown.heard["/tf"])
    shown.hear("/tb1/map", GRID, latched=True, type_hash=type_hash)
    wait_for(lambda: shown.heard["/tb1/map"])
    assert read_grid(shown.heard["/tb1/map"][-1][0])[0] == "tb1/map"
    assert {attachment for told in shown.heard.values() for _, attachment in told} == {None}
    ours = [token.split("/")[3:6] for token in shown.graph() if "§map/" in token]
    assert ["MP", "tb1§map", "nav_msgs§msg§OccupancyGrid"] in ours
    one.node.say("/tb1/scan", b"")
    fleet.hears("r1", "refused: malformed")
    fleet.interrupt("r1")
    assert fleet.wait("r1") == 0, fleet.said("r1")
    log, end = record(fleet.folder / "mapweave-live/team-r1.sqlite", "r1")
    same_scans(log, made.log)
    assert isinstance(end, Closed)


def test_where_one_of_several_robots_cannot_be_driven_the_others_end_too(ros, tmp_path, monkeypatch):
    at, session = ros
    monkeypatch.chdir(tmp_path)
    log = drive(1).log
    ones = [RosDrive(session, name, log, MOUNT) for name in ("tb1", "tb2")]
    network = Network(connect=(at,))
    with pytest.raises(UsageError, match="--pattern: which robot is r2\\? There are tb1, tb2"):
        live_robots(["r1", "r2"], ["tb1", "tb*"], network=network, say=lambda _: None)
    for arguments, words in (
        ((["r1", "r1"],), "--name: r1 comes twice"),
        ((["r1", "r2"], ["tb1"]), "--pattern: expected one a robot, 2, found 1"),
    ):
        with pytest.raises(UsageError, match=words):
            live_robots(*arguments, network=network)
    with pytest.raises(UsageError, match="--listen: of one robot"):
        live_robots(["r1", "r2"], network=Network(listen=(at,)))
    assert len(ones) == 2


@pytest.mark.slow
def test_two_ros_robots_make_one_map_and_the_graph_gets_maps_poses_and_transforms_back(fleet, ros):
    at, session = ros
    made = {"tb1": drive(1), "tb2": drive(2)}
    ones = {name: RosDrive(session, name, d.log, MOUNT, by_tf=name == "tb2") for name, d in made.items()}
    rviz = Node(session, "rviz")
    rviz.hear("/tb1/pose", POSE)
    rviz.hear("/tf", TF)
    fleet.start("map", "map", "--out", "out-map", "--robots", "r1,r2", "--connect", at)
    fleet.hears("map", "heard so far")
    joins(fleet, "r1", "--pattern", "tb1", "--team-map", "--goals")
    joins(fleet, "r2", "--pattern", "*2")
    fleet.hears("r1", "hears /tb1/scan, odometry from /tb1/odom")
    fleet.hears("r2", "hears /tb2/scan, odometry from tf")
    playing = [threading.Thread(target=one.play, args=(1.0,)) for one in ones.values()]
    for thread in playing:
        thread.start()
    for thread in playing:
        thread.join()
    last = made["tb1"].log.scan_t[-1]
    wait_for(lambda: rviz.heard["/tb1/pose"] and read_pose(rviz.heard["/tb1/pose"][-1][0])[0] > last - 1.5)
    rviz.hear("/tb1/map", GRID, latched=True)  # told before: kept for those that come late
    wait_for(lambda: rviz.heard["/tb1/map"])
    wait_for(lambda: {edge[2] for edge in shared_edges(rviz)} == {"tb1/map", "tb2/map"})
    _hears_of_the_team(rviz, at)
    tokens = rviz.graph()
    for name in ("r1", "r2"):
        fleet.interrupt(name)
    for name in ("r1", "r2", "map"):
        assert fleet.wait(name) == 0, fleet.said(name)
        assert "Traceback" not in fleet.said(name)
    for name, d in zip(("r1", "r2"), made.values(), strict=True):
        assert "1 map processes have all of them" in fleet.said(name)
        log, end = record(fleet.folder / f"mapweave-live/team-{name}.sqlite", name)
        same_scans(log, d.log)
        assert isinstance(end, Closed)
        assert log.odometry_from == ("tf" if name == "r2" else "poses")
    _the_map_is_made_of_the_histories(fleet, made)
    _is_in_the_graph(tokens)
    _shows_poses_and_transforms(rviz, made["tb1"], fleet.folder / "mapweave-live/team-r1.sqlite")


def _hears_of_the_team(rviz, at):
    """The team's map in its frame, kept for those that come late, and a goal once, however often it is told."""
    rviz.hear("/tb1/team_map", GRID, latched=True)
    rviz.hear("/tb1/goal_pose", GOAL)
    wait_for(lambda: rviz.heard["/tb1/team_map"])
    frame, resolution, _, _, cells = read_grid(rviz.heard["/tb1/team_map"][-1][0])
    assert frame.startswith("team_map")
    assert round(resolution, 6) == 0.1
    assert set(cells) == {-1, 0, 100}
    topics = Topics("team")
    with transport_session(told_on(Network(connect=(at,)))) as opened:
        for number in (1, 1, 1, 2, 2, 2):
            where = {"component": 1, "number": number, "pose": (float(number), -0.5, 0.25)}
            put(opened, topics.goal("r1", "planner"), encode(GoalMessage(map="planner", of="map", robot="r1", **where)))
            time.sleep(0.5)
        wait_for(lambda: len(rviz.heard["/tb1/goal_pose"]) == 2)
    goals = [read_goal(data) for data, _ in rviz.heard["/tb1/goal_pose"]]
    assert [(frame, *np.round(pose, 6)) for _, frame, pose in goals] == [
        ("team_map", 1.0, -0.5, 0.25),
        ("team_map", 2.0, -0.5, 0.25),
    ]


def _the_map_is_made_of_the_histories(fleet, made):
    """What the map process used is what the robots keep, to the byte; its result holds a pose at every scan."""
    with Store(fleet.folder / "out-map.sqlite", "a map of team team") as heard:
        for name in ("r1", "r2"):
            path = fleet.folder / f"mapweave-live/team-{name}.sqlite"
            with Store(path, f"robot {name} of team team") as own:
                assert heard.get(name, 0, 1 << 30) == own.get(name, 0, 1 << 30)
    for number, d in enumerate(made.values(), 1):
        (path,) = (fleet.folder / "out-map").glob(f"state/robot{number}.npz")
        with np.load(path) as state:
            assert set(d.log.scan_t.tolist()) <= set(state["t"].tolist())
            assert len(state["scan_pose"]) == len(d.log.scans)


def _is_in_the_graph(tokens):
    mine = [token for token in tokens if "/mapweave_r1" in token]
    assert sum("/NN/%/%tb1/mapweave_r1" in token for token in mine) == 1
    for kind, topic, ros_type in (
        ("MP", "%tb1%map", GRID),
        ("MP", "%tb1%pose", POSE),
        ("MP", "%tf", TF),
        ("MS", "%tb1%scan", SCAN),
    ):
        package, _, word = ros_type.split("/")
        part = f"/mapweave_r1/{topic}/{package}::msg::dds_::{word}_/{HASHES[ros_type]}/"
        assert any(f"/{kind}/" in token and part in token for token in mine), part


def estimated(path, name, t):
    """The pose that the estimator of `map` has at `t`, from the scans of the robot's history."""
    with Store(path, f"robot {name} of team team") as store:
        kept = [decode(payload) for _, payload in store.get(name, 0, 1 << 30)]
    robot = LaserRobot(kept[0], LaserConfig(method="graph"))
    for message in kept[1:]:
        robot.add(message)
        if robot.t == t:
            return np.array(robot.status()[0])
    raise AssertionError(t)


def shared_edges(rviz):
    """What /tf said of frames in the team's map."""
    return [one for data, _ in rviz.heard["/tf"] for one in read_transforms(data) if one[1].startswith("team_map")]


def _shows_poses_and_transforms(rviz, made, store):
    t, frame, pose, cov = read_pose(rviz.heard["/tb1/pose"][-1][0])
    assert frame == "tb1/map"
    again = estimated(store, "r1", t)
    np.testing.assert_allclose(np.array(pose), again, atol=1e-9)
    begin, end = np.searchsorted(made.truth.t, [made.log.scan_t[0], t])
    np.testing.assert_allclose(again, se2.between(made.truth.pose[begin], made.truth.pose[end]), atol=0.25)
    assert cov[0] > 0 < cov[35]
    edges = [one for data, _ in rviz.heard["/tf"] for one in read_transforms(data) if one[1] == "tb1/map"]
    _, _, child, place = edges[-1]
    assert child == "tb1/odom"
    wheels = made.log.odometry.pose[int(np.searchsorted(made.log.odometry.t, t))]
    np.testing.assert_allclose(se2.compose(np.array(place), wheels), np.array(pose), atol=0.05)
    frame, resolution, (width, height), _, cells = read_grid(rviz.heard["/tb1/map"][-1][0])
    assert (frame, round(resolution, 6)) == ("tb1/map", 0.1)
    assert set(cells) == {-1, 0, 100}
    assert width * height == len(cells) > 500
    sequence = [int.from_bytes(attached[:8], "little") for _, attached in rviz.heard["/tb1/pose"]]
    assert sequence == list(range(1, len(sequence) + 1))


def follows(name, at, folder, stop, said, *, listen=False, **options):
    """A robot in a thread of this process, as `live_robot` runs it."""
    arguments = {
        "ros": RosOptions(**options),
        "network": Network(listen=(at,)) if listen else Network(connect=(at,)),
        "history": folder / f"{name}.sqlite",
        "stop": stop,
        "say": said.append,
        "period": 0.5,
    }
    thread = threading.Thread(target=live_robot, args=(name, "ros2"), kwargs=arguments)
    thread.start()
    return thread


@pytest.mark.slow
def test_nonsense_in_the_graph_is_told_in_a_line_each_and_the_drive_is_as_without(ros, tmp_path):
    at, session = ros
    made = drive(3)
    other = Node(session, "other", "/tb9")
    other.publisher("/tb9/scan", SCAN, type_hash="RIHS01_" + 64 * "0")
    held = session.liveliness().declare_token("@ros2_lv/0/not/a/token")
    one = RosDrive(session, "tb1", made.log, MOUNT)
    stop, said = threading.Event(), []
    thread = follows("r1", at, tmp_path, stop, said)
    wait_for(lambda: any("hears /tb1/scan" in words for words in said))
    one.wait_for_a_listener()
    one.node.say("/tb1/scan", b"\x00\x01\x00\x00nonsense")
    one.node.say("/tb1/scan", bytes(2 << 20))
    one.node.say("/tb1/odom", b"")
    one.node.out["/tb1/scan"].put(one.scan(0), attachment=b"short")
    one.node.out["/tb1/scan"].put(one.scan(0))
    one.node.say("/tb1/scan", scan(999.5, "camera", [1.0, 2.0], 0.0, 0.1, 10.0))
    one.play(4.0)
    one.node.counts["/tb1/scan"] -= 1
    one.node.say("/tb1/scan", one.scan(0))  # told twice
    one.node.say("/tb1/scan", scan(500.0, "tb1/laser", [1.0, 2.0], 0.0, 0.1, 10.0))  # the clock was set back
    wait_for(lambda: any("refused: clock" in words for words in said))
    stop.set()
    thread.join(60)
    log, _ = record(tmp_path / "r1.sqlite", "r1")
    same_scans(log, made.log)
    told = "\n".join(said)
    for words in (
        "refused: malformed: no sensor_msgs/msg/LaserScan in 12 bytes",
        "refused: oversized: sensor_msgs/msg/LaserScan of 2097152 bytes",
        "refused: attachment: 5 bytes that are none of rmw_zenoh's",
        "refused: frame: a scan in 'camera', which no transform places on",
        "refused: clock: a scan 510 s before the last one",
        "refused: token: no token of a ROS graph: @ros2_lv/0/not/a/token",
        "refused: hash: /tb9/scan is sensor_msgs/msg/LaserScan of another definition",
        "refused 2 attachment, 1 clock, 1 doubled, 1 frame, 2 malformed, 1 oversized",
    ):
        assert told.count(words) == 1, (words, told)
    held.undeclare()


@pytest.mark.slow
def test_a_robot_started_again_goes_on_where_its_history_ends(ros, tmp_path):
    at, session = ros
    made = drive(4)
    one = RosDrive(session, "tb1", made.log, MOUNT)
    stop, said = threading.Event(), []
    rows = sorted(
        [(t, "odometry", k) for k, t in enumerate(made.log.odometry.t.tolist())]
        + [(t, "scan", k) for k, t in enumerate(made.log.scan_t.tolist())]
    )
    thread = follows("r1", at, tmp_path, stop, said)
    wait_for(lambda: any("hears /tb1/scan" in words for words in said))
    one.wait_for_a_listener()
    for row in rows:
        one.tell(*row)
        time.sleep(0.005)
    all_heard(one, said)
    stop.set()
    thread.join(60)
    with pytest.raises(UsageError, match="this drive has ended; --fresh begins a new one"):
        live_robot(
            "r1",
            "ros2",
            network=Network(connect=(at,)),
            history=tmp_path / "r1.sqlite",
            period=0.5,
            say=said.append,
            stop=threading.Event(),
        )
    _cut_off(tmp_path / "r1.sqlite", 5)
    again = threading.Event()
    thread = follows("r1", at, tmp_path, again, said)
    wait_for(lambda: sum("hears /tb1/scan" in words for words in said) == 2)
    one.wait_for_a_listener()
    for row in rows:
        one.tell(*row)
        time.sleep(0.005)
    all_heard(one, said, 2)
    again.set()
    thread.join(60)
    log, end = record(tmp_path / "r1.sqlite", "r1")
    same_scans(log, made.log)
    assert isinstance(end, Closed)
    assert "r1: goes on after 5 messages of its history" in said


def _cut_off(path, last):
    """As if the process had been killed after message `last`."""
    with Store(path, "robot r1 of team team") as store:
        kept = store.get("r1", 0, last - 1)
        run, period, sensor = store.about("run"), store.about("period"), store.about("sensor")
        store.clear()
        for name, value in (("run", run), ("period", period), ("sensor", sensor)):
            store.set_about(name, value)
        store.put([("r1", seq, payload) for seq, payload in kept])


@pytest.mark.slow
def test_with_listen_it_is_the_router_and_what_others_publish_as_map_stays_theirs(tmp_path):
    at = free_endpoint()
    stop, said = threading.Event(), []
    thread = follows("r-1", at, tmp_path, stop, said, listen=True, domain=7)
    wait_for(lambda: said)
    with open_session(at) as session, open_session(at) as screen:
        other = Node(session, "slam", "/tb1", 7)
        other.publisher("/tb1/map", GRID)
        rviz = Node(screen, "rviz", domain=7)
        rviz.hear("/tb1/mapweave/map", GRID, latched=True)
        rviz.hear("/tb1/map", GRID)
        rviz.hear("/tf", TF)
        made = drive(5)
        one = RosDrive(session, "tb1", made.log, MOUNT, domain=7)
        wait_for(lambda: any("hears /tb1/scan" in words for words in said))
        one.play(4.0)
        wait_for(lambda: rviz.heard["/tb1/mapweave/map"])
        all_heard(one, said)
        tokens = rviz.graph()
        stop.set()
        thread.join(60)
    words = "/tb1/slam publishes /tb1/map: ours is /tb1/mapweave/map, and no transform is told"
    assert f"r-1: {words}" in said
    assert rviz.heard["/tb1/map"] == rviz.heard["/tf"] == []
    assert any("/NN/%/%tb1/mapweave_r_1" in one for one in tokens)
    same_scans(record(tmp_path / "r-1.sqlite", "r-1")[0], made.log)


@pytest.mark.slow
def test_a_graph_without_type_hashes_is_answered_without_them(ros, tmp_path):
    at, session = ros
    none = "TypeHashNotSupported"
    made = drive(6)
    rviz = Node(session, "rviz")
    rviz.hear("/tb1/map", GRID, latched=True, type_hash=none)
    one = RosDrive(session, "tb1", made.log, MOUNT, by_tf=True, type_hash=none)
    stop, said = threading.Event(), []
    thread = follows("r1", free_endpoint(), tmp_path, stop, said, graph=at)  # the team's network is another, and away
    wait_for(lambda: any("hears /tb1/scan" in words for words in said))
    one.play(2.0)
    wait_for(lambda: rviz.heard["/tb1/map"])
    all_heard(one, said)
    stop.set()
    thread.join(60)
    same_scans(record(tmp_path / "r1.sqlite", "r1")[0], made.log)


@pytest.mark.slow
def test_when_the_router_goes_and_comes_back_the_drive_goes_on(tmp_path):
    at = free_endpoint()
    router = open_session(at, "router")
    made = drive(7)
    stop, said = threading.Event(), []
    with open_session(at) as session:
        one = RosDrive(session, "tb1", made.log, MOUNT)
        thread = follows("r1", at, tmp_path, stop, said)
        wait_for(lambda: any("hears /tb1/scan" in words for words in said))
        one.wait_for_a_listener()
        one.tell(999.5, "odometry", 0)
        router.close()
        wait_for(lambda: not one.node.is_heard("/tb1/scan"))
        router = open_session(at, "router")
        one.play(4.0)
        all_heard(one, said)
        stop.set()
        thread.join(60)
    router.close()
    same_scans(record(tmp_path / "r1.sqlite", "r1")[0], made.log)


def test_several_robots_that_could_be_meant_are_listed(ros, tmp_path):
    at, session = ros
    log = drive(1).log
    ones = [RosDrive(session, name, log, MOUNT) for name in ("tb1", "tb2")]
    with pytest.raises(UsageError, match="--pattern: which robot is r1\\? There are tb1, tb2"):
        live_robot("r1", "ros2", network=Network(connect=(at,)), history=tmp_path / "a.sqlite", say=lambda _: None)
    assert len(ones) == 2


def test_where_no_router_is_it_waits_and_says_so(tmp_path):
    stop, said = threading.Event(), []
    thread = follows("r1", free_endpoint(), tmp_path, stop, said)
    wait_for(lambda: any("waits for tcp/127.0.0.1" in words for words in said))
    stop.set()
    thread.join(20)
    assert not thread.is_alive()
    assert len(said) == 1


def test_what_cannot_be_is_refused_at_once(tmp_path):
    for options, words in (
        ({"ros": RosOptions(domain=233)}, "--domain: expected 0 to 232, found 233"),
        ({"ros": RosOptions(sensor_pose=(0.0, 0.0, float("nan")))}, "--sensor-pose: expected finite numbers"),
        ({"rate": 2.0}, "neither --robot nor --rate"),
        ({"robot": "2"}, "neither --robot nor --rate"),
        ({"network": Network(tls=tmp_path)}, "--tls: ROS speaks under names no certificate has"),
    ):
        with pytest.raises(UsageError, match=words):
            live_robot("r1", "ros2", history=tmp_path / "a.sqlite", say=lambda _: None, **options)
    with pytest.raises(UsageError, match="of --source ros2 alone"):
        live_robot("r1", "sim:office", ros=RosOptions(), history=tmp_path / "a.sqlite")
