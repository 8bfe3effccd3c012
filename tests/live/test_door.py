"""What is read at the door: numbers that no robot tells are refused, each with its reason, and honest ones are not."""

import zlib
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from mapweave.api.simulate import simulate_laser
from mapweave.core.findings import Unused
from mapweave.live.door import JUMP, LONGEST, MOST_BEAMS, MOST_MESSAGES, decode
from mapweave.live.landmark_stream import LandmarkRecord
from mapweave.live.laser_stream import LaserRecord, messages_of_laser
from mapweave.live.messages import (
    Closed,
    Header,
    RefusedError,
    Rows,
    Scans,
    Snapshot,
    Status,
    encode,
    pack,
    pack_triangle,
)
from mapweave.sim.laser_worlds import CorridorConfig

LOG = replace(simulate_laser(world=CorridorConfig(distance=2.0), seed=1).log, robot="robot1")
TOLD = [m for _, m in messages_of_laser(LOG, "r1", "a", 1.0)]
LEFT = Unused("a.mcap", "/tf", "tf2_msgs/msg/TFMessage", 3, "no reader for this type").row()
HUGE = [1e300, -1e300, 1e15, 1e308]


def changed(message, **fields):
    return msgspec.structs.replace(message, **fields)


def of_scan(**fields):
    first = TOLD[1]
    return changed(first, scans=[changed(first.scans[0], **fields), *first.scans[1:]])


def column(n, value):
    return b"d" + zlib.compress(np.full(n, value).tobytes())


STATUS = Status(
    robot="r1", run="a", sensor="laser", last=0, clock=1.0, t=0.0, pose=(0.0, 0.0, 0.0), cov=(1.0, 0, 0, 1.0, 0, 1.0)
)
SNAPSHOT = Snapshot(
    robot="r1", run="a", last=1, t=0.0, pose=(0.0, 0.0, 0.0), ids=["7"], mean=pack([1.0], [2.0]),
    cov=pack_triangle(np.eye(5)), counts=[3],
)  # fmt: skip
NOT_POSITIVE = np.eye(5) - 2.0 * np.eye(5, k=3) - 2.0 * np.eye(5, k=-3)
N = TOLD[1].scans[0].n

REFUSED = {
    "a number beyond 63 bits": (Closed(robot="r1", run="a", seq=2**63), "malformed"),
    "a number nobody comes to": (Closed(robot="r1", run="a", seq=MOST_MESSAGES + 1), "malformed"),
    "a status of a number beyond 63 bits": (changed(STATUS, last=2**63), "malformed"),
    "a covariance that is none": (changed(STATUS, cov=(1.0, 2.0, 0, 1.0, 0, 1.0)), "implausible"),
    "a variance below 0": (changed(STATUS, cov=(-1.0, 0, 0, 1.0, 0, 1.0)), "implausible"),
    "a clock of no time": (changed(STATUS, clock=1e16), "implausible"),
    "a joint covariance that is none": (changed(SNAPSHOT, cov=pack_triangle(NOT_POSITIVE)), "implausible"),
    "a misread stamp that is none": (changed(TOLD[0], misread=pack([float("nan")])), "malformed"),
    "a header's counts below 0": (changed(TOLD[0], dropped={"rows": -1}), "malformed"),
    "what was not used, counted below 0": (changed(TOLD[0], unused=[{**LEFT, "messages": -1}]), "malformed"),
    "what was not used, in a megabyte": (changed(TOLD[0], unused=[{**LEFT, "topic": "a" * 5000}]), "oversized"),
    "more that was not used than can be": (changed(TOLD[0], unused=[{**LEFT, "messages": 1 << 60}]), "implausible"),
    "a run of a megabyte": (changed(STATUS, run="a" * 5000), "oversized"),
    "more beams than a scanner has": (of_scan(n=MOST_BEAMS + 1), "oversized"),
    "marks of other beams": (of_scan(hit=b""), "malformed"),
    "beams that all point one way": (of_scan(angle_increment=0.0), "implausible"),
    "an angle of no circle": (of_scan(angle_min=1e15), "implausible"),
    "a stamp of no time": (of_scan(t=1e300), "implausible"),
    "a column of NaN": (of_scan(ranges=column(N, np.nan)), "malformed"),
    "scans that unpack to gigabytes": (
        changed(TOLD[1], scans=[changed(TOLD[1].scans[0], n=MOST_BEAMS)] * 60), "oversized"),
    **{f"a mean of {x:g}": (changed(SNAPSHOT, mean=pack([x], [0.0])), "implausible") for x in HUGE},
    **{f"a pose of {x:g}": (changed(STATUS, pose=(x, 0.0, 0.0)), "implausible") for x in HUGE},
    **{f"odometry of {x:g}": (of_scan(odometry=(x, 0.0, 0.0)), "implausible") for x in HUGE},
    **{f"a mount of {x:g}": (of_scan(mount=(0.0, x, 0.0)), "implausible") for x in HUGE},
    "ranges of no sensor": (of_scan(ranges=column(N, 1e300)), "implausible"),
    **{f"a track of {x:g}": (changed(TOLD[1], track=pack([0.0], [x], [0.0], [0.0])), "implausible") for x in HUGE},
    "a drive of no sensor": (Rows(robot="r1", run="a", seq=1, drive=pack([0.0], [1e300], [0.0])), "implausible"),
}  # fmt: skip


