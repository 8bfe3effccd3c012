"""Position fixes from ROS recordings, and maps laid by them as files: GeoJSON, GeoTIFF, a table of the fixes.

Satellite receivers (`sensor_msgs/NavSatFix`) are sensors of the robot that carries them. Poses of others
(`geometry_msgs/PoseStamped`, `PoseWithCovarianceStamped`: motion capture, somebody's localisation) may be the truth, or
made of what is to be mapped: they are read where they are asked for by name, and nowhere else. Surveyed points that an
estimator is given are a table `id,x,y` or `id,x,y,sd` in metres.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, TiffImagePlugin

from ..core.errors import ReaderError
from ..core.findings import Finding
from ..core.fixes import EARTH, Fixes
from ..core.names import robot_name
from ..core.records import Track
from ..landmarks.landmark_map import LandmarkMap
from ..laser.laser_map import GridMap
from ..mapping.woven_map import Georeference
from .bag_robots import FIXES
from .ros_map import trinary
from .table import csv_rows, is_name, lines, write_table
from .transforms import Transforms
from .tum import write_track_covariance, write_tum


def read_points(path: Path) -> dict[str, tuple[float, float, float | None]]:
    """Landmark -> its place [m] and the standard deviation of each coordinate [m], None where that is not told.

    Raises ReaderError, with the line, for a table that is something else or tells a point twice.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ReaderError(path, f"cannot be read: {error.strerror}") from None
    rows = csv_rows(lines(data, str(path)), path)
    header = [name.strip().lower() for name in next(rows, [])]
    if header not in (["id", "x", "y"], ["id", "x", "y", "sd"]):
        raise ReaderError(
            path, f"expected the columns id,x,y or id,x,y,sd, found {','.join(header)[:200] or 'none'}", 1
        )
    out: dict[str, tuple[float, float, float | None]] = {}
    for line, row in enumerate(rows, 2):
        if not row or row[0].startswith("#"):
            continue
        name = row[0].strip()
        try:
            x, y, *rest = (float(word) for word in row[1:] if word.strip())
        except ValueError:
            x, y, rest = math.nan, math.nan, []
        good = is_name(name) and all(map(math.isfinite, (x, y, *rest))) and len(rest) <= len(header) - 3
        if not good or any(sd <= 0 for sd in rest):
            expected = f"{','.join(header)} with finite numbers, a sd above 0"
            raise ReaderError(path, f"expected {expected}, found {','.join(row)[:60]!r}", line)
        if name in out:
            raise ReaderError(path, f"{name} is surveyed twice", line)
        out[name] = (x, y, rest[0] if rest else None)
    if not out:
        raise ReaderError(path, "expected surveyed points, found none")
    return out


NAVSAT, *POSES = FIXES
NO_FIX, UNKNOWN = -1, 0  # of a NavSatFix: its status without satellites, its covariance that nobody knows
SAME_STAMP = "fix whose stamp comes again"
LARGEST = 1e9  # [m] and [m^2]: what is more was never measured
WGS84_CODE = 4326  # EPSG's number of latitude and longitude on WGS 84
# GeoTIFF 1.1, tags and keys: the transform from pixels, the directory of keys; a geographic model, pixels are areas.
TRANSFORM, KEYS = 34264, 34735
GEO_KEYS = (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, WGS84_CODE)


def topics_of_fixes(path: Path, own: Sequence[str], kinds: dict[str, str], asked: str | None) -> tuple[str, ...]:
    """Which of a robot's `own` topics are read: of receivers the fullest, or those `asked` for by name; none of `none`.

    Raises ReaderError for a topic that is not in the recording, or of a type that tells no position.
    """
    if asked is None:
        return tuple(topic for topic in own if kinds[topic] == NAVSAT)[:1]
    wanted = [word.strip() for word in asked.split(",") if word.strip() and word.strip() != "none"]
    there = {topic.strip("/"): topic for topic in kinds if kinds[topic] in {NAVSAT, *POSES}}
    for word in wanted:
        if word.strip("/") not in there:
            held = ", ".join(f"{topic} ({kinds[topic]})" for topic in there.values()) or "none"
            raise ReaderError(path, f"--fixes: no topic {word!r} that tells positions; there are {held}")
    mine = [there[word.strip("/")] for word in wanted if there[word.strip("/")] in own]
    return tuple(mine[:1])


def fix_row(t: float, message: Any) -> tuple[float, ...] | str:
    """Time [s], place (3) and covariance (xx, xy, yy) of a message; why it tells nothing, where it does not."""
    if hasattr(message, "latitude"):
        if message.status.status == NO_FIX:
            return "fix without satellites"
        height = float(message.altitude)
        place = float(message.latitude), float(message.longitude), height if np.isfinite(height) else 0.0
        c = message.position_covariance
        known = message.position_covariance_type != UNKNOWN
        cov = (float(c[0]), float(c[1]), float(c[4])) if known else (np.nan,) * 3
        if np.isfinite(place).all() and (abs(place[0]) > 90 or abs(place[1]) > 180):
            return "fix whose latitude or longitude cannot be"
        if place[:2] == (0.0, 0.0):
            return "fix at latitude 0, longitude 0"
    else:
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        place = float(pose.position.x), float(pose.position.y), float(pose.position.z)
        c = getattr(message.pose, "covariance", None)
        cov = (np.nan,) * 3 if c is None else (float(c[0]), float(c[1]), float(c[7]))
    if not np.isfinite(place).all() or max(map(abs, place)) > LARGEST:
        return "fix that is no number"
    xx, xy, yy = cov
    sound = np.isfinite(cov).all() and 0 < xx < LARGEST and 0 < yy < LARGEST and xx * yy > xy**2
    return t, *place, *(cov if sound else (np.nan,) * 3)


