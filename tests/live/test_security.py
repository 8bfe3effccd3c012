"""Who may speak: certificates, the access list, and what is refused and counted."""

import datetime as dt
import json
import math
import re
import shutil
import time
import warnings
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest

from mapweave.api.live import INSECURE, live_keys, live_map, live_robot
from mapweave.api.live_laser import LiveLaser
from mapweave.api.simulate import simulate_landmarks
from mapweave.cli import _run
from mapweave.cli.terminal import FORGED, STRANGER, Denials, plain, reason_of
from mapweave.core.errors import DataError, UsageError
from mapweave.live import transport
from mapweave.live.credentials import Authority, _authority, expect_heard, issue, make_team, tls_settings
from mapweave.live.messages import Topics, encode
from mapweave.live.robot import RobotProcess
from mapweave.live.store import Store
from mapweave.live.transport import Network, ask, endpoints, is_open, put, session, there_is

from .processes import Fleet, free_endpoint
from .teams import messages, team

NOW = dt.datetime.now(dt.UTC)
TOPICS = Topics("team")


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    make_team(folder / "team", "team", ["r1", "r2"], ["map"], 30, NOW)
    make_team(folder / "strangers", "team", ["r1"], ["map"], 30, NOW)
    return folder


def heard_from(keys, home, words, unchecked=None):
    """What a map process hears of a process with the certificate in `home`.

    One of the team is waited for until the last of `words` is heard, others have a second or two.
    """
    at = free_endpoint().replace("tcp/", "tls/")
    heard, there = [], []
    network = Network(connect=(at,), tls=home)
    if unchecked is not None:
        network = Network(connect=(at,), extra=unchecked)
    with session(Network(listen=(at,), tls=keys / "team" / "map")) as hub:
        held = [
            hub.declare_subscriber(TOPICS.log(), lambda s: heard.append((str(s.key_expr), s.payload.to_string()))),
            hub.liveliness().declare_subscriber(TOPICS.alive(), lambda s: there.append(str(s.key_expr))),
        ]
        with session(network) as robot:
            tokens = [robot.liveliness().declare_token(TOPICS.alive(name)) for name in ("r1", "r2")]
            member = home.parent.name == "team" and unchecked is None
            end = time.monotonic() + (60 if member else 1.5)
            while not there and time.monotonic() < end:
                time.sleep(0.05)
            for key, word in words:
                put(robot, key, word.encode())
            end = time.monotonic() + (60 if member else 0.5)
            while not (member and heard and heard[-1][1] == words[-1][1]) and time.monotonic() < end:
                time.sleep(0.05)
            del tokens, held
    return heard, there


WORDS = [(TOPICS.log("r1"), "own"), (TOPICS.log("r2"), "forged"), ("mapweave/team/@map/map/state", "forged too")]
WORDS += [(TOPICS.log("r1"), "the end")]


def test_a_robot_is_heard_under_its_own_name_alone(keys):
    heard, there = heard_from(keys, keys / "team" / "r1", WORDS)
    assert heard == [(TOPICS.log("r1"), "own"), (TOPICS.log("r1"), "the end")]
    assert set(there) == {TOPICS.alive("r1")}


def test_a_stranger_is_not_heard_whatever_it_calls_itself(keys):
    for name in ("r1", "map"):
        assert heard_from(keys, keys / "strangers" / name, WORDS) == ([], [])


def test_an_expired_certificate_is_refused_here_and_by_the_others(keys, tmp_path):
    home = tmp_path / "r1"
    shutil.copytree(keys / "team" / "r1", home)
    authority = _authority(keys / "team", "team", NOW)
    assert isinstance(authority, Authority)
    issue(authority, home, "r1", NOW - dt.timedelta(days=3), NOW - dt.timedelta(days=1))
    with pytest.raises(UsageError, match=r"the certificate expired on \d{4}-\d\d-\d\d"):
        tls_settings(home)
    unchecked = tls_settings(home, NOW - dt.timedelta(days=2))
    assert heard_from(keys, home, WORDS, unchecked) == ([], [])


