"""The page in a real browser: 50 robots, whatever words the decisions hold."""

import json
import re
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
import zlib

import matplotlib.pyplot as plt
import msgspec
import numpy as np
import pytest

from mapweave.core.errors import UsageError
from mapweave.io.web import is_named
from mapweave.live.messages import LandmarkState, MapState, RobotState, Tile
from mapweave.live.tiles import SIDE, pack
from mapweave.live.told import MOST_MAPS
from mapweave.live.view import KEPT_FRAMES, MOST_TRAILS, PAGE, Board, served
from mapweave.report.html import Page
from mapweave.report.style import PALETTE

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def state(n=50, name="map", x=0.0):
    robots = [
        RobotState(
            robot=f"r{k}", run="a", log_robot=f"robot{k}", sensor="landmarks", there=k != 3, finished=False, have=10,
            last=9 if k != 4 else 19, rate=1.0, pose=(x + 0.5 * k, 0.1 * k, 0.3), cov=(0.04, 0.0, 0.0, 0.01, 0.0, 0.01),
            component=1, landmarks=5, offset=5.0 if k == 2 else 0.01, offset_error=0.01,
        )
        for k in range(1, n + 1)
    ]  # fmt: skip
    landmarks = [LandmarkState(id=str(k), x=float(k), y=3.0, cov=(0.1, 0.02, 0.2), component=1) for k in range(20)]
    decisions = ["r1: reference", "<img src=x onerror=alert(1)>"]
    return MapState(map=name, clock=0.0, fused=3, robots=robots, landmarks=landmarks, decisions=decisions)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the page is not opened in a browser")
def test_fifty_robots_stand_on_the_page_and_words_stay_words(tmp_path):
    board = Board()
    board.take(state())
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}", "--window-size=1200,700",
        "--virtual-time-budget=3000", f"--screenshot={tmp_path / 'page.png'}", "--dump-dom",
    ]  # fmt: skip
    with served(board, "127.0.0.1", 0) as address:
        browser = subprocess.Popen([*command, address], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)  # noqa: S603
        end = time.monotonic() + 240  # of a machine that does much else
        while not board.readers and time.monotonic() < end:
            time.sleep(0.1)
    page = browser.communicate(timeout=240)[0]  # drawn once nothing is under way any more
    rows = re.findall(r"<tr.*?</tr>", page.split('id="robots"')[1].split("</tbody>")[0])
    assert len(rows) == 50
    assert "gone" in rows[2]
    assert "10, 10 missing" in rows[3]
    assert ">5.0<" in rows[1]
    assert "&lt;img src=x" in page
    assert "<img" not in page
    assert (tmp_path / "page.png").stat().st_size > 20_000  # an empty page is a tenth of that


def test_events_bring_every_state_and_late_browsers_get_the_trails():
    board = Board()
    board.take(state(2))
    board.take(state(2, x=1.0))
    with served(board, "127.0.0.1", 0) as address, urllib.request.urlopen(f"{address}events", timeout=10) as page:  # noqa: S310
        first = page.readline()
        assert first.startswith(b'data: {"states":[{"type":"map"')
        assert b'"map/r1":[[0.5,0.1,1,0],[1.5,0.1,1,0]]' in first
        page.readline()
        board.take(state(1, "other"))
        later = page.readline()
        assert b'"map":"other"' in later
        assert b'"steps":{"other/r1":[[0.5,0.1,1,0]]}' in later