def fixes_of(
    rows: Sequence[tuple[float, ...] | str], topic: str, frame: str, antenna: Float[np.ndarray, "2"]
) -> Fixes | None:
    """The fixes of `fix_row`s in order of time, of one stamp the first; None where there are no messages."""
    if not rows:
        return None
    dropped = Counter(row for row in rows if isinstance(row, str))
    told = np.array([row for row in rows if not isinstance(row, str)], dtype=float).reshape(-1, 7)
    told = told[np.isfinite(told[:, 0])]
    _, first = np.unique(told[:, 0], return_index=True)
    if len(first) < len(told):
        dropped[SAME_STAMP] += len(told) - len(first)
    told = told[first]
    cov = told[:, [4, 5, 5, 6]].reshape(-1, 2, 2)
    return Fixes(told[:, 0], told[:, 1:4], cov, np.asarray(antenna, float), frame, topic, dict(dropped))


def read_fixes(
    rows: Sequence[tuple[float, ...] | str], topic: str, kind: str, header_frame: str, tf: Transforms, base: str
) -> Fixes | None:
    """`fixes_of`, the antenna where tf has it from the robot's frame `base`; else, and of poses, at the origin."""
    stands = tf.rigid_pose(base, header_frame) if kind == NAVSAT else None
    return fixes_of(rows, topic, frame_of(kind, header_frame), np.zeros(2) if stands is None else stands[0][:2])


def positions_read(topic: str, robot: str | None) -> Finding:
    """That poses by others were read."""
    return Finding("topics-chosen", robot, value=f"positions are read from {topic}, as input and not as truth")


def why_no_fixes(topic: str, kind: str, mine: Sequence[str]) -> str:
    """Why fixes were not read, of a robot whose topics are `mine`."""
    if topic not in mine:
        return "of another robot, or it is not told of which"
    if kind in POSES:
        return f"poses by others may be the truth; --fixes {topic} reads their positions as input"
    return f"another receiver is read, or none was asked for; --fixes {topic} reads this one"


def frame_of(kind: str, header_frame: str) -> str:
    """The world that fixes of this type are told in."""
    return EARTH if kind == NAVSAT else header_frame or "world"


def write_georeferenced(
    folder: Path,
    g: Georeference,
    tracks: Mapping[str, Track],
    grid: GridMap | None = None,
    landmarks: LandmarkMap | None = None,
) -> None:
    """Of a map that fixes place, `fixes.csv`, and in `world` trajectories there, with covariances.

    On the earth `trajectories.geojson`, with the landmarks, and `map.tif` of the occupancy, where there is one.
    """
    world = [robot_name(g.robots[k]) for k in g.owner.tolist()]
    rows = zip(g.t.tolist(), world, *g.z.T.tolist(), *g.residual.T.tolist(), g.used.astype(int).tolist(), strict=True)
    write_table(folder / "fixes.csv", ["t", "robot", "x", "y", "residual_x", "residual_y", "used"], rows)
    for robot, track in g.tracks.items():
        write_tum(folder / "world" / f"{robot_name(robot)}.tum", track)
        write_track_covariance(folder / "world" / f"{robot_name(robot)}.cov.csv", track)
    if g.datum is None:
        return
    told = geojson(tracks, g, landmarks)
    (folder / "trajectories.geojson").write_text(json.dumps(told) + "\n", encoding="utf-8")
    if grid is not None:
        write_geotiff(folder / "map.tif", grid, g)


def geojson(tracks: Mapping[str, Track], g: Georeference, landmarks: LandmarkMap | None = None) -> dict[str, Any]:
    """A line a robot and a point a landmark, longitude and latitude [deg] in nine decimals (0.1 mm) [RFC 7946]."""
    out = []
    for robot, track in tracks.items():
        if not len(track.t):
            continue
        line = np.round(g.places(track.pose[:, :2]), 9).tolist()
        told = {"robot": robot_name(robot), "from": float(track.t[0]), "to": float(track.t[-1])}
        shape = {"type": "LineString", "coordinates": line if len(line) > 1 else line * 2}
        out.append({"type": "Feature", "geometry": shape, "properties": told})
    if landmarks is not None:
        for name, at in zip(landmarks.ids, np.round(g.places(landmarks.mean), 9).tolist(), strict=True):
            point = {"type": "Point", "coordinates": at}
            out.append({"type": "Feature", "geometry": point, "properties": {"landmark": name}})
    return {"type": "FeatureCollection", "features": out}


def write_geotiff(path: Path, grid: GridMap, g: Georeference) -> None:
    """`path` is the occupancy (0 wall, 205 unknown, 254 free) with the transform from its pixels to degrees.

    The transform is that at the middle of the map: degrees are no plane, and a corner a kilometre away is off by
    decimetres.
    """
    picture = trinary(grid)
    rows, cols = picture.shape
    size, (x0, y0) = grid.resolution, grid.origin
    middle = np.array([x0 + 0.5 * size * cols, y0 + 0.5 * size * rows])
    at = g.places(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    J = np.stack([at[1] - at[0], at[2] - at[0]], axis=1)  # degrees a metre of the map's x and y
    M = np.zeros((4, 4))
    M[:2, 0], M[:2, 1], M[3, 3] = size * J[:, 0], -size * J[:, 1], 1.0
    M[:2, 3] = at[0] - 0.5 * (cols * M[:2, 0] + rows * M[:2, 1])
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[TRANSFORM], tags.tagtype[TRANSFORM] = tuple(M.ravel().tolist()), 12  # of doubles
    tags[KEYS], tags.tagtype[KEYS] = GEO_KEYS, 3  # of short integers
    Image.fromarray(picture).save(path, format="TIFF", tiffinfo=tags, compression="tiff_deflate")
