"""ROS messages as CDR bytes and back, and the hashes of their types."""

import struct
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import TypesysError

from ...io.mcap import STORE
from ..messages import LARGEST, RefusedError

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
