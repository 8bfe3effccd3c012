"""A node of a ROS 2 graph as rmw_zenoh puts it on the wire, written from its documents alone, bytes by hand.

Nothing of mapweave.live is used here: keys, tokens, attachments and CDR are spelled out once more.
"""

import json
import math
import os
import struct
import threading
import time

import numpy as np
import zenoh
import zenoh.ext

HASHES = {  # as ROS 2 prints them for these definitions
    "sensor_msgs/msg/LaserScan": "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "sensor_msgs/msg/NavSatFix": "RIHS01_62223ab3fe210a15976021da7afddc9e200dc9ec75231c1b6a557fc598a65404",
    "sensor_msgs/msg/Imu": "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "nav_msgs/msg/OccupancyGrid": "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    "geometry_msgs/msg/PoseStamped": "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    ),
}
VOLATILE, LATCHED, SENSOR = "::,10:,:,:,,", ":1:,1:,:,:,,", "2::,5:,:,:,,"
BRIDGED = {VOLATILE: ":1:0:0,10", LATCHED: ":1:1:0,1", SENSOR: ":0:0:0,5"}  # the same as a bridge tells it


class Writer:
    """Little-endian CDR: every number aligned to its size, counted from after the four bytes of the head."""

    def __init__(self):
        self.data = bytearray()

    def put(self, kind, *values):
        size = struct.calcsize(kind)
        for value in values:
            self.data += bytes(-len(self.data) % size) + struct.pack("<" + kind, value)
        return self

    def text(self, words):
        raw = words.encode() + b"\0"
        self.put("I", len(raw))
        self.data += raw
        return self

    def array(self, kind, values):
        self.put("I", len(values))
        return self.put(kind, *values)

    def head(self, t, frame):
        ns = round(t * 1e9)
        return self.put("i", ns // 10**9).put("I", ns % 10**9).text(frame)

    def bytes(self):
        return b"\x00\x01\x00\x00" + bytes(self.data)


class Reader:
    def __init__(self, data):
        assert data[:4] == b"\x00\x01\x00\x00"
        self.data, self.at = data[4:], 0

    def get(self, kind, n=1):
        size = struct.calcsize(kind)
        self.at += -self.at % size
        values = struct.unpack_from(f"<{n}{kind}", self.data, self.at)
        self.at += n * size
        return values if n != 1 else values[0]

    def text(self):
        n = self.get("I")
        self.at += n
        return self.data[self.at - n : self.at - 1].decode()

    def head(self):
        return self.get("i") + self.get("I") * 1e-9, self.text()


def turned(theta):
    return 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2)


def scan(t, frame, ranges, angle_min, step, range_max, intensities=(), apart=0.0):
    out = Writer().head(t, frame)
    out.put("f", angle_min, angle_min + step * (len(ranges) - 1), step, apart, 0.1, 0.05, range_max)
    return out.array("f", ranges).array("f", intensities).bytes()


def odometry(t, frame, child, pose):
    x, y, theta = pose
    out = Writer().head(t, frame).text(child)
    out.put("d", x, y, 0.0, *turned(theta)).put("d", *[0.0] * 36)
    return out.put("d", *[0.0] * 6).put("d", *[0.0] * 36).bytes()


def fix(t, frame, place, sd=1.0, status=0):
    """place: latitude, longitude [deg], height [m]; sd: [m] of each, None where it is not known."""
    out = Writer().head(t, frame).put("b", status).put("H", 1).put("d", *place)
    out.put("d", *[0.0 if k % 4 else (sd or 0.0) ** 2 for k in range(9)])
    return out.put("B", 0 if sd is None else 2).bytes()


def pose_told(t, frame, place, var):
    """A PoseWithCovarianceStamped at `place`, with the variances xx, xy, yy [m^2]."""
    cov = dict(zip((0, 1, 6, 7), (var[0], var[1], var[1], var[2]), strict=True))
    out = Writer().head(t, frame).put("d", *place, *turned(0.0))
    return out.put("d", *(cov.get(k, 0.0) for k in range(36))).bytes()


def imu(t, frame, rate, felt=(0.0, 0.0, 9.81)):
    """rate: [rad/s] over the unit's axes; felt: [m/s^2]."""
    out = Writer().head(t, frame).put("d", *turned(0.0), *[0.0] * 9)
    return out.put("d", *rate, *[0.0] * 9).put("d", *felt, *[0.0] * 9).bytes()


def transforms(*edges):
    """edges: stamp, parent, child, (x, y, theta)."""
    out = Writer().put("I", len(edges))
    for t, parent, child, (x, y, theta) in edges:
        out.head(t, parent).text(child).put("d", x, y, 0.0, *turned(theta))
    return out.bytes()


