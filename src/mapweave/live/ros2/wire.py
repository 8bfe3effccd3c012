"""How a ROS graph is put on Zenoh: keys of topics, liveliness tokens, attachments; messages as CDR bytes and back.

By rmw_zenoh, as its design document says: a topic's key is `<domain>/<topic>/<type>/<type hash>`. Every node, publisher
and subscription holds a token `@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<name>`, those
of a topic followed by `/<topic>/<type>/<type hash>/<qos>`, with % for each slash within a part. Every message carries
an attachment.

By zenoh-bridge-ros2dds, which is beside robots of any other middleware, as its sources say: a topic's key is its name,
with the bridge's namespace before it; of each it holds a token `@/<session>/@ros2_lv/<kind>/<topic>/<type>/<qos>`, with
§ for each slash within a part. Messages carry nothing beside; domains are not told.
"""

import hashlib
import re
import struct
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from ...io.mcap import STORE
from ..messages import LARGEST, RefusedError

SPACE = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIPTION = "NN", "MP", "MS"
ENTITIES = {NODE, PUBLISHER, SUBSCRIPTION, "SS", "SC"}
NO_HASH = "TypeHashNotSupported"  # of ROS 2 Humble, which knows no type hashes
ROS_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")
DEFAULT_DEPTH = 42
RELIABLE, BEST_EFFORT, TRANSIENT_LOCAL = "1", "2", "1"
UNRELIABLE = "0"  # of the bridge, whose other numbers are the same
BRIDGE, SLASH = "zenoh-bridge-ros2dds", "§"
BRIDGED = re.compile(rf"@/(\w+)/{SPACE}/(MP|MS)/([^/]+)/([^/]+)/([^/]+)")
BRIDGED_TYPE = re.compile(r"\w+/(msg|srv|action)/\w+")
HASH = re.compile(r"typehash=(RIHS01_[0-9a-f]{64})")
GID = 16  # bytes
ATTACHMENT = re.compile(  # numbers little-endian; names and the gid are led by their lengths
    rb"(?:\x0fsequence_number)?(.{8})(?:\x10source_timestamp)?(.{8})(?:\nsource_gid)?\x10(.{16})", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class Qos:
    """What a token tells of a topic's quality of service; the rest is as rmw_zenoh has it when nothing is asked."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = DEFAULT_DEPTH

    def __str__(self) -> str:
        reliability = "" if self.reliable else BEST_EFFORT
        durability = TRANSIENT_LOCAL if self.transient_local else ""
        return f"{reliability}:{durability}:,{'' if self.depth == DEFAULT_DEPTH else self.depth}:,:,:,,"

    @classmethod
    def read(cls, text: str) -> "Qos":
        """Raises ValueError when `text` is not of that form."""
        reliability, durability, history, *_ = text.split(":")
        depth = history.split(",")[1:2]
        if not depth:
            raise ValueError(text)
        return cls(reliability != BEST_EFFORT, durability == TRANSIENT_LOCAL, int(depth[0] or DEFAULT_DEPTH))

    def bridged(self) -> str:
        """As the bridge's tokens have it."""
        reliability = RELIABLE if self.reliable else UNRELIABLE
        return f":{reliability}:{int(self.transient_local)}:0,{self.depth}"

    @classmethod
    def of_bridge(cls, text: str) -> "Qos":
        """Raises ValueError when `text` is not of that form."""
        _, reliability, durability, history, *_ = text.split(":")
        depth = history.partition(",")[2]
        return cls(reliability != UNRELIABLE, durability == TRANSIENT_LOCAL, int(depth or DEFAULT_DEPTH))


@dataclass(frozen=True, slots=True)
class Topic:
    """kind: the ROS type as `sensor_msgs/msg/LaserScan`; type_hash: as REP 2016 has it; bridged: by the bridge."""

    name: str
    kind: str
    type_hash: str
    qos: Qos = field(default_factory=Qos)
    bridged: bool = False

    def key(self, domain: int) -> str:
        if self.bridged:
            return self.name.strip("/")
        return f"{domain}/{self.name.strip('/')}/{mangled_type(self.kind)}/{self.type_hash}"


@dataclass(frozen=True, slots=True)
class Entity:
    """One token: a node, or what it publishes or hears. namespace: with its slashes, `/` where there is none."""

    domain: int
    session: str
    node_id: int
    entity_id: int
    kind: str
    namespace: str
    node: str
    topic: Topic | None = None

    def token(self) -> str:
        if self.topic is not None and self.topic.bridged:
            name, kind = (part.strip("/").replace("/", SLASH) for part in (self.topic.name, self.topic.kind))
            return f"@/{self.session}/{SPACE}/{self.kind}/{name}/{kind}/{self.topic.qos.bridged()}"
        parts = [SPACE, self.domain, self.session, self.node_id, self.entity_id, self.kind]
        parts += ["%", _mangled(self.namespace), _mangled(self.node)]
        if (t := self.topic) is not None:
            parts += [_mangled(t.name), mangled_type(t.kind), t.type_hash, t.qos]
        return "/".join(map(str, parts))

    def gid(self) -> bytes:
        """16 bytes that no other entity has."""
        return hashlib.blake2b(self.token().encode(), digest_size=GID).digest()

    @classmethod
    def read(cls, token: str) -> "Entity":
        """Raises RefusedError for what is no token of either."""
        try:
            if token.startswith("@/"):
                return cls(0, *_bridged(token))
            domain, session, node_id, entity_id, kind, namespace, node, topic = _parts(token)
            return cls(int(domain), session, int(node_id), int(entity_id), kind, _plain(namespace), _plain(node), topic)
        except ValueError:
            raise RefusedError("token", f"no token of a ROS graph: {token[:200]}") from None


@dataclass(frozen=True, slots=True)
class Attachment:
    """sequence: counts a publisher's messages from 1; source_ns: its wall clock [ns]; gid: whose message it is."""

    sequence: int
    source_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return struct.pack("<qqB", self.sequence, self.source_ns, GID) + self.gid

    @classmethod
    def decode(cls, data: bytes) -> "Attachment":
        """Three fields in a row, or each after its name, as releases before 0.2.4 had it; RefusedError of others."""
        match = ATTACHMENT.fullmatch(data)
        if match is None:
            raise RefusedError("attachment", f"{len(data)} bytes that are none of rmw_zenoh's")
        sequence, source_ns, gid = match.groups()
        return cls(int.from_bytes(sequence, "little", signed=True), int.from_bytes(source_ns, "little"), gid)


def mangled_type(kind: str) -> str:
    """`sensor_msgs::msg::dds_::LaserScan_` of `sensor_msgs/msg/LaserScan`."""
    package, group, name = kind.split("/")
    return f"{package}::{group}::dds_::{name}_"


def every_token(domain: int) -> tuple[str, ...]:
    """The keys of all tokens of publishers and, by rmw_zenoh, of all others."""
    return f"{SPACE}/{domain}/**", f"@/*/{SPACE}/{PUBLISHER}/**"


def _bridged(token: str) -> tuple[str, int, int, str, str, str, Topic]:
    """Raises ValueError for what is no token of the bridge."""
    match = BRIDGED.fullmatch(token)
    if match is None:
        raise ValueError(token)
    session, entity, name, kind, qos = match.groups()
    name, kind = name.replace(SLASH, "/"), kind.replace(SLASH, "/")
    if not BRIDGED_TYPE.fullmatch(kind):
        raise ValueError(kind)
    found = HASH.search(qos)
    topic = Topic(f"/{name}", kind, found[1] if found else NO_HASH, Qos.of_bridge(qos), bridged=True)
    return session, 0, 0, entity, "/", BRIDGE, topic


def _parts(token: str) -> tuple[str, str, str, str, str, str, str, Topic | None]:
    """Raises ValueError for what is no token of rmw_zenoh."""
    space, domain, session, node_id, entity_id, kind, _, namespace, node, *rest = token.split("/")
    if space != SPACE or kind not in ENTITIES or len(rest) not in {0, 4} or (kind == NODE) != (not rest):
        raise ValueError(token)
    return domain, session, node_id, entity_id, kind, namespace, node, _topic(*rest) if rest else None


def _topic(name: str, kind: str, type_hash: str, qos: str) -> Topic:
    match = ROS_TYPE.fullmatch(kind)
    if match is None:
        raise ValueError(kind)
    return Topic(_plain(name), "/".join(match.groups()), type_hash, Qos.read(qos))


def _mangled(name: str) -> str:
    return name.replace("/", "%") or "%"


def _plain(name: str) -> str:
    return name.replace("%", "/")


SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
GRID = "nav_msgs/msg/OccupancyGrid"
GOAL = "geometry_msgs/msg/PoseStamped"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
BROKEN = (
    *(SerdeError, TypesysError, struct.error, ValueError, LookupError, TypeError, AttributeError, AssertionError),
    *(ArithmeticError, RuntimeError, MemoryError),
)


@cache
def type_hash(kind: str) -> str:
    """The hash of a message's definition as REP 2016 has it: the same from ROS 2 Iron on."""
    return str(STORE.hash_rihs01(kind))


def decode(payload: bytes, kind: str) -> Any:
    """The message; raises RefusedError for bytes that are none of that type, or too many."""
    if len(payload) > LARGEST:
        raise RefusedError("oversized", f"{kind} of {len(payload)} bytes, at most {LARGEST}")
    try:
        return STORE.deserialize_cdr(payload, kind)
    except BROKEN as error:
        detail = " ".join(str(error).split())[:80] or type(error).__name__
        raise RefusedError("malformed", f"no {kind} in {len(payload)} bytes: {detail}") from None


def encode(message: Any, kind: str) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))
