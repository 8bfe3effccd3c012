"""Point clouds as scans: what stands between two heights above the floor, of every direction the nearest.

Where the floor is seen it is found as a plane, once a topic, in its first clouds: heights are counted from it, it is
left out, and a scanner that is tilted against it is levelled.
"""

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.errors import ReaderError
from .assemble import RawLog, RawScan, floats
from .bag import UNPACKABLE, Bag, stamp
from .salvage import DAMAGE
from .transforms import NOWHERE, Rigid, Transforms, frame, rotation_matrix

CLOUD = "sensor_msgs/msg/PointCloud2"
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # PointField.datatype
BROKEN = "cloud that does not hold what it announces"
FIRST = 20  # clouds in which the floor and the directions of the points are looked for
ABOUT = 0.5  # [m] above the scanner, and without a floor below it too, that a slice reaches where nobody says
FLOOR_FREE, FLOOR_SLOPE = 0.2, 0.03  # [m] above the floor, and more a metre away: a robot nods, floors are not flat
ONE_THING = 0.1  # [m] behind the nearest point of a beam, within which points are of the same thing
FAR = 1e3  # [m] that a point may be away
FLOOR_REACH, STEEPEST, FLAT = 15.0, np.deg2rad(20.0), 0.03  # [m], [rad], [m]: where a floor is looked for, how it is
LEAST, SAMPLED, SCORED = 200, 4000, 800  # points needed below the scanner; drawn from them; by which planes are chosen
LOOKS, SECTORS = 4000, 36  # planes tried: of 15 % of points on a floor three are drawn 14 times; directions
SHARE, BENEATH = 0.1, 0.05  # of the points below the scanner, on a floor and beneath it
OUTWARDS = (
    0.3  # [m] that a floor goes on outwards in half of the directions that see it: at the foot of walls it does not
)
LEANS = np.deg2rad(1.0)  # of a scanner, from which it is told
FINEST, COARSEST, USUAL = np.deg2rad([0.1, 1.5, 0.25]).tolist()  # [rad] between the beams of a slice
SAME_WAY, LEAST_STEPS, GRID = 1e-4, 20, 0.1  # [rad]; steps to tell a grid; of one, by which directions may be off it
OPTICAL = np.array([-0.5, 0.5, -0.5, 0.5])  # x y z w: T_camera_optical, as REP 103 has it: z ahead, x right


class Slice(NamedTuple):
    """How clouds of one topic are cut.

    level: (3, 3) turns points of the sensor so that z is up and x ahead of it; low, high: [m] above the sensor; floor:
    [m] the same, minus infinity where none is seen; first, step: the angles of the beams [rad].
    """

    level: Float[np.ndarray, "3 3"]
    low: float
    high: float
    floor: float
    first: float
    step: float


def points_of(message: Any) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"] | None]:
    """The points of a PointCloud2 [m] in its own frame, and their intensities, None where it has none.

    A cloud without z is flat. Raises ValueError for one that has no x or y, or does not hold what it announces.
    """
    fields = {str(f.name): f for f in message.fields}
    if not {"x", "y"} <= set(fields):
        raise ValueError(f"expected fields x and y, found {', '.join(sorted(fields)) or 'none'}")
    used = [name for name in ("x", "y", "z", "intensity") if name in fields]
    order = ">" if message.is_bigendian else "<"
    kinds = [order + NUMBERS.get(fields[name].datatype, "V0") for name in used]
    places = [fields[name].offset for name in used]
    width, height, step, row = message.width, message.height, message.point_step, message.row_step
    ends = [at + np.dtype(kind).itemsize for at, kind in zip(places, kinds, strict=True)]
    if any("V0" in kind for kind in kinds) or max(ends) > step:
        raise ValueError("fields that do not lie within a point")
    data = np.frombuffer(np.ascontiguousarray(message.data), np.uint8)
    row = row if height > 1 else width * step
    if row < width * step or len(data) < (height - 1) * row + width * step:
        raise ValueError(f"expected {height} x {width} points of {step} bytes, found {len(data)} bytes")
    if not width * height:
        return np.zeros((0, 3)), None
    kind = np.dtype({"names": used, "formats": kinds, "offsets": places, "itemsize": step})
    rows = np.ndarray((height, width), kind, data, strides=(row, step)).reshape(-1)
    xyz = np.stack([floats(rows[name]) if name in used else np.zeros(len(rows)) for name in "xyz"], axis=-1)
    return xyz, floats(rows["intensity"]) if "intensity" in used else None


