"""Position fixes of robots that drive: told with the rest, to the bit; the map lies in the world as `map` lays it."""

from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.live import _final
from mapweave.api.map_options import MapOptions
from mapweave.core.fixes import Fixes
from mapweave.io.range_bags import read_range_bag
from mapweave.live.door import decode
from mapweave.live.fix_stream import FixRecord
from mapweave.live.landmark_stream import LandmarkRecord
from mapweave.live.laser_stream import LaserRecord
from mapweave.live.messages import FixSource, Header, RefusedError, Rows, Scans, encode, pack
from mapweave.live.range_stream import of_robot
from mapweave.live.sources import messages
from mapweave.live.store import Store
from mapweave.sim.laser import DATUM

from .processes import same_result
from .teams import heard, team
from .test_laser_team import drive

SOURCE = FixSource(frame="utm", topic="/fix", antenna=(0.0, 0.0), dropped={})


def fixed(first, last):
    """Fixes beyond either end, several in one moment, some that do not say how sure they are."""
    t = np.sort(np.concatenate([np.linspace(first - 0.4, last + 0.4, 31), np.full(3, 0.5 * (first + last))]))
    place = np.array(DATUM) + 1e-5 * np.random.default_rng(0).standard_normal((len(t), 3))
    cov = np.tile([[0.04, 0.01], [0.01, 0.09]], (len(t), 1, 1))
    cov[5:9] = np.nan
    return Fixes(t, place, cov, np.array([0.3, -0.1]), topic="/gps/fix", dropped={"no fix": 4})


def of_lasers():
    log = drive()
    return replace(log, fixes=fixed(float(log.scan_t[0]), float(log.scan_t[-1])))


def of_landmarks():
    log = team()[0]
    return replace(log, fixes=fixed(*log.span))


def told(logs):
    return {name: [encode(m) for _, m in messages(log, name, "a", 1.0)] for name, log in logs.items()}


@pytest.mark.parametrize("made", [of_lasers, of_landmarks])
def test_fixes_are_the_same_to_the_bit_once_told(made, tmp_path):
    log = made()
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, told({"r1": log}))
        assert not inbox.ledgers["r1"].fault
        again = inbox.log("r1").fixes
    for column in ("t", "place", "cov", "antenna"):
        np.testing.assert_array_equal(getattr(again, column), getattr(log.fixes, column))
    assert (again.frame, again.topic, dict(again.dropped)) == (log.fixes.frame, log.fixes.topic, log.fixes.dropped)


@pytest.mark.drawn
def test_a_ranging_team_with_receivers_lies_in_the_world_as_its_recording_does(tmp_path):
    home = tmp_path / "log"
    mapweave.simulate_team(home, ranges=True, lasers=2, cameras=0, bearings=0, beacons=2, minutes=0.5, fixes=0.5)
    direct = mapweave.map(home, tmp_path / "direct")
    assert direct.georeference is not None
    whole = read_range_bag(home)
    with Store(tmp_path / "s.sqlite", "a map") as store:
        inbox = heard(store, told({name: of_robot(whole, name) for name in whole.odometry}))
        _final(inbox, MapOptions(), print).write(tmp_path / "out")
    same_result(tmp_path / "direct", tmp_path / "out")


def test_fixes_that_were_not_announced_or_step_back_are_refused():
    with pytest.raises(RefusedError, match="announced none"):
        FixRecord(None).add(pack(*7 * [[1.0]]))
    record = FixRecord(SOURCE)
    record.add(pack([2.0, 2.0], *6 * [[1.0, 1.0]]))
    with pytest.raises(RefusedError, match="step back"):
        record.add(pack(*7 * [[1.0]]))
    row = pack(*7 * [[1.0]])
    for begun, message in (
        (LaserRecord(header("laser")), Scans(robot="r1", run="a", seq=1, fixes=row)),
        (LandmarkRecord.begin(header("landmarks")), Rows(robot="r1", run="a", seq=1, fixes=row)),
    ):
        with pytest.raises(RefusedError, match="announced none"):
            begun.add(message)


def header(sensor, **other):
    return Header(robot="r1", run="a", sensor=sensor, log_robot="robot1", source="", odometry=True, **other)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (Rows(robot="r1", run="a", seq=1, fixes=pack([1.0], [np.nan], *5 * [[0.0]])), "not finite"),
        (Scans(robot="r1", run="a", seq=1, fixes=pack([1.0], [1e12], *5 * [[0.0]])), "a place of"),
        (Scans(robot="r1", run="a", seq=1, fixes=pack([1.0], *3 * [[0.0]], [1e20], *2 * [[0.0]])), "a variance of"),
        (header("laser", fixes=FixSource(frame="", topic="", antenna=(1.0,), dropped={})), "two numbers of an antenna"),
        (header("laser", fixes=FixSource(frame="", topic="", antenna=(0, 0), dropped={"a": -1})), "counts from 0"),
    ],
)
def test_fixes_that_no_receiver_gives_do_not_come_in(message, reason):
    with pytest.raises(RefusedError, match=reason):
        decode(encode(message))


def test_what_a_gyroscope_tells_of_a_scan_is_told():
    log = drive()
    scans = tuple(replace(scan, heading=0.01 * k if k % 3 else None) for k, scan in enumerate(log.scans))
    told = [decode(encode(message)) for _, message in messages(replace(log, scans=scans), "r1", "a", 1.0)]
    again = [beams.heading for message in told if isinstance(message, Scans) for beams in message.scans]
    assert again == [scan.heading for scan in scans]