def read_pose(data):
    """Stamp, frame, (x, y, theta), covariance (36)."""
    r = Reader(data)
    t, frame = r.head()
    x, y, _, _, _, z, w = r.get("d", 7)
    return t, frame, (x, y, 2 * math.atan2(z, w)), r.get("d", 36)


def read_goal(data):
    """Stamp, frame, (x, y, theta)."""
    r = Reader(data)
    t, frame = r.head()
    x, y, _, _, _, z, w = r.get("d", 7)
    return t, frame, (x, y, 2 * math.atan2(z, w))


def read_grid(data):
    """Frame, resolution, (width, height), (x, y) of the origin, cells."""
    r = Reader(data)
    _, frame = r.head()
    r.get("i"), r.get("I")
    resolution, width, height = r.get("f"), r.get("I"), r.get("I")
    x, y, *_ = r.get("d", 7)
    n = r.get("I")
    assert n == width * height
    return frame, resolution, (width, height), (x, y), r.get("b", n)


def read_transforms(data):
    r = Reader(data)
    out = []
    for _ in range(r.get("I")):
        t, parent = r.head()
        child = r.text()
        x, y, _, _, _, z, w = r.get("d", 7)
        out.append((t, parent, child, (x, y, 2 * math.atan2(z, w))))
    return out


def attachment(sequence, gid, now=None):
    now = time.time_ns() if now is None else now
    return struct.pack("<q", sequence) + struct.pack("<q", now) + b"\x10" + gid


def named_attachment(sequence, gid, now=0):
    """As releases before 0.2.4 wrote it."""
    out = b"\x0fsequence_number" + struct.pack("<q", sequence) + b"\x10source_timestamp" + struct.pack("<q", now)
    return out + b"\x0asource_gid\x10" + gid


def mangled(kind):
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def open_session(at, mode="peer"):
    config = zenoh.Config()
    here = {"listen/endpoints": [at]} if mode == "router" else {"connect/endpoints": [at]}
    settings = {"mode": mode, "scouting/multicast/enabled": False, "timestamping/enabled": True, **here}
    if mode == "peer":
        settings["listen/endpoints"] = ["tcp/127.0.0.1:0"]
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Node:
    """A node of `domain`; its publishers and what it hears."""

    def __init__(self, session, name, namespace="/", domain=0):
        self.session, self.domain, self.heard, self.entities = session, domain, {}, 0
        self.where = f"{namespace.replace('/', '%')}/{name}"
        self.held = [self.token("NN", "")]
        self.gids, self.counts, self.out = {}, {}, {}
        self.watch = {}

    def token(self, kind, rest):
        key = f"@ros2_lv/{self.domain}/{self.session.info.zid()}/0/{self.entities}/{kind}/%/{self.where}{rest}"
        self.entities += 1
        return self.session.liveliness().declare_token(key)

    def topic(self, name, kind, qos, type_hash=None):
        type_hash = type_hash or HASHES[kind]
        rest = f"/{name.replace('/', '%')}/{mangled(kind)}/{type_hash}/{qos}"
        return rest, f"{self.domain}/{name.strip('/')}/{mangled(kind)}/{type_hash}"

    def publisher(self, name, kind, qos=VOLATILE, type_hash=None):
        rest, key = self.topic(name, kind, qos, type_hash)
        self.held.append(self.token("MP", rest))
        kept = qos.split(":")[1] == "1"
        beat = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5)
        self.out[name] = zenoh.ext.declare_advanced_publisher(
            self.session,
            key,
            congestion_control=zenoh.CongestionControl.BLOCK,  # nothing is let go, however loaded the machine
            cache=zenoh.ext.CacheConfig(max_samples=1) if kept else None,
            publisher_detection=kept,
            sample_miss_detection=beat if kept else None,
        )
        self.watch[name] = self.session.declare_publisher(key)  # what is advanced cannot tell who listens
        self.gids[name], self.counts[name] = os.urandom(16), 0

    def is_heard(self, *names):
        """Whether somebody listens to each of these topics: only then does a first message reach them."""
        return all(self.watch[name].matching_status.matching for name in names)

    def say(self, name, payload, *, as_before=False):
        self.counts[name] += 1
        form = named_attachment if as_before else attachment
        self.out[name].put(payload, attachment=form(self.counts[name], self.gids[name]))

    def hear(self, name, kind, *, latched=False, type_hash=None):
        """Messages on a topic, as they come, in `heard`."""
        rest, key = self.topic(name, kind, LATCHED if latched else VOLATILE, type_hash)
        self.held.append(self.token("MS", rest))
        mine = self.heard.setdefault(name, [])
        beat = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        self.held.append(
            zenoh.ext.declare_advanced_subscriber(
                self.session,
                key,
                lambda sample: mine.append(
                    (sample.payload.to_bytes(), sample.attachment and sample.attachment.to_bytes())
                ),
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1) if latched else None,
                recovery=beat if latched else None,
                subscriber_detection=latched,
            )
        )

    def graph(self):
        """Every token of the domain."""
        replies = self.session.liveliness().get(f"@ros2_lv/{self.domain}/**", timeout=2.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]


