"""The one place that speaks Zenoh: a session that needs nobody else, and lets go of what nobody takes."""

import json
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from ipaddress import ip_address
from pathlib import Path

import zenoh

# what the other files of a live team handle, of this one alone
from zenoh import CongestionControl as CongestionControl
from zenoh import Locality as Locality
from zenoh import Query as Query
from zenoh import Sample as Sample
from zenoh import SampleKind as SampleKind
from zenoh import Session as Session
from zenoh.ext import AdvancedPublisher as AdvancedPublisher
from zenoh.ext import CacheConfig as CacheConfig
from zenoh.ext import HistoryConfig as HistoryConfig
from zenoh.ext import MissDetectionConfig as MissDetectionConfig
from zenoh.ext import declare_advanced_publisher as declare_advanced_publisher
from zenoh.ext import declare_advanced_subscriber as declare_advanced_subscriber
from zenoh.handlers import Callback as Callback

from ..core.errors import UsageError

OPENING = 30_000  # [ms] that a handshake may take, in four messages
PORTS = 20  # tried one after the other where any will do
ANY_PORT = ":0"
LISTENING = "listening at "
MOST_ANSWERS = 500  # messages that one question is answered with
OWN = "own"  # in a question for messages: of the robot itself, and of no process that keeps them beside
NAME_PATIENCE = 4.0  # [s] that the token of a process that was killed may last
SETTLE = 0.3  # [s] for declarations to reach those who are there


@dataclass(frozen=True, slots=True)
class Network:
    """How a process of a live team reaches the others.

    connect, listen: endpoints as `tcp/host:port`; with none of both, processes of one network find each other. A
    process that listens passes messages on between those that connect to it; port 0 is any that is free. tls: the
    folder of its certificate. lease: seconds without a sign of life until the other counts as gone; more than a message
    takes there and back. insecure: whether a map process may hear other machines without certificates, as anyone who
    reaches the network could. extra: settings of Zenoh beside, by its own keys.
    """

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    tls: Path | None = None
    team: str = "team"
    lease: float = 3.0
    log_levels: str = "error"
    insecure: bool = False
    extra: dict[str, object] = field(default_factory=dict)


def is_open(network: Network) -> bool:
    """Whether other machines are heard and nobody has to show who he is."""
    alone = not (network.connect or network.listen)  # found by multicast: whoever is on the network
    return network.tls is None and (alone or not all(_is_here(at) for at in (*network.connect, *network.listen)))


def told_on(network: Network) -> Network:
    """The same, of a process that tells all others: what it says is passed on by the one that it connects to.

    Zenoh passes nothing on from peer to peer, as each could reach the other; from a router to peers it does.
    """
    return replace(network, extra={"mode": "router", **network.extra}) if network.connect else network


def _is_here(endpoint: str) -> bool:
    """Whether it is of this machine alone."""
    host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:  # a name, which may be any machine's
        return False


def _untold(endpoint: str) -> None:
    """Nobody asks."""


@contextmanager
def session(network: Network, listening: Callable[[str], None] = _untold) -> Iterator[zenoh.Session]:
    """An open session; raises UsageError when a port is taken, an endpoint is none, or a certificate does not serve.

    listening: called with each endpoint it listens at in place of one with port 0.
    """
    zenoh.init_log_from_env_or(network.log_levels)
    opened = _opened(network, listening)
    try:
        yield opened
    finally:
        opened.close()  # type: ignore[no-untyped-call]


def _opened(network: Network, listening: Callable[[str], None]) -> zenoh.Session:
    if not 0.5 <= network.lease <= 600:
        raise UsageError(f"--lease: expected 0.5 to 600 seconds, found {network.lease}")
    free = [at for at in network.listen if at.endswith(ANY_PORT)]
    for left in reversed(range(PORTS if free else 1)):
        chosen = replace(network, listen=tuple(_with_port(at) for at in network.listen))
        try:
            opened = _open(chosen)
        except UsageError as error:  # somebody may have taken the port before Zenoh did
            if left and "in use" in str(error):
                continue
            raise
        break
    for asked, at in zip(network.listen, chosen.listen, strict=True):
        if asked != at:
            listening(at)
    return opened


def _with_port(at: str) -> str:
    """The endpoint with a port that nobody listens at, where it has port 0."""
    if not at.endswith(ANY_PORT):
        return at
    with socket.socket() as s:
        s.bind(("", 0))
        return f"{at.removesuffix(ANY_PORT)}:{s.getsockname()[1]}"


