"""The network is late or breaks off, clocks are apart, disks full, processes die: the map is the same."""

import signal
import subprocess
import threading
import time

import numpy as np
import pytest

from mapweave.api.live import live_map, live_robot
from mapweave.cli import _run
from mapweave.live import robot as robot_module
from mapweave.live.transport import Network

from .bad_network import LossyRelay, Relay, ip, killed_at_random, lossy, two_namespaces
from .processes import free_endpoint, same_result


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "lease"), [(0.9, "3"), pytest.param(2.0, "10", marks=pytest.mark.long)])
def test_late_and_cut_off_twice_the_map_is_the_same(fleet, direct, delay, lease):
    relay = Relay(fleet.at, delay)
    fleet.more = ["--lease", lease]
    fleet.map()
    fleet.hears("map", "heard so far")
    fleet.robot("r1", rate="6")
    fleet.robot("r2", "--connect", relay.at, rate="6")
    fleet.hears("map", "r2: joined")
    relay.cut(1.0)
    time.sleep(1.0)
    relay.cut(4.0)  # longer than the lease
    assert fleet.wait("map") == 0, fleet.said("map")
    relay.close()
    assert "r2: is gone" in fleet.said("map")
    same_result(direct, fleet.folder / "out-map")


@pytest.mark.slow
def test_a_line_that_loses_a_fifth_of_its_packets_and_breaks_off_at_random_changes_nothing(fleet, direct):
    relays = [LossyRelay(fleet.at, delay=0.5, loss=0.2, seed=seed) for seed in (1, 2)]
    stop = threading.Event()
    breaking = [threading.Thread(target=relay.break_off, args=(stop, 4.0, 3.0)) for relay in relays]
    fleet.map()
    fleet.hears("map", "heard so far")
    for name, relay in zip(("r1", "r2"), relays, strict=True):
        fleet.robot(name, "--connect", relay.at, rate="4")
    fleet.hears("map", "r1: joined")
    for thread in breaking:
        thread.start()
    time.sleep(12.0)
    stop.set()
    assert fleet.wait("map") == 0, fleet.said("map")
    for thread, relay in zip(breaking, relays, strict=True):
        thread.join()
        relay.close()
        assert relay.cuts >= 1
        assert 0.1 < relay.lost / (relay.passed + relay.lost) < 0.3
    same_result(direct, fleet.folder / "out-map")


@pytest.mark.drawn  # of processes that save whole figures
@pytest.mark.slow
@pytest.mark.parametrize("bad", ["cut", "lossy"])
def test_in_namespaces_whose_link_goes_down_or_loses_packets_the_map_is_the_same(fleet, direct, bad):
    with two_namespaces() as names:
        if names is None:
            pytest.skip("network namespaces cannot be made here: links that go down were not tried")
        a, b = names
        if bad == "lossy" and not (lossy(a) and lossy(b)):
            pytest.skip("this kernel has no netem: 20 % loss was not tried")
        fleet.at = fleet.at.replace("127.0.0.1", "10.77.0.1")
        fleet.prefix = {"r2": ["ip", "netns", "exec", b], "map": ["ip", "netns", "exec", a]}
        fleet.prefix["r1"] = fleet.prefix["map"]
        fleet.map("--insecure")
        fleet.hears("map", "heard so far")
        fleet.robot("r1", rate="10")
        fleet.robot("r2", rate="10")
        fleet.hears("map", "r2: joined")
        ip("-n", b, "link", "set", "cable", "down")
        fleet.hears("map", "r2: is gone")
        ip("-n", b, "link", "set", "cable", "up")
        assert fleet.wait("map") == 0, fleet.said("map")
    same_result(direct, fleet.folder / "out-map", but=("metrics.json", "report.html", "result.npz"))  # they tell that