def test_a_trail_begins_anew_where_the_map_was_corrected():
    """A robot that stands 1 m along its own x drives on by 0.2 m, and meanwhile its frame is turned by a quarter."""
    board = Board()
    seen = state(1).robots[0]
    for frame, pose in (((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), ((0.0, 0.0, np.pi / 2), (0.0, 1.2, np.pi / 2))):
        robot = msgspec.structs.replace(seen, frame=frame, pose=pose)
        board.take(msgspec.structs.replace(state(1), robots=[robot]))
    trail = msgspec.json.decode(board.all()[1])["trails"]["map/r1"]
    np.testing.assert_allclose(trail, [[1, 0, 1, 0], [0, 1, 1, 1], [0, 1.2, 1, 1]], atol=1e-12)


def square(value, i=0):
    cells = np.full((SIDE, SIDE), value, np.uint8)
    return Tile(map="map", component=1, level=0, i=i, j=0, cell=0.05, cells=pack(cells))


def test_a_square_of_the_map_is_named_in_an_event_and_fetched_on_its_own():
    board = Board()
    board.take(state(1))
    board.take_tile(square(255))
    board.take_tile(square(1, i=-1))
    with served(board, "127.0.0.1", 0) as address, urllib.request.urlopen(f"{address}events", timeout=10) as page:  # noqa: S310
        assert b'"tiles":{"map/1/0/0/0":[2,0.05],"map/1/0/-1/0":[3,0.05]}' in page.readline()
        page.readline()
        board.take_tile(msgspec.structs.replace(square(1), cells=b""))
        assert b'"tiles":{"map/1/0/0/0":null}' in page.readline()
        with urllib.request.urlopen(f"{address}tile/map/1/0/-1/0", timeout=10) as answer:  # noqa: S310
            assert answer.headers["Content-Encoding"] == "deflate"
            assert zlib.decompress(answer.read()) == bytes([1]) * SIDE * SIDE
        for gone in ("map/1/0/0/0", "map/9/0/0/0", "../view.py"):
            with pytest.raises(urllib.error.HTTPError):
                urllib.request.urlopen(f"{address}tile/{gone}", timeout=10)  # noqa: S310


WALL, FREE = (0x24, 0x29, 0x2F), (255, 255, 255)


def browse(folder):
    """The command that takes a picture of a page."""
    return [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder}", "--window-size=1000,500",
        "--virtual-time-budget=3000", f"--screenshot={folder / 'page.png'}",
    ]  # fmt: skip


def picture(board, folder, squares):
    """The page is drawn, after it has fetched so many squares; one that does not is opened again."""
    with served(board, "127.0.0.1", 0) as address:
        for _ in range(4):
            browser = subprocess.Popen([*browse(folder), address], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # noqa: S603
            end = time.monotonic() + 60  # of a machine that does much else
            while board.fetched < squares and time.monotonic() < end:
                time.sleep(0.1)
            if board.fetched >= squares:
                break
            browser.kill()
            browser.wait()
    browser.wait(240)


def drawn_in(path, colour):
    """Where the picture has that colour; the panel beside the map left out."""
    return (np.rint(255 * plt.imread(path)[:, :520, :3]).astype(int) == colour).all(axis=2)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the page is not opened in a browser")
def test_walls_are_drawn_dark_and_free_floor_bright(tmp_path):
    board = Board()
    board.take(state(1))
    board.take_tile(square(255))
    board.take_tile(square(1, i=-1))
    picture(board, tmp_path, squares=2)
    wall, free = (int(drawn_in(tmp_path / "page.png", colour).sum()) for colour in (WALL, FREE))
    assert wall > 10_000
    assert abs(wall - free) < 0.2 * wall


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the page is not opened in a browser")
def test_what_was_seen_fills_the_page_wherever_it_lies_in_its_square(tmp_path):
    board = Board()
    told = state(1)
    told = msgspec.structs.replace(
        told, landmarks=[], robots=[msgspec.structs.replace(told.robots[0], pose=(1.6, 1.6, 0.0))]
    )
    board.take(told)
    cells = np.zeros((SIDE, SIDE), np.uint8)
    cells[20:44, 20:44] = 255  # a fifth of the side of the square
    board.take_tile(msgspec.structs.replace(square(0), cells=pack(cells)))
    picture(board, tmp_path, squares=1)
    wall = drawn_in(tmp_path / "page.png", WALL)
    high = np.flatnonzero(wall.any(axis=1))
    assert np.ptp(high) > 0.75 * len(wall)


def test_anything_but_the_page_is_not_found_and_the_page_may_ask_nobody_else():
    with served(Board(), "127.0.0.1", 0) as address:
        with pytest.raises(urllib.error.HTTPError) as missing:
            urllib.request.urlopen(f"{address}../etc/passwd", timeout=10)  # noqa: S310
        assert missing.value.code == 404
        with urllib.request.urlopen(address, timeout=10) as page:  # noqa: S310
            assert page.headers["Content-Security-Policy"].startswith("default-src 'none'")
            assert not re.search(rb"https?://", page.read())


def asked(address, **headers):
    request = urllib.request.Request(address, headers=headers)  # noqa: S310
    with urllib.request.urlopen(request, timeout=10) as answer:  # noqa: S310
        return answer


@pytest.mark.parametrize(
    ("host", "meant"),
    [
        ("127.0.0.1:8642", True), ("localhost:8642", True), ("[::1]:8642", True), ("192.168.1.7", True),
        (socket.gethostname(), True), ("evil.example:8642", False), ("127.0.0.1.evil.example", False), ("", False),
    ],
)  # fmt: skip
def test_a_name_that_somebody_else_made_to_lead_here_is_refused(host, meant):
    assert is_named(host, "127.0.0.1") == meant
    with served(Board(), "127.0.0.1", 0) as address:
        if meant:
            assert asked(address, Host=host).status == 200
        else:
            with pytest.raises(urllib.error.HTTPError) as refused:
                asked(f"{address}state.json", Host=host or "no-name.example")
            assert refused.value.code == 421


def test_every_answer_says_what_it_is_and_that_nobody_may_frame_it():
    with served(Board(), "127.0.0.1", 0) as address:
        for path in ("", "state.json"):
            headers = asked(address + path).headers
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]