def _open(network: Network) -> zenoh.Session:
    config = zenoh.Config()
    for key, value in settings(network).items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise UsageError(f"{_option(key, value)}: {_first(error)}") from None
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise UsageError(f"--listen {', '.join(network.listen)}: the port is already in use") from None
        raise UsageError(f"the network cannot be used: {_first(error)}") from None


def settings(network: Network) -> dict[str, object]:
    """Zenoh's configuration, by its own keys."""
    alone = not (network.connect or network.listen)
    out: dict[str, object] = {
        "mode": "router" if network.listen else "peer",
        "connect/endpoints": list(network.connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "listen/endpoints": list(network.listen) or ([] if network.connect else ["tcp/[::]:0"]),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": alone,
        "scouting/gossip/enabled": alone,  # else those that connect would go past the one that passes on
        "transport/link/tx/lease": round(1000 * network.lease),
        "transport/link/tx/keep_alive": 4,
        "transport/unicast/open_timeout": OPENING,
        "transport/unicast/accept_timeout": OPENING,
        "transport/link/rx/max_message_size": 1 << 24,
        "transport/shared_memory/enabled": False,  # 18 MB of each process on this machine, in every other one
    }
    if network.tls is not None:
        from .credentials import tls_settings  # noqa: PLC0415  (only where asked for)

        out |= tls_settings(network.tls)
    return out | network.extra


def put(where: zenoh.Session, key: str, payload: bytes) -> None:
    """Say it to whoever listens; who is too slow misses it and asks for it later. Never waits."""
    where.put(key, payload, congestion_control=zenoh.CongestionControl.DROP)


def ask(
    where: zenoh.Session,
    key: str,
    parameters: str,
    on_answer: Callable[[bytes], None],
    on_end: Callable[[], None],
    timeout: float = 5.0,
) -> None:
    """Everybody who answers under `key`; `on_answer` and `on_end` are called from another thread.

    Nobody is asked, and nothing called, where the session is closed meanwhile.
    """

    def take(reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            on_answer(reply.ok.payload.to_bytes())

    try:
        where.get(
            f"{key}?{parameters}" if parameters else key,
            zenoh.handlers.Callback(take, on_end),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
            congestion_control=zenoh.CongestionControl.BLOCK,  # answers come as they were asked for: none is let go
        )
    except zenoh.ZError:
        if not where.is_closed():
            raise


def answer(query: zenoh.Query, key: str, messages: Callable[[int, int], Sequence[tuple[int, bytes]]]) -> None:
    """Answers `?first=A;last=B` under `key` with the payloads of `messages(A, B)`, or with an error when it is none.

    messages: numbers and payloads from one number to another, in order; no more are asked for than one answer may hold.
    """
    words = [query.parameters.get(name) or "" for name in ("first", "last")]
    if not all(word.isdecimal() and len(word) < 16 for word in words):
        query.reply_err(b"expected first=A;last=B")
        return
    first, last = map(int, words)
    for _, payload in messages(first, min(last, first + MOST_ANSWERS - 1)):
        query.reply(key, payload)


def there_is(where: zenoh.Session, token: str, patience: float = NAME_PATIENCE) -> bool:
    """Whether somebody holds the liveliness token still after `patience` [s]; False as soon as nobody does."""
    end = time.monotonic() + patience
    while True:
        if not any(reply.ok for reply in where.liveliness().get(token, timeout=1.0)):
            return False
        if time.monotonic() > end:
            return True
        time.sleep(0.2)


def endpoints(words: Sequence[str] | None, option: str) -> tuple[str, ...]:
    """Endpoints as the command line spells them; raises UsageError for what is none."""
    for word in words or ():
        protocol, slash, rest = word.partition("/")
        host, colon, port = rest.rpartition(":")
        known = protocol in {"tcp", "tls", "quic", "udp"} and slash and colon and host and port.isdecimal()
        if not known or (option == "--connect" and int(port) == 0):
            raise UsageError(f"{option}: expected protocol/host:port as tcp/192.168.1.5:7447, found {word!r}")
    return tuple(words or ())


def _option(key: str, value: object) -> str:
    return f"--{key.split('/', maxsplit=1)[0]} {value}"


def _first(error: Exception) -> str:
    """The sentence of Zenoh's error without its source lines."""
    return str(error).split(" at /")[0].replace("[", "").strip()
