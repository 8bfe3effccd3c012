"""Every message once and in order, whatever the network did to it."""

import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from mapweave.api.live import _final
from mapweave.api.map_options import MapOptions
from mapweave.core.errors import DataError, UsageError
from mapweave.live.door import decode
from mapweave.live.inbox import AGAIN, ANSWER, PATIENCE, Inbox
from mapweave.live.landmark_stream import LandmarkRecord
from mapweave.live.messages import Closed, MapState, Rows, Status, encode
from mapweave.live.store import Store

from .teams import messages, payloads, team

OWNER = "a map of team"


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "map.sqlite", OWNER) as made:
        yield made


def hear(inbox, told, robot="r1", now=0.0):
    for payload in told:
        inbox.offer(robot, payload, now)


@pytest.mark.parametrize("seed", range(5))
def test_doubled_and_shuffled_messages_of_two_robots_give_the_logs_themselves(store, seed):
    logs = team()
    rng = np.random.default_rng(seed)
    told = [(f"r{k}", p) for k, log in enumerate(logs, 1) for p in payloads(log, f"r{k}", f"run{k}")]
    told += [told[i] for i in rng.integers(len(told), size=len(told) // 2)]
    inbox = Inbox(store)
    for i in rng.permutation(len(told)):
        inbox.offer(*told[i], 0.0)
        if rng.random() < 0.2:
            inbox.save()
    inbox.save()
    for k, log in enumerate(logs, 1):
        ledger = inbox.ledgers[f"r{k}"]
        assert ledger.complete
        assert ledger.missing == 0
        assert inbox.log(f"r{k}").log_hash == log.log_hash
    assert sum(ledger.doubled for ledger in inbox.ledgers.values()) == len(told) - len({p for _, p in told})


def test_a_new_process_knows_what_the_last_one_saved(tmp_path):
    told = payloads(team()[0])
    with Store(tmp_path / "map.sqlite", OWNER) as store:
        inbox = Inbox(store)
        hear(inbox, [*told[:5], *told[7:9]])
        inbox.save()
        hear(inbox, told[9:])  # never saved: the process is killed
    with Store(tmp_path / "map.sqlite", OWNER) as store:
        inbox = Inbox(store)
        ledger = inbox.ledgers["r1"]
        assert (ledger.next, ledger.last, ledger.held) == (5, 8, {7, 8})
        hear(inbox, told)
        assert ledger.complete
        assert inbox.log("r1").log_hash == team()[0].log_hash


def test_what_the_map_process_tells_of_those_not_used_passes_every_door_whatever_they_call_themselves(store):
    inbox = Inbox(store, ["r1"])
    for name in ("x" * 300, "a b", "", "r9"):
        inbox.offer(name, b"nothing", 0.0)
    assert set(inbox.unused()) == {"r9"}
    assert inbox.not_used() == []
    hear(inbox, payloads(team()[0])[:1])
    inbox.ledgers["r1"].fault = "y" * 10_000
    state = MapState(
        map="m", clock=0.0, fused=0, robots=[], landmarks=[], decisions=inbox.not_used(), unused=inbox.unused()
    )
    assert decode(encode(state)) == state
    assert set(state.unused) == {"r1", "r9"}


def test_what_is_missing_is_asked_for_after_a_moment_and_again_when_nobody_answers(store):
    told = payloads(team()[0])
    inbox = Inbox(store)
    hear(inbox, [told[0], told[1], told[6]])
    assert not list(inbox.gaps(0.5 * PATIENCE))
    assert list(inbox.gaps(PATIENCE)) == [("r1", 2, 5)]
    assert not list(inbox.gaps(PATIENCE + 0.5 * AGAIN))
    assert list(inbox.gaps(PATIENCE + AGAIN)) == [("r1", 2, 5)]
    inbox.answered("r1")
    hear(inbox, told[2:4], now=3.0)
    assert list(inbox.gaps(PATIENCE + AGAIN)) == [("r1", 4, 5)]
    hear(inbox, told[4:6])
    assert not list(inbox.gaps(100.0))


def test_what_is_answered_with_nothing_of_use_is_asked_for_no_sooner_than_what_nobody_answers(store):
    told = payloads(team()[0])
    inbox = Inbox(store)
    hear(inbox, [told[0], told[6]])
    assert list(inbox.gaps(PATIENCE)) == [("r1", 1, 5)]
    for _ in range(5):
        inbox.offer("r1", b"nothing", 1.0)
    inbox.answered("r1")
    assert not list(inbox.gaps(PATIENCE + 0.9 * AGAIN))
    assert list(inbox.gaps(PATIENCE + AGAIN)) == [("r1", 1, 5)]
    assert inbox.ledgers["r1"].refused == {"malformed": 5}


def test_a_status_tells_of_messages_that_never_came(store):
    inbox = Inbox(store)
    status = Status(robot="r1", run="a", sensor="landmarks", last=999, clock=0.0, t=0.0, pose=(0.0,) * 3, cov=())
    hear(inbox, [encode(status)])
    assert list(inbox.gaps(PATIENCE)) == [("r1", 0, ANSWER - 1)]


def test_a_stranger_a_forged_name_and_another_history_are_counted_and_harm_nobody(store):
    told = payloads(team()[0])
    inbox = Inbox(store, ["r1"])
    hear(inbox, told[:3])
    hear(inbox, told[3:5], robot="r9")
    hear(inbox, payloads(team()[1], "r2"), robot="r1")
    hear(inbox, payloads(team()[0], run="b"))
    hear(inbox, [b"nonsense"])
    assert inbox.refused == {"not expected": 2}  # unread
    n = len(payloads(team()[1], "r2"))
    assert inbox.ledgers["r1"].refused == {"forged name": n, "other history": len(told), "malformed": 1}
    hear(inbox, payloads(team()[1], "r2"), robot="r2")
    assert inbox.refused == {"not expected": n + 2}
    hear(inbox, told)
    assert inbox.log("r1").log_hash == team()[0].log_hash
    assert len([line for line in inbox.news if "refused" in line]) == 4
    assert inbox.unused() == {name: f"not expected: {name} is not one of --robots" for name in ("r9", "r2")}
    assert inbox.not_used() == [
        "r1: other history: another robot has this name, or it began a new history: not used",
    ]


def test_two_robots_of_one_name_in_the_log_cannot_both_be_in_the_map(store):
    inbox = Inbox(store)
    hear(inbox, payloads(team()[0]))
    hear(inbox, payloads(team()[0], "twin"), robot="twin")
    assert "r1 is robot1 already" in inbox.ledgers["twin"].fault
    assert inbox.ledgers["twin"].complete
    assert inbox.unused() == {"twin": inbox.ledgers["twin"].fault}
    assert [r for r, x in inbox.ledgers.items() if x.record is not None] == ["r1"]


def test_messages_after_one_that_contradicts_are_not_used(store):
    log = team()[0]
    header, first, *_ = messages(log)
    wrong = Rows(robot="r1", run="a", seq=2, drive=first.drive)
    inbox = Inbox(store)
    hear(inbox, [encode(m) for m in (header, first, wrong, Closed(robot="r1", run="a", seq=3))])
    ledger = inbox.ledgers["r1"]
    assert "step back" in ledger.fault
    assert inbox.ledgers["r1"].record.parts == []  # rows are in the store alone
    alone = LandmarkRecord.begin(messages(team()[0])[0])
    alone.add(messages(team()[0])[1])
    assert inbox.log("r1").log_hash == alone.log.log_hash
    assert not list(inbox.gaps(10.0))


def test_a_full_disk_loses_nothing(store, monkeypatch):
    inbox = Inbox(store)
    told = payloads(team()[0])
    hear(inbox, told[:4])
    with monkeypatch.context() as patch:

        def full(messages):
            raise DataError("database or disk is full")

        patch.setattr(store, "put", full)
        with pytest.raises(DataError):
            inbox.save()
        hear(inbox, told[4:])
    inbox.save()
    assert store.numbers("r1") == list(range(len(told)))


def test_a_store_of_another_owner_version_or_kind_is_told_in_one_line(tmp_path):
    path = tmp_path / "s.sqlite"
    with Store(path, "robot r1 of team a") as store:
        store.put([("r1", 0, b"x")])
        with pytest.raises(DataError, match="another process holds it"):
            Store(path, "robot r1 of team a")
    with pytest.raises(UsageError, match="holds robot r1 of team a, expected robot r2"):
        Store(path, "robot r2 of team a")
    with Store(path, "robot r1 of team a") as store:
        assert store.get("r1", 0, 9) == [(0, b"x")]
        store.set_about("version", "7")
    with pytest.raises(UsageError, match="a store of version 7, this is 2"):
        Store(path, "robot r1 of team a")
    other = tmp_path / "text"
    other.write_text("no database at all, but long enough to be read as one" * 20)
    with pytest.raises(DataError, match="not a database"):
        Store(other, OWNER)


def test_what_was_put_first_stays(store):
    store.put([("r1", 0, b"first")])
    store.put([("r1", 0, b"second"), ("r1", 1, b"next")])
    assert store.get("r1", 0, 9) == [(0, b"first"), (1, b"next")]


PAGE = 4096  # [bytes] of SQLite's files here


def kept_of_two(path):
    """A closed store of all that two robots told, and what is in it."""
    told = {f"r{k}": payloads(log, f"r{k}") for k, log in enumerate(team(), 1)}
    with Store(path, OWNER) as store:
        inbox = Inbox(store)
        for robot, each in told.items():
            for payload in each:
                inbox.offer(robot, payload, 0.0)
        inbox.save()
    return told


def damaged(path, rng, page):
    """The page holds other bytes: some, or all of them."""
    with path.open("r+b") as file:
        file.seek(page * PAGE + (0 if rng.random() < 0.5 else int(rng.integers(PAGE - 60))))
        file.write(rng.bytes(int(rng.choice([1, 60]))) if file.tell() % PAGE else bytes(PAGE))


def test_wherever_a_store_is_damaged_what_is_left_is_used_and_the_rest_asked_for(tmp_path):
    told = kept_of_two(tmp_path / "sound")
    pages = (tmp_path / "sound").stat().st_size // PAGE
    rng, lost = np.random.default_rng(3), 0
    for page in [*range(1, pages), *rng.integers(1, pages, 30).tolist()]:
        path = tmp_path / f"s{lost}-{page}"
        shutil.copy(tmp_path / "sound", path)
        damaged(path, rng, page)
        with Store(path, OWNER) as store:
            inbox = Inbox(store)
            for robot, each in told.items():
                kept = store.get(robot, 0, 1 << 40)
                assert all(each[seq] == payload for seq, payload in kept)
                missing = set(range(len(each))) - {seq for seq, _ in kept}
                assert not missing or "was damaged" in store.damage
                lost += len(missing)
                for seq in (0, len(each) - 1):  # the robot goes on
                    inbox.offer(robot, each[seq], 10.0)
            for robot, first, last in [*inbox.gaps(11.0), *inbox.gaps(14.0)]:
                for payload in told[robot][first : last + 1]:
                    inbox.offer(robot, payload, 14.0)
            inbox.save()
            assert all(inbox.ledgers[robot].complete for robot in told)
            assert {inbox.log(robot).log_hash for robot in told} == {log.log_hash for log in team()}
        with Store(path, OWNER) as store:
            assert store.damage == ""
    assert lost > 100


def test_a_store_without_checksums_is_read_and_has_them_from_now_on(tmp_path):
    path = tmp_path / "s.sqlite"
    with Store(path, OWNER) as store:
        store.put([("r1", 0, b"x")])
        store._db.execute("ALTER TABLE messages DROP COLUMN crc")
        store.set_about("version", "1")
    with Store(path, OWNER) as store:
        assert store.get("r1", 0, 9) == [(0, b"x")]
        store.put([("r1", 1, b"y")])
        store._db.execute("UPDATE messages SET payload = x'00' WHERE seq = 1")
    with Store(path, OWNER) as store:
        assert store.get("r1", 0, 9) == [(0, b"x")]
        assert "was damaged: 1 messages could be read" in store.damage


@pytest.mark.slow
def test_a_gap_in_what_a_robot_told_is_told_in_the_result(store):
    inbox, told = Inbox(store), []
    for k, log in enumerate(team(), 1):
        every = payloads(log, f"r{k}", f"run{k}")
        hear(inbox, [*every[:-3], *every[-2:]] if k == 2 else every, f"r{k}")
    _final(inbox, MapOptions(), told.append)
    (said,) = told
    assert said.startswith(f"r2: of {len(every)} messages 1 are missing")


@pytest.mark.slow
def test_a_robot_that_announces_wheels_and_tells_none_is_mapped_without(tmp_path):
    plain = [replace(log, odometry=None) for log in team()]
    results = []
    for folder, announced in (("with", True), ("without", False)):
        with Store(tmp_path / folder, OWNER) as kept:
            inbox = Inbox(kept)
            for k, log in enumerate(plain, 1):
                first, *rest = messages(log, f"r{k}", f"run{k}")
                first = msgspec.structs.replace(first, odometry=announced)
                hear(inbox, map(encode, [first, *rest]), f"r{k}")
            results.append(_final(inbox, MapOptions(), pytest.fail))
    told, without = ([(m.robot, m.odometry, m.track.pose.tobytes()) for m in each.local] for each in results)
    assert told == without
    assert [row[:2] for row in told] == [("robot1", "none"), ("robot2", "none")]


def test_that_a_robot_tells_none_of_its_wheels_is_said_once_and_no_longer_when_it_does(store):
    inbox = Inbox(store)
    told = messages(team()[0])
    silent = [msgspec.structs.replace(m, drive=b"") if isinstance(m, Rows) and m.seq < 8 else m for m in told]
    hear(inbox, map(encode, silent[:8]))
    line = "r1: it announced wheels, and told no row of them in 3 s: it is mapped without"
    assert inbox.wheelless() == [line]
    assert list(inbox.news).count(line) == 1
    hear(inbox, map(encode, silent[8:]))
    assert inbox.wheelless() == []