@pytest.mark.parametrize("what", sorted(REFUSED))
def test_what_no_robot_tells_is_refused_with_its_reason(what):
    message, reason = REFUSED[what]
    with pytest.raises(RefusedError) as refused:
        decode(encode(message))
    assert refused.value.reason == reason


@pytest.mark.parametrize("message", [*TOLD, STATUS, SNAPSHOT], ids=lambda m: type(m).__name__)
def test_what_honest_robots_tell_is_taken(message):
    assert decode(encode(message)) == message


def begun(message):
    record = LaserRecord(TOLD[0])
    record.add(TOLD[1])
    record.add(message)


def moved(message, far, seconds=0.0):
    """`message` from so many metres and seconds on."""
    scans = [changed(s, t=s.t + seconds, odometry=(s.odometry[0] + far, *s.odometry[1:])) for s in message.scans]
    return changed(message, scans=scans, track=b"")


def test_odometry_may_be_set_back_and_may_not_step_farther_than_robots_do():
    begun(moved(TOLD[2], 0.9 * JUMP))
    with pytest.raises(RefusedError, match="odometry that steps 1e\\+04 m in"):
        begun(moved(TOLD[2], 1e4))
    begun(moved(TOLD[2], 1e4, seconds=200.0))  # it may have driven there meanwhile


def test_a_history_is_no_longer_than_a_month():
    begun(moved(TOLD[2], 0.0, seconds=0.9 * LONGEST))
    with pytest.raises(RefusedError, match="after the first one"):
        begun(moved(TOLD[2], 0.0, seconds=1.1 * LONGEST))
    header = Header(robot="r1", run="a", sensor="landmarks", log_robot="robot1", source="s", odometry=True)
    record = LandmarkRecord.begin(header)
    record.add(Rows(robot="r1", run="a", seq=1, drive=pack([5.0], [1.0], [0.0])))
    with pytest.raises(RefusedError, match="after the first one"):
        record.add(Rows(robot="r1", run="a", seq=2, drive=pack([5.0 + 2 * LONGEST], [1.0], [0.0])))


def test_a_whole_log_at_once_is_split_before_it_is_too_much_for_the_door():
    scans = tuple(replace(LOG.scans[0], ranges=np.ones(20_000), hit=np.ones(20_000, bool), intensities=None,
                          angle_increment=1e-4) for _ in LOG.scans)  # fmt: skip
    log = replace(LOG, scans=scans)
    packets = [decode(encode(m)) for _, m in messages_of_laser(log, "r1", "a", 1e6)]
    assert sum(len(m.scans) for m in packets if isinstance(m, Scans)) == len(scans)
