"""Maps as ROS navigation tools write them: `map.yaml` beside a PGM or PNG; and plain images as floor plans."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8
from PIL import Image, UnidentifiedImageError

from ..core.errors import ReaderError, UsageError
from ..core.paths import checked_arguments
from ..core.records import frozen
from ..core.walls import Walls, walls_of_raster
from ..laser.laser_map import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from ..laser.occupancy_mapper import Occupancy
from .directory import naming
from .table import open_text

UNKNOWN, FREE, OCCUPIED = -1, 0, 1
YAML_SUFFIXES = frozenset({".yaml", ".yml"})
KEYS = ("image", "resolution", "origin")
LARGEST = 1e9  # [m or m a pixel]: what a map says is less
SEEN = 10  # beams that a cell known to be free or occupied counts as
WHOLE = 1e-6  # of a cell: rounding by which a raster's width is not a cell more
BLACK, GREY, WHITE = 0, 205, 254
PLAIN = re.compile(r"[A-Za-z][\w.-]*")  # names that YAML takes for text as they are


@dataclass(frozen=True, slots=True)
class RosMap:
    """state: (rows, cols), row 0 lowest y, -1 unknown, 0 free, 1 occupied; resolution: cell side [m];

    origin: (3,), pose of the raster's lower left corner in the map.
    """

    state: Int8[np.ndarray, "rows cols"]
    resolution: float
    origin: Float[np.ndarray, "3"]

    def walls(self) -> Walls:
        """Solid walls round all that is not known to be free."""
        return walls_of_raster(self.state != FREE, self.origin, self.resolution)

    def free(self, points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Which of `points` [m] in the map lie on a cell known to be free."""
        c, s = np.cos(self.origin[2]), np.sin(self.origin[2])
        cells = np.floor((points - self.origin[:2]) @ np.array([[c, -s], [s, c]]) / self.resolution).astype(int)
        col, row = cells.T
        inside = (row >= 0) & (row < self.state.shape[0]) & (col >= 0) & (col < self.state.shape[1])
        out = np.zeros(len(points), dtype=bool)
        out[inside] = self.state[row[inside], col[inside]] == FREE
        return out

    def grid(self) -> GridMap:
        """The same cells as a map that scans made, upright whatever the heading: `SEEN` beams each, returned from the
        centres of those occupied and gone through those free.
        """
        lower, upper = self.extent()
        cols, rows = np.maximum(1, np.ceil((upper - lower) / self.resolution - WHOLE)).astype(int)
        hits, passes = np.zeros((2, rows, cols), np.int32)
        row, col = np.indices((rows, cols)).reshape(2, -1)
        centres = lower + self.resolution * (np.column_stack([col, row]) + 0.5)
        passes[row, col] = np.where(self.free(centres), SEEN, 0)
        mean, count = np.zeros((rows, cols, 2)), np.zeros((rows, cols))
        walls = self.occupied()
        col, row = np.clip(np.floor((walls - lower) / self.resolution).astype(int), 0, [cols - 1, rows - 1]).T
        np.add.at(mean, (row, col), walls)
        np.add.at(count, (row, col), 1.0)
        mean[count > 0] /= count[count > 0][:, None]
        hits[count > 0], passes[count > 0] = SEEN, 0
        return GridMap(self.resolution, lower, hits, passes, mean, np.zeros((rows, cols)), count)

    def occupied(self) -> Float[np.ndarray, "n 2"]:
        """The centres [m] of occupied cells in the map, row by row."""
        rows, cols = np.nonzero(self.state == OCCUPIED)
        c, s = np.cos(self.origin[2]), np.sin(self.origin[2])
        cells = (np.column_stack([cols, rows]) + 0.5) * self.resolution
        return np.asarray(cells @ np.array([[c, s], [-s, c]]) + self.origin[:2])

    def extent(self) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
        """Lower and upper corner [m] of the upright rectangle around the raster."""
        rows, cols = self.state.shape
        corners = np.array([[0, 0], [cols, 0], [0, rows], [cols, rows]]) * self.resolution
        c, s = np.cos(self.origin[2]), np.sin(self.origin[2])
        placed = corners @ np.array([[c, s], [-s, c]]) + self.origin[:2]
        return placed.min(axis=0), placed.max(axis=0)


