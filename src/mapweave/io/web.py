"""Pages served to browsers on this machine: answers go to who asked this machine by its own name, nobody else's page.

Nothing of a page may come from elsewhere, and what is posted has to come from the page itself.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import ip_address
from socket import gethostname
from threading import BoundedSemaphore, Thread
from typing import Any

from ..core.errors import MapweaveError, UsageError

POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src 'self'; img-src data:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {"Cache-Control": "no-store", "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff",
           "Referrer-Policy": "no-referrer"}  # fmt: skip
MOST_CONNECTIONS = 1200  # browsers; who comes beyond is told to come later
STUCK = 30.0  # [s] that a browser may take nothing, or not say what it asks for
MOST_POSTED = 1 << 20  # [bytes] of what a page posts

Posted = Callable[[Mapping[str, Any]], object]


def is_named(host: str, served_at: str) -> bool:
    """Whether a browser that says it asks `host` meant this machine: by an address, or by a name that is its own.

    Any other name was made to lead here by somebody else (DNS rebinding), whose page is not to read the answer.
    """
    name = (host.partition("]")[0].removeprefix("[") if host.startswith("[") else host.partition(":")[0]).lower()
    if name in {"localhost", served_at.lower(), gethostname().lower(), f"{gethostname().lower()}.local"}:
        return bool(name)
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class Asked(BaseHTTPRequestHandler):
    """One request. `answers` of the server: path -> what answers it; a path that ends in / also what begins so."""

    server: "Server"
    timeout = STUCK

    def do_GET(self) -> None:
        if not self._meant():
            return
        answer = self.server.gets.get(self.path)
        if answer is None:
            prefix, _, rest = self.path[1:].partition("/")
            answer = self.server.gets.get(f"/{prefix}/") if rest else None
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        answer(self)

    def do_POST(self) -> None:
        """What the page itself posts, as JSON: another site's page may not send that type, nor hide its origin."""
        if not self._meant():
            return
        origin, length = self.headers.get("Origin"), self.headers.get("Content-Length", "")
        ours = origin is None or origin.partition("://")[2] == self.headers.get("Host")
        if not ours or self.headers.get_content_type() != "application/json":
            self.send_error(HTTPStatus.FORBIDDEN, "only the page itself may ask for this")
            return
        answer = self.server.posts.get(self.path)
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        if not length.isdecimal() or int(length) > MOST_POSTED:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
            return
        try:
            asked = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict):
            self.send_error(HTTPStatus.BAD_REQUEST, "expected a JSON object")
            return
        try:
            told, status = answer(asked), HTTPStatus.OK
        except MapweaveError as error:
            told, status = {"error": str(error)}, HTTPStatus.UNPROCESSABLE_ENTITY
        self.whole("application/json", json.dumps(told, allow_nan=False).encode(), status=status)

    def _meant(self) -> bool:
        if is_named(self.headers.get("Host", ""), self.server.host):
            return True
        self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "no name of this machine")
        return False

    def whole(self, kind: str, body: bytes, *, packed: bool = False, status: HTTPStatus = HTTPStatus.OK) -> None:
        """All of an answer."""
        self.head(kind, status)
        if packed:
            self.send_header("Content-Encoding", "deflate")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def head(self, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        """The first lines of an answer."""
        self.send_response(status)
        self.send_header("Content-Type", kind)

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Nothing is printed a request."""


Answer = Callable[[Asked], None]


class Server(ThreadingHTTPServer):
    """A thread a browser, and no more than `MOST_CONNECTIONS`."""

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, host: str, port: int, gets: Mapping[str, Answer], posts: Mapping[str, Posted]) -> None:
        self.host, self.gets, self.posts = host, gets, posts
        self._room = BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__((host, port), Asked)

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._room.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that left in the middle is no news."""


@contextmanager
def served_pages(
    host: str, port: int, gets: Mapping[str, Answer], posts: Mapping[str, Posted] | None = None
) -> Iterator[str]:
    """Answers come from the address that is given, until the block ends; raises UsageError when the port is taken.

    gets: path -> what answers; posts: path -> what becomes of the JSON object posted, and the answer; a MapweaveError
    it raises is told as `{"error": ...}`.
    """
    try:
        server = Server(host, port, gets, posts or {})
    except OSError as error:
        raise UsageError(f"--port {port}: {error.strerror or error}") from None
    except OverflowError:
        raise UsageError(f"--port {port}: expected a number from 0 to 65535") from None
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"http://{host}:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()


@cache
def viewport() -> str:
    """`viewport(canvas, extent, draw)` in JavaScript: moving, zooming, measuring, a scale bar."""
    return (files(__package__) / "viewport.js").read_text(encoding="utf-8")