def test_a_folder_that_does_not_serve_is_told_in_one_line(keys, tmp_path):
    home = tmp_path / "r1"
    shutil.copytree(keys / "team" / "r1", home)
    (home / "key.pem").unlink()
    with pytest.raises(UsageError, match=r"expected key\.pem there, found none"):
        tls_settings(home)
    shutil.copy(keys / "team" / "r2" / "key.pem", home)
    with pytest.raises(UsageError, match=r"key\.pem does not belong to certificate\.pem"):
        tls_settings(home)
    (home / "key.pem").write_text("none")
    with pytest.raises(UsageError, match="cannot be read"):
        tls_settings(home)


@pytest.mark.parametrize(
    ("as_whom", "told"),
    [
        (lambda net: live_robot("r2", "sim:landmarks", network=net), "is robot r1's: r2 would not be heard with it"),
        (lambda net: live_map("out", network=net), "is robot r1's: a map process would not be heard with it"),
        (lambda net: LiveLaser("r3", network=net), "is robot r1's: r3 would not be heard with it"),
        (lambda net: live_robot("r1", "sim:landmarks", network=replace(net, team="b")), "of team team, and this is"),
    ],
)
def test_who_shows_a_certificate_that_none_would_hear_him_with_is_told(keys, tmp_path, monkeypatch, as_whom, told):
    monkeypatch.chdir(tmp_path)
    network = Network(connect=("tls/127.0.0.1:9",), tls=keys / "team" / "r1")
    with pytest.raises(UsageError, match=told):
        as_whom(network)
    assert not list(tmp_path.iterdir())


def test_a_certificate_of_another_team_or_of_nobody_on_the_list_is_told(keys, tmp_path):
    home = tmp_path / "r1"
    shutil.copytree(keys / "team" / "r1", home)
    shutil.copy(keys / "strangers" / "r1" / "authority.pem", home)
    with pytest.raises(UsageError, match=r"authority\.pem did not sign certificate\.pem: they are of two teams"):
        tls_settings(home)
    shutil.copy(keys / "team" / "r1" / "authority.pem", home)
    (home / "access.json").write_text('{"team": "team", "names": {"r2": "robot"}}')
    with pytest.raises(UsageError, match="r1 is not on the list of who may speak"):
        expect_heard(home, "r1", "team", "robot")


def test_keys_are_kept_when_robots_are_added_and_secrets_are_ones_own(tmp_path):
    live_keys(tmp_path, robots=["r1"])
    before = (tmp_path / "r1" / "certificate.pem").read_bytes()
    homes = live_keys(tmp_path, robots=["r2"])
    assert {home.name for home in homes} == {"r1", "r2", "map", "view"}
    assert (tmp_path / "r1" / "certificate.pem").read_bytes() == before
    lists = {json.dumps(json.loads((home / "access.json").read_text())) for home in homes}
    assert len(lists) == 1
    assert json.loads(lists.pop())["names"] == {"r1": "robot", "map": "map", "view": "map", "r2": "robot"}
    for secret in (tmp_path / "authority-key.pem", tmp_path / "r2" / "key.pem"):
        assert secret.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"robots": ["a b"]}, "--robots: expected letters"),
        ({"robots": ["r1", "r1"]}, "r1 comes twice"),
        ({"robots": ["map"]}, "map comes twice"),
        ({"robots": ["r1"], "days": 0.0}, "--days: expected above 0"),
        ({"robots": ["r1"], "team": "*"}, "--team: expected letters"),
    ],
)
def test_keys_for_what_cannot_be_are_refused(tmp_path, asked, told):
    with pytest.raises((DataError, UsageError), match=told):
        live_keys(tmp_path, **asked)


@pytest.mark.parametrize(
    "word", ["127.0.0.1:7447", "tcp/127.0.0.1:0", "tcp/7447", "tcp/host:", "http/a:1", "tcp/host:port"]
)
def test_an_endpoint_that_is_none_is_refused(word):
    with pytest.raises(UsageError, match="--connect: expected protocol/host:port"):
        endpoints([word], "--connect")