def read_ros_map(path: Path, *, most_pixels: int | None = None) -> RosMap:
    """The map that `path` (map.yaml) describes, its image read from beside it.

    Raises ReaderError naming the file and what was expected when something is missing, damaged, out of range or larger
    than `most_pixels`.
    """
    header = _read_yaml(path)
    missing = [key for key in KEYS if key not in header]
    if missing:
        raise ReaderError(path, f"expected a ROS map with {', '.join(KEYS)}; {', '.join(missing)} is missing")
    mode = str(header.get("mode", "trinary")).lower()
    if mode not in ("trinary", "scale", "raw"):
        raise ReaderError(path, f"mode: expected trinary, scale or raw, found {mode!r}")
    resolution = _number(path, header, "resolution")
    if resolution <= 0:
        raise ReaderError(path, f"resolution: expected metres a pixel above 0, found {resolution:g}")
    pixels = _read_image(path.parent / str(header["image"]), most_pixels)
    if mode == "raw":
        p = np.where(pixels > 100, np.nan, pixels / 100.0)
    else:
        negate = header.get("negate", 0)
        if negate not in (0, 1, True, False):
            raise ReaderError(path, f"negate: expected 0 or 1, found {negate!r}")
        p = pixels / 255.0 if negate else (255.0 - pixels) / 255.0
    occupied = _number(path, header, "occupied_thresh", OCCUPIED_ABOVE)
    free = _number(path, header, "free_thresh", FREE_BELOW)
    if not 0 <= free <= occupied <= 1:
        raise ReaderError(path, f"expected 0 <= free_thresh <= occupied_thresh <= 1, found {free:g} and {occupied:g}")
    state = np.full(p.shape, UNKNOWN, dtype=np.int8)
    state[p < free] = FREE
    state[p > occupied] = OCCUPIED
    return RosMap(state, resolution, _origin(path, header["origin"]))


def read_plan(
    path: Path, resolution: float, origin: Float[np.ndarray, "3"], *, most_pixels: int | None = None
) -> RosMap:
    """A floor plan from a plain image: darker than half is wall, the rest is free. origin: lower left corner.

    Raises ReaderError for a damaged image and, before it is decoded, for one of more than `most_pixels`.
    """
    state = np.where(_read_image(path, most_pixels) < 127.5, OCCUPIED, FREE).astype(np.int8)
    return RosMap(state, resolution, frozen(origin))


