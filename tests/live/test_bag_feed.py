"""A recording followed while it is written, cut off, and closed: every scan is told once, in its order.

What is told makes the map that `map` makes of the recording, whatever shows in the whole of it alone.
"""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.api.live import _final
from mapweave.api.map_options import MapOptions
from mapweave.core.errors import ReaderError, UsageError
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.mcap import write_mcap
from mapweave.io.range_bags import read_range_bag
from mapweave.live.door import decode
from mapweave.live.fix_stream import fix_columns
from mapweave.live.laser_stream import LaserRecord, messages_of_laser, scans_told
from mapweave.live.messages import Closed, Header, RefusedError, Scans, encode, unpack
from mapweave.live.range_stream import RangeRecord, of_robot, ranges_told
from mapweave.live.sources import BagFeed, open_recording
from mapweave.live.store import Store
from mapweave.live.transport import Network
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor

from ..io.made_spins import spin_bag, truth_of
from ..io.ros_logs import usual
from .processes import same_result
from .teams import heard


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive, and the bytes of its recording."""
    drive = simulate_corridor(CorridorConfig(distance=3.0), seed=2).log
    path = tmp_path_factory.mktemp("whole") / "drive.mcap"
    write_mcap(path, drive)
    return drive, path.read_bytes()


def feed_of(path, said, stop=None, fixes=None, name="r1"):
    read = lambda at: open_recording(at, name, None, fixes)
    feed = BagFeed(path, read, name, "run", 0.2, stop or threading.Event(), said.append)
    feed.resume([])
    return feed


def stamps(messages):
    return [b.t for m in messages if isinstance(m, Scans) for b in m.scans]


def taken(feed, until):
    """What comes until `until` says that it is enough, within a minute."""
    out, end = [], time.monotonic() + 60.0
    while not until(out) and time.monotonic() < end:
        out += feed.take(0.01)
    return out


def grown(path, whole, shares, fixes=None, name="r1"):
    """What a feed tells of a recording of these bytes that grows; and how many messages before it is closed."""
    path.parent.mkdir(exist_ok=True)
    feed = feed_of(path, [], fixes=fixes, name=name)
    told = []
    for share in shares:
        path.write_bytes(whole[: int(share * len(whole))])
        told += taken(feed, lambda _: feed._size == path.stat().st_size)
        feed._due = 0.0
    path.write_bytes(whole)
    taken(feed, lambda _: feed.ended.is_set())
    return [*told, *feed.close()], len(told)


def headers(messages):
    return [k for k, message in enumerate(messages) if isinstance(message, Header)]


def mapped(folder, **messages):
    """The result of a map process that heard these messages."""
    with Store(folder / "s.sqlite", "a map") as store:
        inbox = heard(store, {name: [encode(message) for message in each] for name, each in messages.items()})
        assert all(ledger.complete and not ledger.fault for ledger in inbox.ledgers.values())
        _final(inbox, MapOptions(), print).write(folder / "out")
    return folder / "out"


def test_every_scan_of_a_recording_that_grows_is_told_once_until_it_is_closed(tmp_path, recording):
    drive, whole = recording
    path, said = tmp_path / "drive.mcap", []
    feed = feed_of(path, said)
    assert feed.take(0.0) == []
    told = []
    for share in (0.0, 0.4, 0.8):
        path.write_bytes(whole[: max(4, int(share * len(whole)))])
        told += taken(feed, lambda out, share=share: feed._size == path.stat().st_size or (share == 0.0 and said))
        assert not feed.ended.is_set()
    early = len(stamps(told))
    path.write_bytes(whole)
    told += taken(feed, lambda _: feed.ended.is_set())
    told += feed.close()
    assert isinstance(told[0], Header)
    assert isinstance(told[-1], Closed)
    assert stamps(told) == drive.scan_t.tolist()
    assert 0 < early < len(drive.scans)
    assert said == [f"r1: waits for {path}, which is no recording yet"]


def test_one_that_is_cut_off_is_waited_for_and_gives_what_is_readable_when_it_is_stopped(tmp_path, recording):
    drive, whole = recording
    path, said, stop = tmp_path / "drive.mcap", [], threading.Event()
    path.write_bytes(whole[: len(whole) * 6 // 10])
    feed = feed_of(path, said, stop)
    told = taken(feed, lambda _: feed._size >= 0)
    assert not feed.ended.is_set()
    feed._grown -= 60.0
    feed._due = 0.0
    feed.take(0.0)
    assert any("has not grown for 30 s" in words for words in said)
    stop.set()
    told += feed.take(0.0)
    assert feed.ended.is_set()
    told += feed.close()
    n = len(stamps(told))
    assert 0 < n < len(drive.scans)
    assert stamps(told) == drive.scan_t[:n].tolist()


def test_a_robot_driven_by_a_recording_ends_when_that_is_closed(tmp_path, recording):
    whole, path, said = recording[1], tmp_path / "drive.mcap", []
    options = {"network": Network(listen=("tcp/127.0.0.1:0",)), "linger": 0.0, "history": tmp_path / "r1.sqlite"}
    done = []
    thread = threading.Thread(
        target=lambda: done.append(mapweave.live_robot("r1", path, follow=True, say=said.append, **options))
    )
    thread.start()
    for part in np.array_split(np.arange(len(whole)), 4):
        with path.open("ab") as file:
            file.write(whole[part[0] : part[-1] + 1])
        time.sleep(0.3)
    thread.join(600.0)  # the first to be driven compiles what it needs
    assert not thread.is_alive()
    again = mapweave.live_robot(
        "r1", path, follow=True, say=said.append, stop=threading.Event(), **options | {"fresh": True}
    )
    assert done[0].messages == again.messages > 2
    assert any("follows" in words for words in said)
    with pytest.raises(UsageError, match="--follow: a recording that is still written has neither --rate"):
        mapweave.live_robot("r1", path, follow=True, rate=2.0, **options)


def test_the_time_that_a_scan_takes_is_told_of_a_recording_that_grows(tmp_path, recording):
    path = tmp_path / "swept.mcap"
    write_mcap(path, replace(recording[0], sweep=0.08))
    told = feed_of(path, []).close()
    assert told[0].sweep == pytest.approx(open_recording(path, "r1", None).sweep) == pytest.approx(0.08)


def test_a_recording_with_fixes_gives_the_map_of_the_whole_whatever_they_are_like(tmp_path):
    """Fixes that jump and that are no numbers among them, from before the first scan on until after the last."""
    drive = mapweave.simulate_laser(world=CorridorConfig(distance=6.0), seed=2, fixes=0.1).log
    place, first = drive.fixes.place.copy(), drive.fixes.t[0]
    place[4] = np.nan
    place[5:7, 0] += 0.01
    log = replace(drive, fixes=replace(drive.fixes, place=place))
    path = tmp_path / "growing" / "drive.mcap"
    write_mcap(tmp_path / "drive.mcap", log)
    told, early = grown(path, (tmp_path / "drive.mcap").read_bytes(), (0.3, 0.6, 0.9))
    assert [m.seq for m in told] == list(range(len(told)))
    assert headers(told) == [0, len(told) - 2]  # what reading found is told at the end, and no scan twice
    again = np.concatenate([unpack(m.fixes, 7) for m in told if isinstance(m, Scans)], axis=1)
    np.testing.assert_array_equal(again, fix_columns(read_laser(path).fixes))
    before = np.concatenate([unpack(m.fixes, 7)[0] for m in told[:early] if isinstance(m, Scans)])
    assert before[0] == pytest.approx(first)
    assert len(before) > 2
    assert told[-2].fixes.dropped == {"fix that is no number": 1}
    mapweave.map(path, tmp_path / "direct")
    same_result(tmp_path / "direct", mapped(tmp_path, r1=told))


def test_motion_capture_that_is_named_is_told_and_a_name_of_none_is_one_error_once_it_is_closed(tmp_path):
    out = usual(tmp_path / "a.mcap", 60)
    for k in range(60):
        out.place(10.0 + 0.1 * k, [5.0 + 0.1 * k, 2.0, 0.5])
    whole = out.write().read_bytes()
    path = tmp_path / "growing" / "a.mcap"
    told, _ = grown(path, whole, (0.5,), fixes="/mocap/pose")
    log, read = scans_told(told), read_laser(path, source=LaserSource(fixes="/mocap/pose"))
    np.testing.assert_array_equal(log.fixes.place, read.fixes.place)
    assert (log.fixes.frame, log.fixes.topic) == ("mocap", "/mocap/pose")
    assert log.findings == read.findings
    said = []
    feed = feed_of(path, said, fixes="/moccap")
    taken(feed, lambda _: feed.ended.is_set())
    with pytest.raises(ReaderError, match="--fixes: no topic '/moccap' that tells positions; there are /mocap/pose"):
        feed.close()


def test_headings_of_a_gyroscope_go_on_while_it_is_learned_and_are_those_of_the_whole_at_the_end(tmp_path):
    truth, rate = truth_of(24.0, 1.0)
    whole = spin_bag(tmp_path / "a.mcap", truth, rate, bias=0.05).read_bytes()
    path = tmp_path / "growing" / "a.mcap"
    told, early = grown(path, whole, (0.3, 0.5, 0.7, 0.9))
    log = read_laser(path)
    first, again = headers(told)
    assert first == 0
    assert again >= early  # while it grows nothing is told twice
    live = [b.heading for m in told[:again] if isinstance(m, Scans) for b in m.scans]
    true = np.array([scan.heading for scan in log.scans])
    assert len(live) == len(true)
    assert np.abs(np.diff(live) - np.diff(true)).max() < 0.01
    read = scans_told(told)
    assert [scan.heading for scan in read.scans] == true.tolist()
    assert read.log_hash == log.log_hash
    cut = scans_told(told[:-2])  # what was told anew is used once it is told to the end
    assert [scan.heading for scan in cut.scans] == live
    assert cut.log_hash != log.log_hash


@pytest.mark.slow
def test_a_recording_with_a_gyroscope_gives_the_map_of_the_whole(tmp_path):
    truth, rate = truth_of(24.0, 1.0)
    path = tmp_path / "growing" / "a.mcap"
    told, _ = grown(path, spin_bag(tmp_path / "a.mcap", truth, rate, wheels=1.6).read_bytes(), (0.4, 0.8))
    mapweave.map(path, tmp_path / "direct")
    same_result(tmp_path / "direct", mapped(tmp_path, r1=told))


def test_one_that_was_ended_while_it_told_all_anew_does_so_again(tmp_path):
    truth, rate = truth_of(24.0, 1.0)
    path = tmp_path / "growing" / "a.mcap"
    told, _ = grown(path, spin_bag(tmp_path / "a.mcap", truth, rate, bias=0.05).read_bytes(), (0.4,))
    log = read_laser(path)
    for kept in (told[:1], told[:3], told[: headers(told)[1] + 1], told[: headers(told)[1] + 3]):
        feed = feed_of(path, [])
        feed.resume(kept)
        taken(feed, lambda _, feed=feed: feed.ended.is_set())
        rest = feed.close()
        assert [m.seq for m in rest] == [len(kept) + k for k in range(len(rest))]
        again = scans_told([*kept, *rest])
        assert [scan.heading for scan in again.scans] == [scan.heading for scan in log.scans]
        assert again.log_hash == log.log_hash


def test_light_that_shows_late_is_in_the_map_of_the_whole(tmp_path):
    out = usual(tmp_path / "a.mcap", 60, light=False)
    for k, row in enumerate(out.rows):
        if row[2] == "scan":
            light = 47.0 if k < 60 else 20.0
            row[3].intensities = np.full(len(row[3].ranges), light, np.float32)
    path = tmp_path / "growing" / "a.mcap"
    told, early = grown(path, out.write().read_bytes(), (0.3, 0.7))
    assert all(b.light is None for m in told[:early] if isinstance(m, Scans) for b in m.scans)
    assert scans_told(told).has_intensity


def test_a_header_amid_a_history_is_that_of_its_log(recording):
    first, *rest = (message for _, message in messages_of_laser(recording[0], "r1", "a", 0.5))
    record = LaserRecord(first)
    record.add(rest[0])
    with pytest.raises(RefusedError, match="a header of another log"):
        record.add(Header(robot="r1", run="a", seq=2, sensor="laser", log_robot="robot7", source="", odometry=True))


def test_a_receiver_that_speaks_late_is_in_the_map_of_the_whole(tmp_path):
    out = usual(tmp_path / "a.mcap", 60)
    for k in range(40, 60):
        out.fix(10.0 + 0.1 * k, [35.7 + 1e-6 * k, 139.75, 40.0])
    out.rows.sort(key=lambda row: row[0])
    told, _ = grown(tmp_path / "growing" / "a.mcap", out.write().read_bytes(), (0.3,))
    assert told[0].fixes is None
    assert len(scans_told(told).fixes) == 20


@pytest.fixture(scope="module")
def radios(tmp_path_factory):
    """The bytes of a recording of ranges, with fixes."""
    home = tmp_path_factory.mktemp("radios")
    made = mapweave.simulate_team(
        home / "log", ranges=True, lasers=2, cameras=0, bearings=0, beacons=2, minutes=0.4, fixes=0.5
    )
    assert len(made.robots) == 2
    (path,) = (home / "log").glob("*.mcap")
    return path.read_bytes()


def test_ranges_of_a_recording_that_grows_are_told_as_they_come_and_give_the_map_of_the_whole(tmp_path, radios):
    path = tmp_path / "growing" / "radios.mcap"
    told, early = {}, {}
    for name in ("r1", "r2"):
        path.unlink(missing_ok=True)
        told[name], early[name] = grown(path, radios, (0.2, 0.5, 0.8), name=name)
    for name, each in told.items():
        assert [m.seq for m in each] == list(range(len(each)))
        assert headers(each) == [0, len(each) - 2]  # nothing is told twice
        assert sum(unpack(m.told, 2).shape[1] for m in each[1 : early[name]]) > 100
    mapweave.map(path, tmp_path / "direct")
    same_result(tmp_path / "direct", mapped(tmp_path, **told))


def test_ranges_told_by_other_names_than_the_whole_has_are_told_anew(tmp_path, radios):
    """A second robot is in the recording late: the first told of its radio as of a beacon's."""
    log = read_range_bag_of(tmp_path, radios)
    late = replace(log, odometry={k: v for k, v in log.odometry.items() if k == "robot1"})
    logs = iter([late.until(log.span[0] + 10.0), log])
    stop = threading.Event()
    path = tmp_path / "a.mcap"
    path.write_bytes(radios[:-20])
    feed = BagFeed(path, lambda _: of_robot(next(logs), "robot1"), "r1", "run", 0.5, stop, print)
    feed.resume([])
    told = feed.take(0.0)
    assert len(told) > 5
    stop.set()
    told += feed.close()
    assert len(headers(told)) == 2
    again, own = ranges_told(told), of_robot(log, "robot1")
    assert (again.names, again.others, again.log_hash) == (own.names, own.others, own.log_hash)
    assert len(again.z) == len(own.z)
    kept = told[: headers(told)[1] + 2]
    assert ranges_told(kept).others == ()  # until it is told to the end
    for resumed in (kept, told[:5]):
        feed = BagFeed(path, lambda _: of_robot(log, "robot1"), "r1", "run", 0.5, stop, print)
        feed.resume(resumed)
        rest = feed.close()
        assert [m.seq for m in rest] == [len(resumed) + k for k in range(len(rest))]
        np.testing.assert_array_equal(ranges_told([*resumed, *rest]).z, again.z)


