"""Two robots in one building, or in two, as the keyframes a mapper would give: what merging is tried on."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components, dijkstra

from mapweave.core import se2
from mapweave.core.config import config
from mapweave.core.errors import DataError
from mapweave.core.walls import Walls
from mapweave.kernels.walls.segments import cast
from mapweave.mapping.map_overlap import KeyframeMap

CELL = 0.3  # [m] of the raster robots walk on


@config
class PairConfig:
    """How both robots drive, see and err."""

    step: float = 0.4  # [m] between keyframes,
    turn: float = 0.4  # [rad] at most
    keyframes: int = 220  # a robot, about
    beams: int = 180
    opening: float = np.pi
    far: float = 20.0  # [m]
    noise: float = 0.015  # [m] of a range
    bend: float = 0.004  # [m] and
    bend_turn: float = 0.0008  # [rad] a keyframe: random walk of the map's own error
    clearance: float = 0.35  # [m] from walls


@dataclass(frozen=True, slots=True)
class MapPair:
    """Two maps, each in the frame of its own first keyframe.

    transform: T_a_b, the truth; overlap: true share of the walls of the one that saw less that the other saw too.
    """

    a: KeyframeMap
    b: KeyframeMap
    transform: Float[np.ndarray, "3"]
    overlap: float


def drive_pair(
    walls: Walls,
    lower: Float[np.ndarray, "2"],
    upper: Float[np.ndarray, "2"],
    share: float,
    rng: np.random.Generator,
    cfg: PairConfig | None = None,
) -> MapPair:
    """Two robots that roam in two parts of the box `lower` to `upper`, which share `share` of their length.

    Raises DataError when there is no free space to drive in.
    """
    cfg = cfg or PairConfig()
    axis = int(np.argmax(upper - lower))
    size = float((upper - lower)[axis])
    wide = size / (2.0 - share)  # each part's length: 2 wide - share wide = size
    parts = [(lower[axis], lower[axis] + wide), (upper[axis] - wide, upper[axis])]
    if rng.random() < 0.5:
        parts.reverse()
    ground = _Ground(walls, lower, upper, cfg.clearance)
    truths = [ground.roam(axis, part, cfg, rng) for part in parts]
    maps = [_mapped(f"robot{k + 1}", truth, walls, cfg, rng) for k, truth in enumerate(truths)]
    return MapPair(maps[0], maps[1], se2.between(truths[0][0], truths[1][0]), _overlap(truths, maps))


@dataclass(slots=True)
class _Ground:
    """The cells a robot may stand in, tied to their neighbours; the largest connected part."""

    middle: np.ndarray
    links: sp.csr_array

    def __init__(self, walls: Walls, lower: np.ndarray, upper: np.ndarray, clearance: float) -> None:
        cols, rows = (int(n) for n in np.floor((upper - lower) / CELL))
        x, y = np.meshgrid(lower[0] + (np.arange(cols) + 0.5) * CELL, lower[1] + (np.arange(rows) + 0.5) * CELL)
        middle = np.column_stack([x.ravel(), y.ravel()])
        free = (walls.clearance(middle) > clearance).reshape(rows, cols)
        number = np.arange(rows * cols).reshape(rows, cols)
        pairs = [
            np.column_stack([number[:, :-1][free[:, :-1] & free[:, 1:]], number[:, 1:][free[:, :-1] & free[:, 1:]]]),
            np.column_stack([number[:-1][free[:-1] & free[1:]], number[1:][free[:-1] & free[1:]]]),
        ]
        ends = np.concatenate(pairs)
        links = sp.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(rows * cols, rows * cols)).tocsr()
        label = connected_components(links, directed=False)[1]
        label[~free.ravel()] = -1
        if not free.any():
            raise DataError("there is no free space to drive in")
        keep = np.flatnonzero(label == np.bincount(label[label >= 0]).argmax())
        self.middle, self.links = middle[keep], links[keep][:, keep]

    def roam(
        self, axis: int, part: tuple[float, float], cfg: PairConfig, rng: np.random.Generator
    ) -> Float[np.ndarray, "n 3"]:
        """Keyframe poses on shortest paths between places chosen at random, inside the part."""
        inside = np.flatnonzero((self.middle[:, axis] >= part[0]) & (self.middle[:, axis] <= part[1]))
        if len(inside) < 4:
            raise DataError("there is no free space to drive in")
        links = self.links[inside][:, inside]
        label = connected_components(links, directed=False)[1]
        inside_one = np.flatnonzero(label == np.bincount(label).argmax())
        middle, links = self.middle[inside][inside_one], links[inside_one][:, inside_one]
        here, way = int(rng.integers(len(middle))), np.zeros((0, 2))
        while len(way) * CELL < 1.2 * cfg.keyframes * cfg.step:
            goal = int(rng.integers(len(middle)))
            before = dijkstra(links, directed=False, indices=np.array([goal]), return_predecessors=True)[1][0]
            steps = [here]
            while steps[-1] != goal:
                steps.append(int(before[steps[-1]]))
            way, here = np.concatenate([way, middle[steps[1:]]]), goal
        return _keyframes(_smoothed(way), cfg)


def _smoothed(way: np.ndarray) -> np.ndarray:
    """Corners of the raster cut: the mean over five cells."""
    padded = np.concatenate([way[:1], way[:1], way, way[-1:], way[-1:]])
    return np.asarray(np.mean([padded[k : k + len(way)] for k in range(5)], axis=0))


def _keyframes(way: np.ndarray, cfg: PairConfig) -> np.ndarray:
    """A pose every step or turn along `way`, looking ahead."""
    out: list[np.ndarray] = []
    for p, q in pairwise(way):
        d = q - p
        if np.hypot(*d) < 1e-6:
            continue
        pose = np.array([*p, np.arctan2(d[1], d[0])])
        if (
            not out
            or np.hypot(*(pose - out[-1])[:2]) >= cfg.step
            or abs(se2.wrap_angle(pose[2] - out[-1][2])) >= cfg.turn
        ):
            out.append(pose)
        if len(out) >= cfg.keyframes:
            break
    return np.array(out)


def _mapped(robot: str, truth: np.ndarray, walls: Walls, cfg: PairConfig, rng: np.random.Generator) -> KeyframeMap:
    """What a mapper would make of it: noisy points, poses that bend slowly, in the frame of the first keyframe."""
    angle = np.linspace(-0.5 * cfg.opening, 0.5 * cfg.opening, cfg.beams)
    ranges, what, _ = cast(truth, angle, walls.segments, np.zeros((len(truth), 0, 3)), cfg.far + 0.3)
    noisy = ranges + rng.normal(0.0, cfg.noise, ranges.shape)
    clouds = []
    for r, hit in zip(noisy, (what >= 0) & (ranges < cfg.far), strict=True):
        clouds.append(np.column_stack([r * np.cos(angle), r * np.sin(angle)])[hit])
    steps = se2.between(truth[:-1], truth[1:]) + rng.normal(
        0.0, [cfg.bend, cfg.bend, cfg.bend_turn], (len(truth) - 1, 3)
    )
    pose = [np.zeros(3)]
    for step in steps:
        pose.append(se2.compose(pose[-1], step))
    return KeyframeMap(robot, np.array(pose), clouds)


def _overlap(truths: list[np.ndarray], maps: list[KeyframeMap]) -> float:
    """True share of the walls of one map that the other saw too, the larger of the two."""
    cells = []
    for truth, m in zip(truths, maps, strict=True):
        seen = np.concatenate([se2.act(p, c) for p, c in zip(truth, m.points, strict=True)])
        cells.append({tuple(c) for c in np.floor(seen / 0.3).astype(int).tolist()})
    both = len(cells[0] & cells[1])
    return both / min(len(cells[0]), len(cells[1]))