@pytest.mark.slow
def test_a_clock_five_seconds_ahead_is_measured_and_told(tmp_path, source):
    at = (free_endpoint(),)
    said, stop = [], threading.Event()
    robots = [
        threading.Thread(
            target=live_robot,
            args=(name, source),
            kwargs={
                "rate": 8.0, "network": Network(connect=at), "history": tmp_path / name, "stop": stop,
                "say": lambda _: None, "wall": lambda ahead=ahead: time.time() + ahead,
            },
        )
        for name, ahead in (("r1", 5.0), ("r2", 0.0))
    ]  # fmt: skip
    for robot in robots:
        robot.start()
    try:
        live_map(tmp_path / "out", robots=["r1", "r2"], network=Network(listen=at), say=said.append)
    finally:
        stop.set()
        for robot in robots:
            robot.join()
    told = [line for line in said if "its clock" in line]
    assert len(told) == 1
    assert told[0].startswith("r1: its clock is 5.0 s ahead (within 0.0")


@pytest.mark.slow
def test_a_robot_on_a_full_disk_drives_on_and_tells_nothing_it_could_lose(fleet):
    """A file may not grow beyond 60 kB here, which the disk of a robot does not either once it is full."""
    fleet.prefix = {"r1": ["bash", "-c", 'ulimit -f 60; PYTHONDONTWRITEBYTECODE=1 exec "$@"', "bash"]}
    fleet.robot("r1", rate="inf")
    fleet.hears("r1", "driving on, telling nothing until it can be kept")
    time.sleep(1.5)
    fleet.interrupt("r1")
    assert fleet.wait("r1") == 0, fleet.said("r1")
    assert fleet.said("r1").count("driving on") == 1
    assert "Traceback" not in fleet.said("r1")


@pytest.mark.slow
def test_a_map_on_a_full_disk_keeps_what_it_hears_in_memory(fleet, direct, tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=48k", "none", str(small)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:  # noqa: S603
        pytest.skip("a small disk cannot be mounted here: a map process on a full disk was not tried")
    try:
        fleet.map("--store", str(small / "map.sqlite"))
        fleet.robot("r1", rate="inf")
        fleet.robot("r2", rate="inf")
        assert fleet.wait("map") == 0, fleet.said("map")
    finally:
        fleet.end()
        subprocess.run(["umount", str(small)], check=True)  # noqa: S603, S607
    assert "what comes is kept in memory until it can be written" in fleet.said("map")
    same_result(direct, fleet.folder / "out-map")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["robot", "--name", "r1", "--source", "nowhere"], "--source nowhere: no such file or folder"),
        (["robot", "--name", "a/b", "--source", "nowhere"], "--name: expected letters"),
        (["robot", "--name", "r1", "--source", "{source}", "--rate", "0"], "--rate: expected a number above 0"),
        (["robot", "--name", "r9", "--source", "{source}"], "--robot: which robot is r9?"),
        (["robot", "--name", "r1", "--source", "{source}", "--connect", "host"], "--connect: expected protocol/host"),
        (["robot", "--name", "r1", "--source", "{source}", "--tls", "here"], "--tls here: expected authority.pem"),
        (["map", "--out", "out", "--robots", ","], "--robots: expected names as r1,r2"),
        (["map", "--out", "out", "--every", "nan"], "--every: expected seconds above 0"),
        (["map", "--out", "{source}/Barcodes.dat"], "exists and is not a directory"),
        (["view", "--port", "99999"], "--port 99999: expected a number from 0 to 65535"),
        (["view", "--lease", "0"], "--lease: expected 0.5 to 600 seconds, found 0"),
        (["demo", "--robots", "0"], "--robots: expected 1 to 20, found 0"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(tmp_path, monkeypatch, capsys, source, words, told):
    monkeypatch.chdir(tmp_path)
    assert _run(["live", *(word.format(source=source) for word in words)]) in {1, 2}
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


@pytest.mark.slow
def test_a_second_robot_of_one_name_is_refused_at_once(fleet):
    fleet.robot("r1", "--listen", fleet.at, "--connect", fleet.at, rate="1")
    fleet.hears("r1", "history in")
    fleet.start(
        "twin",
        "robot",
        "--name",
        "r1",
        "--source",
        str(fleet.source),
        "--history",
        "twin.sqlite",
        "--connect",
        fleet.at,
    )
    assert fleet.wait("twin") == 2
    assert "a robot of that name is in team team already" in fleet.said("twin")


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [8.0, pytest.param(30.0, marks=pytest.mark.long)])
def test_a_map_process_that_stands_still_for_a_while_changes_nothing(fleet, direct, seconds):
    fleet.map()
    fleet.robot("r1", rate="6")
    fleet.robot("r2", rate="6")
    fleet.hears("map", "r2: joined")
    fleet.running["map"].send_signal(signal.SIGSTOP)
    time.sleep(seconds)  # longer than the lease: robots take it for gone
    fleet.running["map"].send_signal(signal.SIGCONT)
    assert fleet.wait("map") == 0, fleet.said("map")
    same_result(direct, fleet.folder / "out-map")


