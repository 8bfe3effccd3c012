"""The shared map in a browser: one page, fed by server-sent events; nothing is asked of the page's network."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from io import BufferedIOBase
from pathlib import Path
from threading import Condition
from time import monotonic

import msgspec
import numpy as np
from jaxtyping import Float

from ..core import se2
from ..io.web import Answer, Asked, served_pages, viewport
from .messages import MapState, RobotState, Tile
from .told import MOST_MAPS, Squares

PAGE = Path(__file__).with_name("page.html").read_text(encoding="utf-8").replace("/* viewport */", viewport())
POINTS = 4000  # of each robot's trail, for browsers that come late
STEP = 0.05  # [m] from point to point of a trail
SILENCE = 10.0  # [s] after which a browser is told that nothing came, so that one that left is noticed
FRAME = 0.1  # [s] from one to the next at least: what comes meanwhile goes together
KEPT_FRAMES = 50  # a reader that is farther behind begins anew
MOST_TRAILS = 512  # of robots of all maps, likewise
CORRECTED = 0.3  # [m] by which a correction has to move a robot for its trail to begin anew from there
Pose = Float[np.ndarray, "3"]
Point = tuple[float, float, int, int]  # x, y [m], component, stretch: no line is drawn from one stretch to the next


class Board:
    """The newest state of every map process, where its robots were, its map. readers: browsers that follow it.

    What browsers are told is put in words once, in frames that all of them get, however many there are. fetched:
    squares of the map that browsers have asked for; encoded: frames so far; let_go: maps, trails, squares without
    room.
    """

    def __init__(self) -> None:
        self.version = 0
        self.readers = 0
        self.fetched = self.encoded = self._let_go = 0
        self.closed = False
        self.states: dict[str, MapState] = {}
        self._trails: dict[str, list[tuple[int, Point]]] = {}  # with the version that brought each point
        self._frames: dict[str, Pose] = {}
        self._fresh: dict[str, int] = {}
        self._squares = Squares()
        self._number, self._framed, self._due = 0, 0, float("-inf")
        self._recent: deque[bytes] = deque(maxlen=KEPT_FRAMES)  # the newest frames, number `_number` the last
        self._whole: tuple[int, bytes] | None = None  # everything, as of the frame of that number
        self._changed = Condition()

    @property
    def let_go(self) -> int:
        return self._let_go + self._squares.let_go

    def take(self, state: MapState) -> None:
        """What a map process says now; who waits is woken."""
        with self._changed:
            self.version += 1
            if state.map not in self.states and len(self.states) >= MOST_MAPS:
                silent = min(self._fresh, key=self._fresh.__getitem__)
                del self.states[silent], self._fresh[silent]
                self._let_go += 1
            self.states[state.map] = state
            self._fresh[state.map] = self.version
            for robot in state.robots:
                if robot.pose:
                    self._walk(f"{state.map}/{robot.robot}", robot)
            self._changed.notify_all()

    def take_tile(self, tile: Tile) -> None:
        """A square of a map as it is now."""
        with self._changed:
            self.version += 1
            self._squares.put(self.version, tile)
            self._changed.notify_all()

    def cells(self, key: str) -> bytes | None:
        """The packed cells of a tile; None where there is none."""
        with self._changed:
            self.fetched += 1
            return self._squares.kept[key][1].cells or None if key in self._squares.kept else None

    def _newer(self, version: int) -> dict[str, tuple[int, float] | None]:
        """Tiles told after `version`: when, and the side of their cells [m]; None for those that are gone."""
        return {
            key: (when, tile.cell) if tile.cells else None
            for key, (when, tile) in self._squares.kept.items()
            if when > version
        }

    def _walk(self, key: str, robot: RobotState) -> None:
        if key not in self._trails and len(self._trails) >= MOST_TRAILS:
            oldest = min(self._trails, key=lambda name: self._trails[name][-1][0] if self._trails[name] else 0)
            del self._trails[oldest]
            self._frames.pop(oldest, None)
            self._let_go += 1
        trail = self._trails.setdefault(key, [])
        before, now = self._frames.get(key), np.array(robot.frame)
        if now.size:
            self._frames[key] = now
        x, y = robot.pose[:2]
        stretch = 0
        if trail:
            last_x, last_y, component, stretch = trail[-1][1]
            if before is not None and now.size and component == robot.component:
                last = np.array([last_x, last_y, 0.0])
                corrected = se2.compose(now, se2.between(before, last))  # the last point as the map has it today
                if np.hypot(*(corrected - last)[:2]) > CORRECTED:
                    last_x, last_y, stretch = float(corrected[0]), float(corrected[1]), stretch + 1
                    trail.append((self.version, (last_x, last_y, component, stretch)))
            if component == robot.component and (x - last_x) ** 2 + (y - last_y) ** 2 < STEP**2:
                return
        trail.append((self.version, (x, y, robot.component, stretch)))
        if len(trail) > POINTS:
            del trail[: POINTS // 4]

    def _walked(self, version: int) -> dict[str, list[Point]]:
        """Points of the trails that came after `version`."""
        newer = {}
        for key, trail in self._trails.items():
            first = len(trail)
            while first and trail[first - 1][0] > version:
                first -= 1
            if first < len(trail):
                newer[key] = [point for _, point in trail[first:]]
        return newer

    def all(self) -> tuple[int, bytes]:
        """Number of the newest frame, and JSON of all states, with the trails and which tiles there are, as of it."""
        with self._changed:
            self._frame()
            if self._whole is None or self._whole[0] != self._number:
                states = list(self.states.values())
                content = {"states": states, "trails": self._walked(0), "tiles": self._newer(0)}
                self._whole = self._number, msgspec.json.encode(content)
            return self._whole

    def after(self, number: int, patience: float) -> tuple[int, bytes | None]:
        """The frame after `number`, and its own number; None when nothing came within `patience` [s].

        Who is `KEPT_FRAMES` behind gets everything.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self.closed or self._number > number or self.version > self._framed, patience
            )
            if self._number <= number and self.version > self._framed:
                self._changed.wait_for(lambda: self.closed or self._number > number, max(self._due - monotonic(), 0.0))
            if self._number <= number:
                self._frame()
            behind = self._number - number
            if behind <= 0:
                return number, None
            if behind <= len(self._recent):
                return number + 1, self._recent[-behind]
        return self.all()

    def _frame(self) -> None:
        """What came since the last frame makes one, if anything did."""
        if self.version == self._framed:
            return
        before, self._framed = self._framed, self.version
        fresh = [s for name, s in self.states.items() if self._fresh[name] > before]
        content = {"states": fresh, "steps": self._walked(before), "tiles": self._newer(before)}
        self._recent.append(msgspec.json.encode(content))
        self._number += 1
        self.encoded += 1
        self._due = monotonic() + FRAME
        self._changed.notify_all()

    def close(self) -> None:
        """Nothing more comes: those who wait go."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()


@contextmanager
def served(board: Board, host: str, port: int) -> Iterator[str]:
    """The page stands at the address that is given, until the block ends; raises UsageError when the port is taken."""

    def tile(asked: Asked) -> None:
        cells = board.cells(asked.path.removeprefix("/tile/"))
        if cells:
            asked.whole("application/octet-stream", cells, packed=True)
        else:
            asked.send_error(HTTPStatus.NOT_FOUND)

    def events(asked: Asked) -> None:
        asked.head("text/event-stream")
        asked.end_headers()
        _tell(board, asked.wfile)

    gets: dict[str, Answer] = {
        "/": lambda asked: asked.whole("text/html; charset=utf-8", PAGE.encode()),
        "/state.json": lambda asked: asked.whole("application/json", board.all()[1]),
        "/events": events,
        "/tile/": tile,  # MAP/PART/LEVEL/I/J
    }
    with served_pages(host, port, gets) as address:
        try:
            yield address
        finally:
            board.close()


def _tell(board: Board, page: BufferedIOBase) -> None:
    """Every frame as it comes, until the browser leaves or the board is closed."""
    number, data = board.all()
    try:
        page.write(b"data: " + data + b"\n\n")
        board.readers += 1
        while not board.closed:
            page.flush()
            number, fresh = board.after(number, SILENCE)
            page.write(b": nothing new\n\n" if fresh is None else b"data: " + fresh + b"\n\n")
    except OSError:  # the browser left
        return