def cloud_scans(
    bag: Bag, topic: str, tf: Transforms, base: str, height: Sequence[float] | None, raw: RawLog, *, given: bool
) -> Iterator[RawScan]:
    """A scan of each cloud of `topic`; a cloud that does not hold what it announces is counted in `raw`.

    height: the lowest and the highest [m] above the floor, or above the robot's frame where no floor is seen; given:
    the caller knows where the scanner stands. Raises ReaderError for a topic of which no cloud can be read.
    """
    clouds = _clouds(bag, topic, raw)
    first = list(islice(clouds, FIRST))
    name = next((frame(cloud.header.frame_id) for cloud in first), "")
    place = tf.rigid_pose(base, name)
    if place is None:
        place = (np.zeros(3), OPTICAL if "optical" in name else NOWHERE[1])
        if not given:
            raw.find("sensor-unplaced", f"no transform from {base or 'the robot'} to {name or 'the laser'}")
    pose = np.array([place[0][0], place[0][1], _heading(rotation_matrix(place[1]))])
    cut, lean = sliced([cloud.xyz for cloud in first], place, height)
    if lean > LEANS:
        raw.find("scanner-tilted", float(np.rad2deg(lean)), "its points are levelled")
    over, zero = ("floor", cut.floor) if cut.floor > -np.inf else ("scanner", 0.0)
    raw.find("cloud-sliced", {"topic": topic, "low": cut.low - zero, "high": cut.high - zero, "over": over})
    for cloud in chain(first, clouds):
        ranges, light = nearest(cloud.xyz, cloud.light, cut)
        yield RawScan(stamp(cloud.header, cloud.ns), ranges, light, cut.first, cut.step, 0.0, np.inf, pose)


class _Cloud(NamedTuple):
    ns: int
    header: Any
    xyz: Float[np.ndarray, "n 3"]
    light: Float[np.ndarray, " n"] | None


def _clouds(bag: Bag, topic: str, raw: RawLog) -> Iterator[_Cloud]:
    """One by one, since each may hold millions of points."""
    read, wrong = 0, "no message that can be unpacked"
    for _, ns, message in bag.messages({topic}):
        try:
            cloud = _Cloud(ns, message.header, *points_of(message))
        except DAMAGE as error:
            raw.dropped[BROKEN] += 1
            wrong = str(error) if isinstance(error, ValueError) else "clouds of another definition"
            continue
        read += 1
        yield cloud
    if bag.skipped:
        raw.dropped[UNPACKABLE] += bag.skipped
    if not read:
        raise ReaderError(bag.path, f"{topic}: {wrong}")


def sliced(
    clouds: Sequence[Float[np.ndarray, "_ 3"]], place: Rigid, height: Sequence[float] | None
) -> tuple[Slice, float]:
    """How clouds like these of a scanner at `place` on the robot are cut; how far [rad] it leans against the floor."""
    level = rotation_matrix(place[1])
    c, s = np.cos(_heading(level)), np.sin(_heading(level))
    level = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ level
    whole = [xyz[(np.abs(xyz) < FAR).all(axis=1)] for xyz in clouds]
    found, floor, lean = floor_of(np.concatenate([np.zeros((0, 3)), *whole]) @ level.T), -np.inf, 0.0
    if found is not None:
        turn, floor = found
        level, lean = turn @ level, float(np.arccos(min(1.0, turn[2, 2])))
    if height is not None:
        zero = floor if found is not None else -float(place[0][2])
        low, high = zero + height[0], zero + height[1]
    else:
        low, high = -ABOUT if found is None else floor + min(FLOOR_FREE, -0.5 * floor), ABOUT
    cut = Slice(level, low, high, floor, -np.pi, USUAL)
    seen = [p for xyz in whole if len(p := _within(xyz @ level.T, cut)[0])]
    first, step = _grid(np.arctan2(*max(seen, key=len).T[1::-1])) if seen else (-np.pi, USUAL)
    return cut._replace(first=first, step=step), lean


def _heading(turn: Float[np.ndarray, "3 3"]) -> float:
    """Where a scanner looks that is turned so [rad]: along x, or along z where that is not upright, as of a camera."""
    ahead = turn[:, 0] if abs(turn[2, 2]) > np.cos(np.pi / 4) else turn[:, 2]
    return float(np.arctan2(ahead[1], ahead[0]))


