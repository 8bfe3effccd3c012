"""What may be said, what is refused, and that a log survives being told."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.mapping import grow
from mapweave.live.door import decode
from mapweave.live.landmark_stream import LandmarkRecord, LandmarkRobot
from mapweave.live.messages import (
    LARGEST,
    PROTOCOL,
    Closed,
    Correction,
    GoalMessage,
    Header,
    MapState,
    Radios,
    RefusedError,
    Rows,
    ScanBeams,
    Scans,
    Snapshot,
    Status,
    Tile,
    encode,
    pack,
    pack_triangle,
    unpack,
    unpack_triangle,
)

from .teams import messages, team

PAGE = (Path(__file__).parents[2] / "docs" / "live.md").read_text()


def same(a, b):
    assert a.log_hash == b.log_hash
    assert (a.robot, a.dropped, a.findings, a.source) == (b.robot, dict(b.dropped), b.findings, b.source)
    for name in ("t", "what", "range", "bearing"):
        assert getattr(a.sightings, name).tobytes() == getattr(b.sightings, name).tobytes()


@pytest.mark.parametrize("period", [0.05, 1.0, 7.3, 1e6])
def test_a_log_is_the_same_to_the_bit_once_told_however_it_was_packed(period):
    for log in team():
        first, *rest = [decode(encode(m)) for m in messages(log, period=period)]
        record = LandmarkRecord.begin(first)
        for message in rest:
            record.add(message)
        assert record.closed
        assert [m.seq for m in rest] == list(range(1, len(rest) + 1))
        same(record.log, log)


def test_a_robot_told_message_by_message_has_the_map_that_its_whole_log_gives():
    log = team()[0]
    cfg = EkfSlamConfig()
    first, *rest = messages(log)
    robot = LandmarkRobot(first, cfg)
    for message in [first, *rest]:
        robot.add(message)
    whole = grow(log, cfg, [log.span[1]]).maps[0].submap
    assert robot.submap.ids == whole.ids
    np.testing.assert_array_equal(robot.submap.mean, whole.mean)
    np.testing.assert_array_equal(robot.submap.cov, whole.cov)
    told = decode(encode(robot.snapshot()))
    np.testing.assert_array_equal(unpack_triangle(told.cov, 3 + 2 * len(told.ids)), whole.cov)
    np.testing.assert_array_equal(unpack(told.mean, 2).T, whole.mean)


def without_wheels(log, until):
    """Messages of a robot that announces wheels and tells none of them before so many of its own."""
    return [
        msgspec.structs.replace(m, drive=b"") if isinstance(m, Rows) and m.seq < until else m for m in messages(log)
    ]


def test_wheels_that_were_announced_and_never_told_are_none_within_seconds():
    log = team()[0]
    told = without_wheels(log, 99)
    robot, plain = (
        LandmarkRobot(first, EkfSlamConfig()) for first in (told[0], msgspec.structs.replace(told[0], odometry=False))
    )
    for message in told[1 : 9 if log.span[1] - log.span[0] > 9 else None]:
        robot.add(message)
        plain.add(message)
    assert robot.record.wheelless
    assert robot.submap.ids == plain.submap.ids != ()
    np.testing.assert_array_equal(robot.submap.mean, plain.submap.mean)


def test_wheels_that_come_late_are_used_from_the_first_of_them_on():
    log = team()[0]
    late, told = LandmarkRobot(messages(log)[0], EkfSlamConfig()), without_wheels(log, 8)
    for message in told[1:]:
        late.add(message)
    assert not late.record.wheelless
    whole = grow(late.record.log, EkfSlamConfig(), [log.span[1]]).maps[0].submap
    assert late.submap.ids == whole.ids
    np.testing.assert_allclose(late.submap.mean, whole.mean, atol=1e-9)


def test_names_are_known_once_and_a_message_costs_none_of_those_before_it():
    record = LandmarkRecord.begin(messages(team()[0])[0])
    names, seen = record.names, pack([1e6], [1.0], [0.0])
    before = len(names)
    record.add(Rows(robot="r1", run="a", seq=1, names=["new"], seen=seen, what=[before]))
    assert record.names is names  # and no copy
    assert names[before:] == ["new"]
    for wrong in ({"names": ["new"]}, {"names": ["other", "other"]}, {"seen": seen, "what": [before + 1]}):
        with pytest.raises(RefusedError):
            record.add(Rows(robot="r1", run="a", seq=2, **wrong))
    assert names[before:] == ["new"]


def sound():
    return {
        "rows": Rows(robot="r1", run="a", seq=3, drive=pack([0.0, 1], [1, 1], [0, 0]), seen=b""),
        "closed": Closed(robot="r1", run="a", seq=4),
        "status": Status(
            robot="r1", run="a", sensor="landmarks", last=0, clock=1.0, t=0.0, pose=(0.0, 0.0, 0.0), cov=(0.0,) * 6
        ),
        "snapshot": Snapshot(
            robot="r1", run="a", last=1, t=0.0, pose=(0.0, 0.0, 0.0), ids=["7"], mean=pack([1.0], [2.0]),
            cov=pack_triangle(np.eye(5)), counts=[3],
        ),
    }  # fmt: skip


@pytest.mark.parametrize("kind", sorted(sound()))
def test_a_sound_message_is_taken(kind):
    message = sound()[kind]
    assert decode(encode(message)) == message


@pytest.mark.parametrize(
    ("kind", "change", "reason"),
    [
        ("rows", {"v": PROTOCOL - 1}, "version"),
        ("rows", {"v": "new"}, "malformed"),
        ("rows", {"seq": 0}, "malformed"),
        ("rows", {"drive": b"123"}, "malformed"),
        ("rows", {"what": [-1], "seen": pack([0.0], [1], [0])}, "malformed"),
        ("rows", {"what": [], "seen": pack([0.0], [1], [0])}, "malformed"),
        ("rows", {"robot": "../r2"}, "malformed"),
        ("rows", {"robot": "r" * 65}, "malformed"),
        ("rows", {"more": 1}, "malformed"),
        ("rows", {"type": "shout"}, "malformed"),
        ("status", {"pose": [0.0, 0.0]}, "malformed"),
        ("status", {"pose": [0.0, float("nan"), 0.0]}, "malformed"),
        ("status", {"clock": float("inf")}, "malformed"),
        ("status", {"last": -1}, "malformed"),
        ("snapshot", {"ids": ["7", "8"]}, "malformed"),
        ("snapshot", {"ids": []}, "malformed"),
        ("snapshot", {"counts": []}, "malformed"),
        ("snapshot", {"cov": b""}, "malformed"),
        ("closed", {"seq": 0}, "malformed"),
    ],
)
def test_a_message_that_cannot_be_is_refused_by_its_reason(kind, change, reason):
    fields = msgspec.msgpack.decode(encode(sound()[kind])) | change
    with pytest.raises(RefusedError) as refused:
        decode(msgspec.msgpack.encode(fields))
    assert refused.value.reason == reason


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x00" * 100, b"\x91" * 5000, encode(sound()["rows"])[:-3]])
def test_bytes_that_are_no_message_are_malformed(payload):
    with pytest.raises(RefusedError) as refused:
        decode(payload)
    assert refused.value.reason == "malformed"


def test_a_message_that_is_too_large_is_refused_unread():
    with pytest.raises(RefusedError) as refused:
        decode(b"\x00" * (LARGEST + 1))
    assert refused.value.reason == "oversized"


def test_numbers_that_are_not_finite_and_variances_below_zero_are_refused():
    with pytest.raises(RefusedError, match="finite"):
        unpack(pack([np.nan]), 1)
    with pytest.raises(RefusedError, match="below 0"):
        unpack_triangle(pack_triangle(-np.eye(2)), 2)


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ({"seen": pack([0.0], [1], [0]), "what": [99]}, "an index of 99"),
        ({"drive": pack([5.0, 4.0], [1, 1], [0, 0])}, "step back"),
        ({"names": ["1", "1"]}, "known already"),
    ],
)
def test_rows_that_contradict_what_was_told_before_are_refused(rows, told):
    first = messages(team()[0])[0]
    record = LandmarkRecord.begin(first)
    with pytest.raises(RefusedError, match=told):
        record.add(Rows(robot="r1", run="a", seq=1, **rows))
    assert not record.parts


@pytest.mark.parametrize(
    "message", [Header, Rows, Scans, Radios, Status, Snapshot, Correction, GoalMessage, MapState, Tile]
)
def test_the_page_of_the_protocol_names_every_field_and_which_may_be_left_out(message):
    row = re.search(rf"^\| `{message.__struct_config__.tag}` \| (.*) \|$", PAGE, re.MULTILINE).group(1)
    every = msgspec.structs.fields(message)
    common = {"v", "robot", "run", "seq"} if "seq" in message.__struct_fields__ else {"v"}
    fields = {f.encode_name for f in every} - common
    assert fields <= set(re.findall(r"`(\w+)`", row))
    told = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"\[([^]]*`[^]]*)\]", row)))) & fields
    if message not in {MapState, Tile}:  # those only map processes tell
        assert told == {f.encode_name for f in every if not f.required} & fields


def test_a_scan_is_told_with_the_fields_of_the_page():
    told = PAGE.split("A\nscan has all of these:")[1].split("`ranges` and `light` are bytes")[0]
    assert set(ScanBeams.__struct_fields__) <= set(re.findall(r"`(\w+)`", told))
    assert all(f.required for f in msgspec.structs.fields(ScanBeams))
