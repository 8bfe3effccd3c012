"""Two messages of one number, two histories of one name: neither is used until the robot's own history decides."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from mapweave.live.door import decode
from mapweave.live.inbox import AGAIN, AHEAD, IN_VAIN, PATIENCE, STATED, Inbox
from mapweave.live.laser_stream import messages_of_laser
from mapweave.live.map_process import MOST_A_SECOND, MOST_SPEAKERS, OTHERS, Intake
from mapweave.live.messages import Closed, Header, RobotState, Rows, Status, encode
from mapweave.live.store import Store
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

from .teams import messages, payloads, team

LOG = team()[0]
TOLD = payloads(LOG)
TWIN = payloads(team()[1])  # another drive in the same name
RUN_B = payloads(LOG, run="b")


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "map.sqlite", "a map of team") as made:
        yield made


def hear(inbox, told, now=0.0):
    for payload in told:
        inbox.offer("r1", payload, now)


def asked(inbox, now):
    return list(inbox.doubts(now))


def settled(inbox, now):
    """The robot answers for itself whatever it is asked."""
    while asks := asked(inbox, now):
        for _, first, last in asks:
            inbox.decide("r1", TOLD[first : last + 1], now)
        now += 1e-3


def test_of_two_messages_of_one_number_neither_is_used_until_the_robot_decides(store):
    inbox = Inbox(store)
    hear(inbox, [*TOLD[:6], TWIN[4], *TOLD[6:]])
    ledger = inbox.ledgers["r1"]
    assert not ledger.doubled
    assert ledger.refused == {"told in two ways": 1}
    assert not ledger.complete
    assert inbox.log("r1") is None  # whoever told that may have told the rest as well
    assert asked(inbox, 0.0) == [("r1", 0, len(TOLD) - 1)]
    assert not asked(inbox, 0.5 * AGAIN)
    inbox.decide("r1", TOLD[:6], 1.0)
    assert len(inbox.log("r1")) == len(partial(6))
    settled(inbox, 9.0)
    assert ledger.complete
    assert ledger.anew == 0
    assert inbox.log("r1").log_hash == LOG.log_hash
    hear(inbox, [TWIN[4]])
    assert ledger.complete
    assert ledger.refused["not its own"] == 1
    hear(inbox, TOLD)
    assert ledger.doubled == len(TOLD)


def test_a_header_that_comes_again_with_another_sweep_is_used_by_nobody_before_the_robot_decides(store):
    log = replace(simulate_corridor(CorridorConfig(distance=2.0), seed=2).log, sweep=0.1)
    told = [message for _, message in messages_of_laser(log, "r1", "a", 0.5)]
    again = [msgspec.structs.replace(told[0], sweep=0.2), *told[1:]]
    inbox = Inbox(store)
    hear(inbox, map(encode, [*told[:4], again[0], *told[4:]]))
    assert inbox.log("r1") is None
    assert any("message 0 was told in two ways" in line for line in inbox.news)
    while asks := asked(inbox, 1.0):
        for _, first, last in asks:
            inbox.decide("r1", [encode(m) for m in again[first : last + 1]], 1.0)
    assert inbox.log("r1").sweep == 0.2
    assert inbox.ledgers["r1"].anew == 1  # what was followed with the other is void


def partial(n):
    from mapweave.live.landmark_stream import LandmarkRecord

    record = LandmarkRecord.begin(messages(LOG)[0])
    for message in messages(LOG)[1:n]:
        record.add(message)
    return record.log


@pytest.mark.parametrize("restarted", [False, True])
def test_forged_messages_that_came_first_are_put_right_by_the_robots_own(tmp_path, restarted):
    with Store(tmp_path / "m.sqlite", "a map") as store:
        inbox = Inbox(store)
        hear(inbox, [TOLD[0], *TWIN[1:9], *TOLD[1:]])
        inbox.save()
        assert inbox.log("r1") is None
        if not restarted:
            settled(inbox, 1.0)
            assert inbox.ledgers["r1"].anew == 1
            hear(inbox, TOLD)  # what came after a message that could not be used is asked for again
            settled(inbox, 9.0)
            assert inbox.log("r1").log_hash == LOG.log_hash
    if restarted:  # both are kept: the next process is in doubt as well
        with Store(tmp_path / "m.sqlite", "a map") as store:
            inbox = Inbox(store)
            assert inbox.ledgers["r1"].doubt[0] == 0
            settled(inbox, 1.0)
            hear(inbox, TOLD)
            settled(inbox, 9.0)
            assert inbox.log("r1").log_hash == LOG.log_hash
            inbox.save()
        with Store(tmp_path / "m.sqlite", "a map") as store:  # which asks again, having been lied to before
            inbox = Inbox(store)
            assert inbox.log("r1") is None
            settled(inbox, 1.0)
            assert inbox.log("r1").log_hash == LOG.log_hash


def test_a_history_that_is_itself_told_in_two_ways_decides_nothing(store):
    inbox = Inbox(store)
    hear(inbox, [*TOLD, TWIN[4]])
    inbox.decide("r1", [TOLD[4], TWIN[4]], 1.0)
    inbox.decide("r1", [TOLD[4], RUN_B[4]], 1.0)
    inbox.decide("r1", [b"nonsense"], 1.0)
    inbox.decide("r1", [], 1.0)
    assert inbox.ledgers["r1"].doubt == (0, len(TOLD) - 1)
    assert asked(inbox, AGAIN) == [("r1", 0, len(TOLD) - 1)]


def test_numbers_that_others_invent_beyond_the_last_stop_nobody(store):
    inbox = Inbox(store)
    far = [encode(Rows(robot="r1", run="a", seq=len(TOLD) + 50, names=[name])) for name in ("x", "y")]
    hear(inbox, [*TOLD[:5], *far, *TOLD[5:]])
    settled(inbox, 1.0)
    assert inbox.ledgers["r1"].complete
    assert inbox.log("r1").log_hash == LOG.log_hash


def test_a_header_that_came_first_does_not_lock_out_the_robot(store):
    inbox = Inbox(store)
    hear(inbox, RUN_B[:7])
    inbox.presence("r1", there=True)
    hear(inbox, TOLD[:3])
    assert inbox.ledgers["r1"].refused == {"other history": 3}
    assert asked(inbox, 0.0) == [("r1", 0, 0)]
    inbox.decide("r1", [TOLD[0]], 0.1)
    assert inbox.ledgers["r1"].anew == 1
    hear(inbox, TOLD)
    assert inbox.log("r1").log_hash == LOG.log_hash
    hear(inbox, RUN_B)  # its run is known by now: no other ever takes its place
    inbox.decide("r1", [RUN_B[0]], 9.0)
    assert inbox.log("r1").log_hash == LOG.log_hash
    assert not asked(inbox, 20.0)


def test_what_others_say_of_a_robots_run_does_not_lock_it_out(store):
    inbox = Inbox(store)
    spoken = RobotState(
        robot="r1", run="invented", log_robot="", sensor="", there=True, finished=False, have=9, last=9, rate=0.0
    )
    inbox.hearsay([spoken], 0.0)
    inbox.presence("r1", there=True)
    assert asked(inbox, 0.0) == [("r1", 0, 0)]
    inbox.decide("r1", [TOLD[0]], 0.1)
    hear(inbox, TOLD)
    assert inbox.log("r1").log_hash == LOG.log_hash


def test_what_another_map_process_has_is_asked_for_and_no_number_more(store):
    inbox = Inbox(store)
    hear(inbox, TOLD[:1])
    run = inbox.ledgers["r1"].run
    state = RobotState(
        robot="r1", run=run, log_robot="", sensor="", there=True, finished=False, have=3, last=9, rate=0.0
    )
    inbox.hearsay([state], 0.0)
    assert list(inbox.gaps(PATIENCE + 0.1)) == [("r1", 1, 2)]


def test_a_robot_whose_own_message_no_door_lets_in_ends_before_it_and_is_told(store):
    inbox = Inbox(store)
    bad = encode(Rows(robot="r1", run="a", seq=3, drive=b"x"))
    hear(inbox, [*TOLD[:3], bad, *TOLD[4:]])
    inbox.presence("r1", there=True)
    inbox.decide("r1", [TOLD[0]], 0.0)
    for k in range(IN_VAIN + 1):
        assert list(inbox.gaps(PATIENCE + k * (AGAIN + 0.1)))
    assert asked(inbox, 100.0) == [("r1", 3, 3)]
    inbox.decide("r1", [bad], 100.0)
    assert "message 3: malformed" in inbox.ledgers["r1"].fault
    assert inbox.ledgers["r1"].complete
    assert inbox.log("r1").log_hash == partial(3).log_hash


def test_invented_robots_give_their_place_to_one_that_is_there(store):
    inbox = Inbox(store)
    for k in range(STATED + 10):
        status = Status(robot=f"x{k}", run="a", sensor="laser", last=0, clock=0.0, t=0.0, pose=(0.0,) * 3, cov=())
        inbox.offer(f"x{k}", encode(status), 0.0)
    assert len(inbox.ledgers) == STATED
    hear(inbox, TOLD)
    assert inbox.log("r1").log_hash == LOG.log_hash


def test_robots_that_are_expected_by_name_have_a_place_each_however_many(store):
    names = [f"r{k}" for k in range(1, 3 * STATED)]
    inbox = Inbox(store, names)
    for k, name in enumerate(names, 1):
        header = msgspec.structs.replace(decode(TOLD[0]), robot=name, log_robot=f"robot{k}")
        inbox.offer(name, encode(header), 0.0)
    assert [ledger.next for ledger in inbox.ledgers.values()] == [1] * len(names)
    assert not inbox.refused


def test_a_robot_more_than_are_taken_on_unnamed_says_what_to_do_about_it(store):
    inbox = Inbox(store)
    for k in range(1, STATED + 2):
        header = msgspec.structs.replace(decode(TOLD[0]), robot=f"r{k}", log_robot=f"robot{k}")
        inbox.offer(f"r{k}", encode(header), 0.0)
    told = [inbox.unused()[f"r{STATED + 1}"], *inbox.not_used(), inbox.news[-1]]
    assert len(told) == 3
    assert all("--robots NAME,NAME,.. of the map process" in words for words in told)


def test_a_number_far_ahead_is_not_kept_and_a_last_number_nobody_told_is_forgotten(store):
    inbox = Inbox(store)
    hear(inbox, [TOLD[0], encode(Closed(robot="r1", run="a", seq=AHEAD + 9))])
    assert inbox.ledgers["r1"].refused == {"far ahead": 1}
    status = [Status(robot="r1", run="a", sensor="landmarks", last=n, clock=0.0, t=0.0, pose=(0.0,) * 3, cov=())
              for n in (2**39, 7)]  # fmt: skip
    hear(inbox, [encode(s) for s in status])
    assert inbox.ledgers["r1"].last == 7


def test_a_speaker_that_floods_takes_no_others_turn_and_no_others_room():
    intake = Intake(most=100_000, clock=lambda: 0.0)
    for k in range(2000):
        intake.put("mallory", bytes(1000))
        if k % 100 == 0:
            intake.put("r1", b"%d" % k)
    assert intake.size <= 100_000
    assert set(intake.let_go) == {"mallory"}
    taken = [intake.take() for _ in range(40)]
    assert [payload for name, payload in taken if name == "r1"] == [b"%d" % k for k in range(0, 2000, 100)]
    assert len(intake) == 2000 - intake.let_go["mallory"] - 20
    while intake.take():
        pass
    assert intake.size == 0


def test_a_speaker_that_is_too_fast_is_let_go_and_invented_ones_are_bounded():
    now = [0.0]
    intake = Intake(clock=lambda: now[0])
    for _ in range(MOST_A_SECOND + 5):
        intake.put("r1", b"x")
    assert intake.let_go == {"r1": 5}
    now[0] = 1.0
    intake.put("r1", b"x")
    assert len(intake) == MOST_A_SECOND + 1
    for k in range(MOST_SPEAKERS + 50):
        intake.put(f"x{k}", b"x")
    assert intake.let_go[OTHERS] == 51


@pytest.mark.parametrize("seed", range(3))
def test_in_whatever_order_forged_and_own_messages_come_the_own_are_used(store, seed):
    rng = np.random.default_rng(seed)
    inbox = Inbox(store)
    told = [*TOLD[1:], *TWIN[1:], *TOLD[5:9], *RUN_B[:9]]
    hear(inbox, [TOLD[0], *(told[k] for k in rng.permutation(len(told)))])
    inbox.presence("r1", there=True)
    settled(inbox, 1.0)
    hear(inbox, TOLD)
    settled(inbox, 9.0)
    assert inbox.ledgers["r1"].complete
    assert inbox.log("r1").log_hash == LOG.log_hash


def laser_header(robot, log_robot):
    return encode(Header(robot=robot, run="x", sensor="laser", log_robot=log_robot, source="s", odometry=True))


@pytest.mark.parametrize("log_robot", ["robot9", "robot1"])
def test_a_header_in_anothers_name_keeps_no_robot_out_that_tells_its_own(store, log_robot):
    inbox = Inbox(store)
    inbox.offer("mallory", laser_header("mallory", log_robot), 0.0)
    hear(inbox, TOLD)
    inbox.presence("r1", there=True)
    settled(inbox, 1.0)
    hear(inbox, TOLD)  # what came while there was no room is asked for again
    assert inbox.ledgers["r1"].complete
    assert inbox.log("r1").log_hash == LOG.log_hash
    taken = log_robot == "robot1"  # else it is one more robot of a mixed team, that told nothing yet
    assert bool(inbox.ledgers["mallory"].fault) == taken
    assert (inbox.log("mallory") is None) == taken


def test_of_two_that_tell_their_own_the_one_whose_name_it_is_is_that_robot_of_the_log(store):
    inbox = Inbox(store)
    twin = payloads(LOG, "twin")
    for payload in twin:
        inbox.offer("twin", payload, 0.0)
    assert inbox.log("twin").log_hash == LOG.log_hash
    hear(inbox, TOLD)
    assert inbox.log("r1").log_hash == LOG.log_hash
    assert "r1 is robot1" in inbox.ledgers["twin"].fault
    assert inbox.log("twin") is None