def test_what_is_told_is_put_in_words_once_for_all_readers():
    board = Board()
    board.take(state(3))
    number, whole = board.all()
    assert all(board.all()[1] is whole for _ in range(5))
    board.take(state(3, x=1.0))
    told = [board.after(number, 5.0) for _ in range(100)]
    assert board.encoded == 2
    assert all(data is told[0][1] for _, data in told)
    assert "steps" in msgspec.json.decode(told[0][1])
    assert board.after(told[0][0], 0.0) == (told[0][0], None)


def test_a_reader_that_is_far_behind_gets_everything(monkeypatch):
    monkeypatch.setattr("mapweave.live.view.FRAME", 0.0)
    board = Board()
    board.take(state(3))
    first, _ = board.all()
    for k in range(KEPT_FRAMES + 5):
        board.take(state(3, x=float(k)))
        board.after(first + k, 1.0)
    _, frame = board.after(first + 10, 1.0)
    assert "steps" in msgspec.json.decode(frame)
    number, frame = board.after(first, 1.0)
    assert "trails" in msgspec.json.decode(frame)
    assert number == first + KEPT_FRAMES + 5


def test_invented_maps_robots_and_squares_take_no_more_than_their_room(monkeypatch):
    monkeypatch.setattr("mapweave.live.told.MOST_TILE_BYTES", 100_000)
    board = Board()
    for k in range(40):
        board.take(state(20, name=f"map{k}"))
        for i in range(40):
            cells = pack(np.full((SIDE, SIDE), 1 + i, np.uint8))
            board.take_tile(Tile(map=f"map{k}", component=1, level=0, i=i, j=0, cell=0.05, cells=cells))
    assert len(board.states) == MOST_MAPS
    assert "map39" in board.states
    assert len(board._trails) == MOST_TRAILS
    assert board._squares._size <= 100_000
    assert board.let_go > 0


def test_a_port_in_use_is_told_in_one_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with (
            pytest.raises(UsageError, match=f"--port {port}: Address already in use"),
            served(Board(), "127.0.0.1", port),
        ):
            pass
    with pytest.raises(UsageError, match="0 to 65535"), served(Board(), "127.0.0.1", 70000):
        pass


def test_robots_have_the_colours_that_reports_give_them():
    told = re.search(r"const COLOURS = (\[.*?\]);", PAGE)
    assert told is not None
    assert tuple(json.loads(told[1])) == PALETTE
    shades = [re.findall(r"--(free|wall|unseen): ?(#\w{6})", page) for page in (PAGE, Page("").html())]
    assert len(shades[0]) == 6, "by day and by night"
    assert shades[0] == shades[1]