def nearest(
    xyz: Float[np.ndarray, "n 3"], light: Float[np.ndarray, " n"] | None, cut: Slice
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"] | None]:
    """Of every beam the range [m] in the plane to the nearest thing in the slice, infinite where none is; its light.

    Points of one thing are averaged: the nearest of many would lie the nearer the more there are.
    """
    sound = np.flatnonzero((np.abs(xyz) < FAR).all(axis=1))
    p, rows = _within(xyz[sound] @ cut.level.T, cut)
    n = round(2 * np.pi / cut.step)
    beam = np.rint((np.arctan2(p[:, 1], p[:, 0]) - cut.first) / cut.step).astype(np.intp) % n
    r = np.hypot(p[:, 0], p[:, 1])
    front = np.full(n, np.inf)
    np.minimum.at(front, beam, r)
    same = r <= front[beam] + ONE_THING
    count = np.bincount(beam[same], minlength=n)
    with np.errstate(invalid="ignore"):
        ranges = np.where(count > 0, np.bincount(beam[same], r[same], n) / count, np.inf)
        bright = None if light is None else np.bincount(beam[same], light[sound[rows]][same], n) / count
    return ranges, bright


def floor_of(p: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3 3"], float] | None:
    """The rotation that levels the floor seen in points [m], z about up, and its height then; None where none is seen.

    A plane through three points that holds most, by [Fischler81] in `LOOKS` tries of one seed. It is the floor where it
    goes on outwards, as the foot of a wall does not, and next to nothing lies beneath it.
    """
    below = p[(p[:, 2] < 0) & (np.hypot(p[:, 0], p[:, 1]) < FLOOR_REACH)]
    if len(below) < LEAST:
        return None
    rng = np.random.default_rng(0)
    q = below[rng.integers(len(below), size=min(len(below), SAMPLED))]
    a, b, c = q[rng.integers(len(q), size=(3, LOOKS))]
    up = np.cross(b - a, c - a)
    up *= np.sign(up[:, 2:]) / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-12)
    up, at = up[up[:, 2] > np.cos(STEEPEST)], a[up[:, 2] > np.cos(STEEPEST)]
    if not len(up):
        return None
    height = q[:SCORED] @ up.T - np.sum(up * at, axis=1)
    held = (np.abs(height) < FLAT).mean(axis=0) * ((height < -2 * FLAT).mean(axis=0) <= BENEATH)
    normal, middle = up[int(np.argmax(held))], at[int(np.argmax(held))]
    if held.max() < SHARE:
        return None
    for _ in range(3):
        on = q[np.abs((q - middle) @ normal) < FLAT]
        middle = on.mean(axis=0)
        normal = np.linalg.svd(on - middle, full_matrices=False)[2][2]
        normal = normal * np.sign(normal[2] or 1.0)
    floor = float(normal @ middle)
    on = q[np.abs(q @ normal - floor) < FLAT]
    seen = floor < -FLAT and normal[2] > np.cos(STEEPEST) and np.median(_outwards(on)) > OUTWARDS
    return (_onto_z(normal), floor) if seen else None


def _outwards(p: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " k"]:
    """How far [m] points reach outwards in each of the sectors that hold some."""
    sector = np.floor((np.arctan2(p[:, 1], p[:, 0]) + np.pi) * (SECTORS / (2 * np.pi))).astype(np.intp) % SECTORS
    r = np.hypot(p[:, 0], p[:, 1])
    far, near = np.full(SECTORS, -np.inf), np.full(SECTORS, np.inf)
    np.maximum.at(far, sector, r)
    np.minimum.at(near, sector, r)
    return np.asarray((far - near)[far > -np.inf])


def _onto_z(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The least rotation that turns the unit vector `up` (not down) onto z."""
    x, y, z = up
    w = np.sqrt((1.0 + z) / 2.0)
    return rotation_matrix(np.array([y / (2.0 * w), -x / (2.0 * w), 0.0, w]))


def _within(p: Float[np.ndarray, "n 3"], cut: Slice) -> tuple[Float[np.ndarray, "k 3"], np.ndarray]:
    """The points of the slice, levelled ones given, and which they are; what may be the floor is none of them."""
    r = np.hypot(p[:, 0], p[:, 1])
    clear = (
        -np.inf
        if cut.floor == -np.inf
        else cut.floor + np.minimum(0.5 * FLOOR_FREE + FLOOR_SLOPE * r, -0.5 * cut.floor)
    )
    rows = np.flatnonzero((p[:, 2] >= cut.low) & (p[:, 2] <= cut.high) & (p[:, 2] > clear) & (r > 0))
    return p[rows], rows


def _grid(angle: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """First angle and step [rad] of beams that points of these directions lie on, or near which they lie."""
    unlike = np.sort(angle)
    step = np.diff(unlike)
    step = step[step > SAME_WAY]
    if len(step) < LEAST_STEPS:
        return -np.pi, float(USUAL)
    usual = float(np.median(step))
    if FINEST <= usual <= COARSEST:
        k = np.rint((unlike - unlike[0]) / usual)
        slope, first = np.polyfit(k, unlike, 1)
        if np.abs(unlike - first - slope * k).max() < GRID * slope:
            n = 2 * np.pi / slope
            return float(first), float(slope if abs(n - round(n)) > GRID else 2 * np.pi / round(n))
    return -np.pi, 2 * np.pi / round(2 * np.pi / float(np.clip(usual, USUAL, COARSEST)))