class BridgedNode(Node):
    """What zenoh-bridge-ros2dds beside a robot puts on the wire for it, written from its sources."""

    def token(self, kind, rest):
        here = f"@/{self.session.info.zid()}/@ros2_lv"
        return self.session.liveliness().declare_token(f"{here}/{kind}{rest}" if rest else here)

    def topic(self, name, kind, qos, type_hash=None):
        name = name.strip("/")
        told = "" if type_hash == "" else f":typehash={type_hash or HASHES[kind]};"
        return "/" + "/".join([name.replace("/", "§"), kind.replace("/", "§"), BRIDGED[qos] + told]), name

    def say(self, name, payload):
        self.out[name].put(payload)

    def graph(self):
        replies = self.session.liveliness().get("@/*/@ros2_lv/**", timeout=2.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]


class RosDrive:
    """A robot that plays a simulated log in its namespace: scans, transforms, odometry as a topic or as tf, fixes."""

    def __init__(self, session, space, log, mount, *, by_tf=False, domain=0, type_hash=None, node=Node):
        self.node = node(session, "driver", f"/{space}", domain)
        self.space, self.log, self.mount, self.by_tf = space, log, mount, by_tf
        self.node.publisher(f"/{space}/scan", "sensor_msgs/msg/LaserScan", SENSOR, type_hash)
        self.node.publisher("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED, type_hash)
        if by_tf:
            self.node.publisher("/tf", "tf2_msgs/msg/TFMessage", type_hash=type_hash)
        else:
            self.node.publisher(f"/{space}/odom", "nav_msgs/msg/Odometry", type_hash=type_hash)
        still = [(1.0, f"{space}/base_link", f"{space}/laser", mount)]
        if log.fixes is not None:
            self.node.publisher(f"/{space}/fix", "sensor_msgs/msg/NavSatFix", SENSOR, type_hash)
            still.append((1.0, f"{space}/base_link", f"{space}/gps", (*log.fixes.antenna, 0.0)))
        self.node.say("/tf_static", transforms(*still))

    def wait_for_a_listener(self):
        """Declarations take their time through a router; what is said before they came is heard by nobody."""
        wheels = "/tf" if self.by_tf else f"/{self.space}/odom"
        receiver = [] if self.log.fixes is None else [f"/{self.space}/fix"]
        wait_for(lambda: self.node.is_heard(f"/{self.space}/scan", wheels, *receiver))

    def play(self, rate, stop=None):
        self.wait_for_a_listener()
        rows = [(t, "odometry", k) for k, t in enumerate(self.log.odometry.t.tolist())]
        rows += [(t, "scan", k) for k, t in enumerate(self.log.scan_t.tolist())]
        rows += [] if self.log.fixes is None else [(t, "fix", k) for k, t in enumerate(self.log.fixes.t.tolist())]
        rows.sort()
        begin, first = time.monotonic(), rows[0][0]
        for t, what, k in rows:
            if stop is not None and stop.is_set():
                return
            time.sleep(max(0.0, begin + (t - first) / rate - time.monotonic()))
            self.tell(t, what, k)

    def tell(self, t, what, k):
        name = f"/{self.space}"
        if what == "scan":
            self.node.say(f"{name}/scan", self.scan(k))
        elif what == "fix":
            f = self.log.fixes
            sd = float(np.sqrt(f.cov[k, 0, 0]))
            self.node.say(f"{name}/fix", fix(t, f"{self.space}/gps", f.place[k].tolist(), sd))
        elif self.by_tf:
            edge = (t, f"{self.space}/odom", f"{self.space}/base_link", self.log.odometry.pose[k])
            self.node.say("/tf", transforms(edge))
        else:
            made = odometry(t, f"{self.space}/odom", f"{self.space}/base_link", self.log.odometry.pose[k])
            self.node.say(f"{name}/odom", made)

    def scan(self, k):
        s = self.log.scans[k]
        ranges = [r if hit else math.inf for r, hit in zip(s.ranges.tolist(), s.hit.tolist(), strict=True)]
        light = () if s.intensities is None else s.intensities.tolist()
        t = float(self.log.scan_t[k])
        return scan(t, f"{self.space}/laser", ranges, s.angle_min, s.angle_increment, s.range_max, light)


def wait_for(true, timeout=60.0, every=0.05):
    end = time.monotonic() + timeout
    while not true():
        assert time.monotonic() < end, "it never came"
        threading.Event().wait(every)