def test_a_port_in_use_is_told_in_one_line():
    at = (free_endpoint(),)
    with (
        session(Network(listen=at)),
        pytest.raises(UsageError, match="already in use") as told,
        session(Network(listen=at)),
    ):
        pass
    assert str(told.value) == f"--listen {at[0]}: the port is already in use"


def test_port_0_is_one_that_nobody_else_has():
    at = []
    anywhere = Network(listen=("tcp/127.0.0.1:0", "tcp/127.0.0.1:0"))
    with session(anywhere, at.append), session(anywhere, at.append):
        assert len(set(at)) == 4
        assert endpoints(at, "--connect") == tuple(at)
        with pytest.raises(UsageError, match="already in use"), session(Network(listen=(at[2],))):
            pass
    assert endpoints(["tcp/127.0.0.1:0"], "--listen") == ("tcp/127.0.0.1:0",)


def test_a_port_that_was_taken_meanwhile_is_not_insisted_on(monkeypatch):
    at = []
    with session(Network(listen=("tcp/127.0.0.1:0",)), at.append):
        chosen = iter([at[0], at[0], "tcp/127.0.0.1:0"])
        choose = transport._with_port
        monkeypatch.setattr(transport, "_with_port", lambda asked: choose(next(chosen)))
        with session(Network(listen=("tcp/127.0.0.1:0",)), at.append):
            assert len(set(at)) == 2


def test_a_history_is_answered_without_a_word_of_python(tmp_path):
    at, answers, ended = [], [], Event()
    with (
        warnings.catch_warnings(),
        session(Network(listen=("tcp/127.0.0.1:0",)), at.append) as asking,
        session(Network(connect=tuple(at))) as opened,
        Store(tmp_path / "r1.sqlite", "robot r1") as store,
    ):
        warnings.simplefilter("error")
        store.put([("r1", k, bytes([k])) for k in range(9)])
        topics = Topics("team")
        RobotProcess("r1", opened, topics, store, print).join()
        while not there_is(asking, topics.alive("r1"), 0.0):
            time.sleep(0.05)
        ask(asking, topics.history("r1"), "first=2;last=7", answers.append, ended.set)
        assert ended.wait(60)
    assert sorted(answers) == [bytes([k]) for k in range(2, 8)]


def test_lines_of_refusals_are_known():
    line = "WARN acc-0 ThreadId(06) zenoh_link_tls::unicast: received fatal alert: DecryptError. Hint: ..."
    assert reason_of(line) == (True, STRANGER)
    line = "TRACE rx-1 zenoh::net::routing::interceptor::access_control: x on y is unauthorized to Put (ingress) on k"
    assert reason_of(line) == (True, FORGED)
    assert reason_of(line.replace("unauthorized", "authorized")) == (True, None)
    assert reason_of("something else") == (False, None)


def test_a_robot_that_listens_is_not_accused_of_what_it_never_said():
    line = (
        "TRACE x::access_control: 7c on Interface(lo)+CertCommonName(r1)+Transport(Tls)+7c is unauthorized to {} on {}"
    )
    judged = ("Reply (ingress)", "Put (ingress)", "Declare/Undeclare Liveliness Token (ingress)")
    denials, heard, own = Denials(), "mapweave/team/@map/map/alive", "mapweave/team/r2/log"
    assert [denials.said(line.format(what, heard)) for what in judged] == [False] * 3
    assert denials.said(line.format("Put (ingress)", "mapweave/team/@map/map/state"))
    assert [denials.said(line.format(what, own)) for what in judged] == [True] * 3
    assert plain(FORGED, line.format("Put (ingress)", own)) == f"refused: {FORGED}: r1 may not put on {own}"
    knocked = "WARN acc-0 zenoh_link_tls::unicast: received fatal alert: UnknownCA. Hint: increase the limit."
    assert plain(STRANGER, knocked).endswith(
        "valid certificate of this team's authority (received fatal alert: UnknownCA)"
    )