def read_range_bag_of(folder, data):
    (folder / "whole.mcap").write_bytes(data)
    return read_range_bag(folder / "whole.mcap")


def test_a_robot_driven_by_a_recording_of_ranges_says_so_of_its_history(tmp_path, radios):
    (tmp_path / "a.mcap").write_bytes(radios)
    options = {"network": Network(listen=("tcp/127.0.0.1:0",)), "linger": 0.0, "history": tmp_path / "r1.sqlite"}
    drive = lambda: mapweave.live_robot("r1", tmp_path / "a.mcap", follow=True, say=lambda _: None, **options)
    done = drive()
    with Store(tmp_path / "r1.sqlite", "robot r1 of team team") as store:
        assert store.about("sensor") == "ranges"
        kept = [decode(payload) for _, payload in store.get("r1", 0, 1 << 30)]
    assert done.messages == len(kept)
    assert len(ranges_told(kept).z) > 300
    with pytest.raises(UsageError, match="this drive has ended"):
        drive()


def test_a_robot_that_is_in_no_recording_yet_is_waited_for_and_an_error_once_that_is_closed(tmp_path, radios):
    path, said = tmp_path / "a.mcap", []
    path.write_bytes(radios[:-20])
    feed = feed_of(path, said, name="r7")
    assert taken(feed, lambda _: said) == []
    assert "waits: --robot: which robot is r7?" in said[0]
    feed._due = 0.0
    path.write_bytes(radios)
    taken(feed, lambda _: feed.ended.is_set())
    with pytest.raises(UsageError, match=r"which robot is r7.* holds 1, 2"):
        feed.close()


def test_a_header_amid_ranges_is_that_of_its_log_and_of_its_names():
    words = {"robot": "r1", "run": "a", "sensor": "ranges", "source": "", "odometry": True}
    record = RangeRecord(Header(**words, log_robot="a1", names=["a1", "b"]))
    with pytest.raises(RefusedError, match="a header of another log"):
        record.add(Header(**words, seq=1, log_robot="b", names=["a1", "b"]))
    record.add(Header(**words, seq=1, log_robot="a1", names=["a1", "c", "b"]))
    with pytest.raises(RefusedError, match="names are not those that ranges were told by"):
        record.add(Closed(robot="r1", run="a", seq=2))


def test_radios_are_of_recordings_of_ranges_alone(recording, tmp_path):
    (tmp_path / "a.mcap").write_bytes(recording[1])
    with pytest.raises(UsageError, match="--radios: only for recordings of ranges, found"):
        open_recording(tmp_path / "a.mcap", "r1", None, None, {"n_1": "robot1"})
