"""What each robot is up to is told in a word, and kernels are there before a demo's robots drive."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from mapweave.live.inbox import Inbox
from mapweave.live.laser_team import DRIVEN, compile_kernels
from mapweave.live.map_process import BEHIND, MapProcess
from mapweave.live.messages import Topics
from mapweave.live.store import Store
from mapweave.live.transport import Network, session
from mapweave.live.view import PAGE
from mapweave.live.weaving import Placed

from .teams import payloads, team


@pytest.fixture
def process(tmp_path):
    """A map process that has heard the first messages of r1."""
    with Store(tmp_path / "s", "a map") as store, session(Network(listen=("tcp/127.0.0.1:0",))) as alone:
        made = MapProcess("map", alone, Topics("t"), store, Inbox(store), lambda _: None)
        for payload in payloads(team()[0])[:3]:
            made.inbox.offer("r1", payload, 0.0)
        made.inbox.presence("r1", there=True)
        yield made


def at(part):
    return Placed(part, np.zeros(3), np.zeros((3, 3)), 1.0)


def woven(**of):
    return SimpleNamespace(**{"worked": {"r1": 3}, "lost": {}} | of)


STATES = {
    "waits": lambda p: p.shared.placed.clear(),
    "drives": lambda p: None,
    "compiles": lambda p: setattr(p, "_weaver", object()),
    "stands alone": lambda p: p.shared.placed.update(r2=at(2), r3=at(2)),
    "catches up": lambda p: setattr(p.inbox.ledgers["r1"], "last", 3 + BEHIND),
    "is gone": lambda p: p.inbox.presence("r1", there=False),
    "has finished": lambda p: setattr(p.inbox.ledgers["r1"].record, "closed", True),
    "is lost": lambda p: setattr(p.inbox.ledgers["r1"], "fault", "message 3: no map"),
}


@pytest.mark.parametrize("word", STATES)
def test_a_robots_state_is_a_word(process, word):
    process.shared.placed["r1"] = at(1)
    STATES[word](process)
    (robot,) = process.state().robots
    assert robot.doing == word


@pytest.mark.parametrize(
    ("how", "word"),
    [({}, "drives"), ({"worked": {"r1": 3 - BEHIND - 1}}, "catches up"), ({"lost": {"r1": "a wall"}}, "is lost")],
)
def test_of_a_laser_robot_it_goes_by_what_is_woven(process, how, word):
    process.shared.placed["r1"] = at(1)
    process._weaver, process._woven = object(), woven(**how)
    assert process.state().robots[0].doing == word


def test_the_page_has_a_colour_for_words_of_waiting_and_of_harm():
    colours = re.search(r"\{ (\"drives\".*?) \}\[word\] \?\? \"(\w+)\"", PAGE)
    assert dict(re.findall(r"\"([a-z ]+)\": \"(\w*)\"", colours[1])).keys() < STATES.keys()
    for name in ("good", "bad", colours[2]):
        assert f".{name} {{ color: var(--{name}); }}" in PAGE
        assert len(re.findall(rf"--{name}: #", PAGE)) == 2  # by day and by night


def test_what_a_laser_team_compiles_is_compiled_in_one_go(tmp_path):
    compile_kernels(tmp_path / "s")
    with Store(tmp_path / "s", "a map") as store:
        assert min(len(store.numbers(name)) for name in ("r1", "r2")) >= DRIVEN
