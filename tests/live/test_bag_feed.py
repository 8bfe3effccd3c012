"""A recording followed while it is written, cut off, and closed: every scan is told once, in its order."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import mapweave
from mapweave.core.errors import UsageError
from mapweave.io.mcap import write_mcap
from mapweave.live.messages import Closed, Header, Scans
from mapweave.live.sources import BagFeed, open_recording
from mapweave.live.transport import Network
from mapweave.sim.laser_worlds import CorridorConfig, simulate_corridor


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive, and the bytes of its recording."""
    drive = simulate_corridor(CorridorConfig(distance=3.0), seed=2).log
    path = tmp_path_factory.mktemp("whole") / "drive.mcap"
    write_mcap(path, drive)
    return drive, path.read_bytes()


def feed_of(path, said, stop=None):
    read = lambda at: open_recording(at, "r1", None)
    feed = BagFeed(path, read, "r1", "run", 0.2, stop or threading.Event(), said.append)
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
    thread.join(120.0)
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