def _read_image(path: Path, most_pixels: int | None) -> Float[np.ndarray, "rows cols"]:
    """Brightness 0..255 of every pixel, the lowest row of the picture first."""
    try:
        data = BytesIO(path.read_bytes())  # of a file itself a torn chunk's announced gigabytes would be made room for
        with Image.open(data) as image:
            if most_pixels is not None and image.width * image.height > most_pixels:
                size = f"{image.width} x {image.height}"
                raise ReaderError(path, f"expected at most {most_pixels:,} pixels, found {size}")
            deep = 65535.0 if image.mode.startswith("I") else 255.0
            image.load()
            if image.mode.startswith(("I", "F")):
                grey = np.asarray(image, dtype=float) * (255.0 / deep)
            else:
                grey = np.asarray(image.convert("RGB"), dtype=float).mean(axis=-1)
    except FileNotFoundError:
        raise ReaderError(path, "expected an image, found no such file") from None
    except (OSError, UnidentifiedImageError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise ReaderError(path, f"expected a PGM or PNG image: {error}") from None
    return np.ascontiguousarray(grey[::-1])


def _read_yaml(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML  # noqa: PLC0415  (only maps need it)
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    try:
        held = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ReaderError(path, f"expected a ROS map.yaml: {getattr(error, 'strerror', None) or error}") from None
    except (YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        what = getattr(error, "problem", None) or str(error)
        raise ReaderError(path, f"expected a ROS map.yaml: {what:.120}", mark and mark.line + 1) from None
    if not isinstance(held, dict):
        raise ReaderError(path, f"expected a ROS map with {', '.join(KEYS)}, found none")
    return held


def _number(path: Path, header: dict[str, Any], key: str, default: float | None = None) -> float:
    value = header.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise ReaderError(path, f"{key}: expected a number, found {value!r:.60}")
    return float(value)


def _origin(path: Path, value: Any) -> Float[np.ndarray, "3"]:
    good = isinstance(value, list) and len(value) in (2, 3) and all(isinstance(v, int | float) for v in value)
    if not good or not all(abs(v) < LARGEST for v in value):
        raise ReaderError(path, f"origin: expected [x, y, theta], found {value!r:.60}")
    return frozen([*map(float, value), 0.0][:3])


def write_ros_map(folder: Path, grid: GridMap, georeference: Mapping[str, Any] | None = None) -> None:
    """`map.pgm` (row 0 at the top, so highest y) and `map.yaml` in `folder`.

    georeference: where the map lies in the world; a key of its own, which map servers read over.
    """
    save_grid(grid, folder / "map.yaml")
    if georeference is not None:
        with (folder / "map.yaml").open("a", encoding="utf-8") as text:
            text.write(f"georeference: {json.dumps(georeference)}\n")


@checked_arguments
def save_grid(grid: GridMap, path: Path) -> None:
    """`path`, a .yaml, and the picture beside it; raises UsageError for another suffix."""
    if path.suffix.lower() not in YAML_SUFFIXES:
        raise UsageError(f"{path}: expected a name that ends in .yaml, beside which the picture goes")
    with naming(path):
        _write_picture(path, trinary(grid), grid.resolution, grid.origin)


GridMap.writer = save_grid


def write_ros_states(folder: Path, occupancy: Occupancy) -> None:
    """The same of a map whose cells are free, occupied or unknown already."""
    picture = np.full(occupancy.state.shape, GREY, dtype=np.uint8)
    picture[occupancy.free] = WHITE
    picture[occupancy.occupied] = BLACK
    _write_picture(folder / "map.yaml", np.ascontiguousarray(picture[::-1]), occupancy.resolution, occupancy.origin)


def _write_picture(
    path: Path, picture: UInt8[np.ndarray, "rows cols"], resolution: float, origin: Float[np.ndarray, "2"]
) -> None:
    rows, cols = picture.shape
    image = path.with_suffix(".pgm")
    with image.open("wb") as file:
        file.write(f"P5\n{cols} {rows}\n255\n".encode())
        file.write(picture.tobytes())
    with open_text(path) as text:
        text.write(
            f"image: {image.name if PLAIN.fullmatch(image.name) else json.dumps(image.name)}\n"
            f"mode: trinary\nresolution: {resolution:.9g}\n"
            f"origin: [{float(origin[0]):.9g}, {float(origin[1]):.9g}, 0.0]\n"
            f"negate: 0\noccupied_thresh: {OCCUPIED_ABOVE}\nfree_thresh: {FREE_BELOW}\n"
        )


def trinary(grid: GridMap) -> UInt8[np.ndarray, "rows cols"]:
    """Black where occupied, white where free, grey where not known; top row first."""
    shades = {-1: GREY, 0: WHITE, 100: BLACK}
    picture = np.zeros(grid.shape, dtype=np.uint8)
    for state, shade in shades.items():
        picture[grid.to_numpy() == state] = shade
    return np.ascontiguousarray(picture[::-1])
