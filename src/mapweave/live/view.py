"""The shared map in a browser: one page, fed by server-sent events; nothing is asked of the page's network."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedIOBase
from pathlib import Path
from threading import Condition, Thread

import msgspec
import numpy as np
import zenoh
from jaxtyping import Float

from ..core import se2
from ..core.errors import UsageError
from .messages import MapState, RefusedError, RobotState, Tile, decode
from .topics import Topics
from .transport import ask

PAGE = Path(__file__).with_name("page.html")
POINTS = 4000  # of each robot's trail, for browsers that come late
STEP = 0.05  # [m] from point to point of a trail
SILENCE = 10.0  # [s] after which a browser is told that nothing came, so that one that left is noticed
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'"
CORRECTED = 0.3  # [m] by which a correction has to move a robot for its trail to begin anew from there
Pose = Float[np.ndarray, "3"]
Point = tuple[float, float, int, int]  # x, y [m], component, stretch: no line is drawn from one stretch to the next


class Board:
    """The newest state of every map process, where its robots were, its map. readers: browsers that follow it.

    fetched: squares of the map that browsers have asked for.
    """

    def __init__(self) -> None:
        self.version = 0
        self.readers = 0
        self.fetched = 0
        self.closed = False
        self.states: dict[str, MapState] = {}
        self._trails: dict[str, list[tuple[int, Point]]] = {}  # with the version that brought each point
        self._frames: dict[str, Pose] = {}
        self._fresh: dict[str, int] = {}
        self._tiles: dict[str, tuple[int, Tile]] = {}  # those that are gone without cells
        self._changed = Condition()

    def take(self, state: MapState) -> None:
        """What a map process says now; who waits is woken."""
        with self._changed:
            self.version += 1
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
            self._tiles[f"{tile.map}/{tile.component}/{tile.level}/{tile.i}/{tile.j}"] = (self.version, tile)
            self._changed.notify_all()

    def cells(self, key: str) -> bytes | None:
        """The packed cells of a tile; None where there is none."""
        with self._changed:
            self.fetched += 1
            return self._tiles[key][1].cells or None if key in self._tiles else None

    def _newer(self, version: int) -> dict[str, tuple[int, float] | None]:
        """Tiles told after `version`: when, and the side of their cells [m]; None for those that are gone."""
        return {
            key: (when, tile.cell) if tile.cells else None
            for key, (when, tile) in self._tiles.items()
            if when > version
        }

    def _walk(self, key: str, robot: RobotState) -> None:
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
        """Version and JSON of all states, with the trails and which tiles there are."""
        with self._changed:
            states = list(self.states.values())
            content = {"states": states, "trails": self._walked(0), "tiles": self._newer(0)}
            return self.version, msgspec.json.encode(content)

    def after(self, version: int, patience: float) -> tuple[int, bytes | None]:
        """Version and JSON of what came after `version`; None when nothing came within `patience` [s]."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self.version > version, patience)
            if self.version <= version:
                return version, None
            fresh = [s for name, s in self.states.items() if self._fresh[name] > version]
            content = {"states": fresh, "steps": self._walked(version), "tiles": self._newer(version)}
            return self.version, msgspec.json.encode(content)

    def close(self) -> None:
        """Nothing more comes: those who wait go."""
        with self._changed:
            self.closed = True
            self._changed.notify_all()


def follow(session: zenoh.Session, topics: Topics, board: Board) -> object:
    """`board` hears every map process of the team for as long as what is returned is held."""

    def take(payload: bytes, name: str | None = None) -> None:
        try:
            message = decode(payload)
        except RefusedError:
            return
        if isinstance(message, MapState) and message.map == name:
            new = name not in board.states
            board.take(message)
            if new:  # what it has drawn so far is asked for
                ask(session, topics.tiles(name), "", take, lambda: None)
        elif isinstance(message, Tile) and name in {None, message.map}:
            board.take_tile(message)

    def hear(sample: zenoh.Sample) -> None:
        take(sample.payload.to_bytes(), topics.map_of(str(sample.key_expr)))

    callback = zenoh.handlers.Callback(hear)
    return [session.declare_subscriber(key, callback) for key in (topics.map_state(), topics.tile())]


@contextmanager
def served(board: Board, host: str, port: int) -> Iterator[str]:
    """The page stands at the address that is given, until the block ends; raises UsageError when the port is taken."""
    try:
        server = ThreadingHTTPServer((host, port), _handler(board))
    except OSError as error:
        raise UsageError(f"--port {port}: {error.strerror or error}") from None
    except OverflowError:
        raise UsageError(f"--port {port}: expected a number from 0 to 65535") from None
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"http://{host}:{server.server_address[1]}/"
    finally:
        board.close()
        server.shutdown()
        server.server_close()


def _handler(board: Board) -> type[BaseHTTPRequestHandler]:
    """Answers `/`, `/events`, `/state.json` and `/tile/MAP/PART/LEVEL/I/J`."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answers: dict[str, Callable[[], None]] = {
                "/": lambda: self._whole("text/html; charset=utf-8", PAGE.read_bytes()),
                "/state.json": lambda: self._whole("application/json", board.all()[1]),
                "/events": self._events,
            }
            answer = answers.get(self.path)
            if self.path.startswith("/tile/") and (cells := board.cells(self.path.removeprefix("/tile/"))):
                self._whole("application/octet-stream", cells, packed=True)
                return
            if answer is None:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            answer()

        def _whole(self, kind: str, body: bytes, *, packed: bool = False) -> None:
            self._head(kind)
            if packed:
                self.send_header("Content-Encoding", "deflate")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def _head(self, kind: str) -> None:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Cache-Control", "no-store")
            self.send_header("Content-Security-Policy", POLICY)

        def _events(self) -> None:
            self._head("text/event-stream")
            self.end_headers()
            _tell(board, self.wfile)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Nothing is printed a request."""

    return Handler


def _tell(board: Board, page: BufferedIOBase) -> None:
    """Every state as it comes, until the browser leaves or the board is closed."""
    version, data = board.all()
    try:
        page.write(b"data: " + data + b"\n\n")
        board.readers += 1
        while not board.closed:
            page.flush()
            version, fresh = board.after(version, SILENCE)
            page.write(b": nothing new\n\n" if fresh is None else b"data: " + fresh + b"\n\n")
    except OSError:  # the browser left
        return