class Jumping:
    """A clock that is set by up to an hour, to and fro, whenever it is asked."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def __call__(self):
        return time.time() + float(self.rng.uniform(-3600.0, 3600.0))


class Mixing:
    """What a robot says goes out twice, late and in another order, or not at all, by the draws of `seed`."""

    def __init__(self, put, seed):
        self.put, self.rng, self.lock = put, np.random.default_rng(seed), threading.Lock()
        self.held, self.counts = [], {"lost": 0, "twice": 0, "late": 0}

    def __call__(self, where, key, payload):
        with self.lock:
            draw = self.rng.random()
            if draw < 0.2:
                self.counts["lost"] += 1
                return
            out = [(where, key, payload)]
            if draw < 0.4:
                self.counts["twice"] += 1
                out *= 2
            if draw > 0.7:
                self.counts["late"] += 1
                self.held += out
                out = []
            if len(self.held) > 10:
                self.rng.shuffle(self.held)
                out, self.held = [*out, *self.held], []
        for one in out:
            self.put(*one)


@pytest.mark.slow
def test_messages_lost_told_twice_and_in_any_order_by_jumping_clocks_give_the_same_map(
    tmp_path, source, direct, monkeypatch
):
    mixing = Mixing(robot_module.put, 5)
    monkeypatch.setattr(robot_module, "put", mixing)
    at, stop = (free_endpoint(),), threading.Event()
    robots = [
        threading.Thread(
            target=live_robot,
            args=(name, source),
            kwargs={
                "rate": 8.0, "network": Network(connect=at), "history": tmp_path / name, "stop": stop,
                "say": lambda _: None, "wall": Jumping(k),
            },
        )
        for k, name in enumerate(("r1", "r2"))
    ]  # fmt: skip
    for robot in robots:
        robot.start()
    try:
        hears = {"network": Network(listen=at), "say": lambda _: None, "wall": Jumping(9)}
        live_map(tmp_path / "out", robots=["r1", "r2"], **hears)
    finally:
        stop.set()
        for robot in robots:
            robot.join()
    assert min(mixing.counts.values()) > 10
    same_result(direct, tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize(("kills", "rate"), [(2, "4"), pytest.param(50, "0.15", marks=pytest.mark.long)])
def test_every_process_killed_at_random_moments_again_and_again_the_map_is_the_same(fleet, direct, kills, rate):
    start = {
        "map": fleet.map,
        "view": lambda: fleet.start("view", "view", "--port", "0", "--connect", fleet.at),
        "r1": lambda: fleet.robot("r1", rate=rate),
        "r2": lambda: fleet.robot("r2", rate=rate),
    }
    killed = killed_at_random(fleet, start, kills, np.random.default_rng(5))
    assert fleet.wait("map", 400) == 0, fleet.said("map")
    assert set(killed) == set(start)
    assert not any("Traceback" in fleet.said(name) for name in start)
    same_result(direct, fleet.folder / "out-map")