@pytest.mark.slow
def test_a_whole_team_with_certificates_maps_and_counts_what_it_refused(tmp_path, keys):
    simulate_landmarks(tmp_path / "team", robots=2, minutes=0.3, seed=3)
    fleet = Fleet(tmp_path, tmp_path / "team")
    fleet.at = fleet.at.replace("tcp/", "tls/")
    home = keys / "team"
    try:
        fleet.map("--tls", str(home / "map"))
        fleet.hears("map", "heard so far")
        with session(Network(connect=(fleet.at,), tls=home / "r2")) as forger:
            with session(Network(connect=(fleet.at,), tls=keys / "strangers" / "r1")):
                fleet.hears("map", f"refused: {STRANGER}")
            forged = encode(messages(team()[1], "r1", "forged")[0])
            end, tries = time.monotonic() + 60, 0
            while f"refused: {FORGED}" not in fleet.said("map"):  # before it is connected nobody hears it
                assert time.monotonic() < end, fleet.said("map")
                put(forger, TOPICS.log("r1"), forged)
                tries += 1
                time.sleep(0.2)
        for name in ("r1", "r2"):
            fleet.robot(name, "--tls", str(home / name), rate="inf")
        assert fleet.wait("map") == 0, fleet.said("map")
    finally:
        fleet.end()
    assert "of 2 robots in one map" in fleet.said("map")
    assert f"refused: {FORGED}: r2 may not put on {TOPICS.log('r1')}" in fleet.said("map")
    told = re.search(rf"refused from others:.* (\d+) {FORGED}", fleet.said("map"))
    assert 1 <= int(told[1]) <= tries


@pytest.mark.parametrize(
    "words",
    [
        ["robot", "--name", "r 1", "--source", "sim:landmarks"],
        ["map", "--robots", "r1,r 2", "--out", "result"],
        ["keys", "--robots", "r1,r/2", "--out", "keys"],
    ],
)
def test_a_name_that_nobody_can_have_is_wrong_usage(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run(["live", *words]) == 2
    err = capsys.readouterr().err
    assert "expected letters, digits" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("network", "opened"),
    [
        (Network(), True),
        (Network(listen=("tcp/0.0.0.0:7447",)), True),
        (Network(listen=("tcp/[::]:7447",)), True),
        (Network(listen=("tcp/127.0.0.1:7447",), connect=("tcp/192.168.1.5:7447",)), True),
        (Network(connect=("tcp/robot.example:7447",)), True),
        (Network(listen=("tcp/127.0.0.1:7447",)), False),
        (Network(listen=("tcp/[::1]:7447",), connect=("tcp/localhost:7448",)), False),
        (Network(listen=("tls/0.0.0.0:7447",), tls=Path("keys/map")), False),
    ],
)
def test_a_map_process_that_anyone_could_write_to_does_not_start_unasked(network, opened, tmp_path):
    assert is_open(network) == opened
    if opened:
        with pytest.raises(UsageError, match="--insecure"):
            live_map(tmp_path / "out", network=network)
        assert not list(tmp_path.iterdir())


def test_that_anyone_could_have_written_it_is_told_with_the_map(tmp_path):
    at = (free_endpoint(),)
    simulate_landmarks(tmp_path / "team", robots=1, minutes=0.3, seed=4)
    said = []
    heard = Network(listen=at, connect=("tcp/localhost.:9",), insecure=True)
    mapping = Thread(target=lambda: live_map(tmp_path / "out", robots=["r1"], network=heard, say=said.append))
    mapping.start()
    network = Network(connect=at)
    live_robot("r1", tmp_path / "team", rate=math.inf, history=tmp_path / "r1", network=network, say=lambda _: None)
    mapping.join(120)
    assert INSECURE in said
    assert INSECURE in json.loads((tmp_path / "out" / "metrics.json").read_text())["warnings"]
    assert "anyone who reaches the network" in (tmp_path / "out" / "report.html").read_text()
