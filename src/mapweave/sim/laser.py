"""A robot with a laser scanner driven through a world of walls and people: route, drift, beams; log and truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import brentq

from ..core import se2
from ..core.config import config
from ..core.fixes import Fixes, place_of
from ..core.laser_log import LaserLog
from ..core.records import Scan, Track, freeze, frozen
from ..core.se2 import representable_heading
from ..core.walls import Walls
from ..kernels.walls.segments import cast

DOOR_PAINT = (0.2, 0.45)  # reflectance of doors, between which each has its own
SCALE_LENGTH = 15.0  # [m] over which the scale error is correlated

SHINE = 30.0  # exponent of the cosine for light from surfaces hit squarely
WHITE = 40000.0  # intensity of white paint hit squarely from nearby: `gain` of the law
RANGE_STEP = 0.001  # [m] ranges are rounded to
BEAMS_ALIKE = 6.0  # [degrees] of neighbouring beams whose own gain is alike
MOTTLE_LENGTH = 0.5  # [m] of a piece of paint
DOOR_SHARE = 0.4  # of the objects on a wall; the others are posters
DOOR_WIDTH = 0.9  # [m]
POSTER_WIDTH = (0.3, 1.2)  # [m] from, to
POSTER_DARK, POSTER_BRIGHT = (0.05, 0.3), (0.75, 0.95)  # reflectance from, to, of one half each


@config
class Reflectance:
    """Light that returns: `gain (rho c^exponent + specular c^SHINE) / (1 + (r / falloff)^2)`, c = cos(incidence).

    Of a law that was fitted to a real scanner: what white paint hit squarely returns from each of `ranges`, between
    them by their logarithms and outside as at the ends, in place of `gain` and `falloff`.
    """

    falloff: float = 1.5  # [m] at which the light has halved
    exponent: float = 1.0  # of the cosine of incidence
    specular: float = 0.0  # share of light from surfaces hit squarely
    relative_noise: float = 0.03  # standard deviation, as a share of the intensity
    noise: float = 50.0  # standard deviation of the intensity, at least
    ranges: tuple[float, ...] = ()  # [m] at which a fitted law is held,
    light: tuple[float, ...] = ()  # and what returns from these, as the scanner counts
    beams: float = 0.0  # [log units] sd of the gain that each beam has of its own, which those beside it share
    least: float = 0.0  # weaker light is no return
    most: float = 1e9  # stronger light counts as this

    def from_white(self, r: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m n"]:
        """What white paint hit squarely returns from ranges r [m]."""
        if self.ranges:
            return np.asarray(np.exp(np.interp(np.log(r), np.log(self.ranges), np.log(self.light))))
        return np.asarray(WHITE / (1.0 + (r / self.falloff) ** 2))


SECOND_LAW = Reflectance(falloff=2.6, exponent=0.6, specular=0.25)
FITTED = (0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)  # [m] at which laws of real scanners are held
LDS01 = Reflectance(
    exponent=0.08,
    relative_noise=0.085,
    noise=0.0,
    ranges=FITTED,
    light=(13000.0, 11000.0, 7800.0, 5700.0, 4600.0, 3800.0, 2400.0, 1400.0, 910.0, 790.0, 770.0),
    beams=0.01,
    least=51.0,
    most=22606.0,
)
"""LDS-01 of a TurtleBot3: the median of four logs. `benchmarks/light_laws.py` fits this law and the next."""
NEATO = Reflectance(
    exponent=1.07,
    relative_noise=0.0,
    noise=0.0,
    ranges=FITTED,
    light=(2500.0, 2500.0, 1200.0, 630.0, 330.0, 140.0, 51.0, 25.0, 18.0, 14.0, 14.0),
    beams=0.193,
    least=10.0,
    most=1858.0,
)
"""Neato XV-11, of one log: what a place returns differs by what hangs on the beam that meets it."""
LAWS = {"spec": Reflectance(), "second": SECOND_LAW, "lds01": LDS01, "neato": NEATO}


@config
class Scanner:
    """URG-04LX as in its data sheet, every second step."""

    beams: int = 342  # of one revolution
    opening: float = np.radians(240.0)  # [rad] from the first beam to the last
    near: float = 0.02  # [m] nearest range measured
    far: float = 5.6  # [m] farthest range measured
    noise: float = 0.005  # [m], at least
    relative_noise: float = 0.01  # standard deviation, as a share of the range

    def angles(self) -> Float[np.ndarray, " n"]:
        """Beam directions as a receiver of the message works them out (32-bit first beam and step)."""
        return np.asarray(self.angle_min + self.angle_increment * np.arange(self.beams))

    @property
    def angle_min(self) -> float:
        return float(np.float32(-0.5 * self.opening))

    @property
    def angle_increment(self) -> float:
        return float(np.float32(self.opening / (self.beams - 1)))

    @property
    def range_max(self) -> float:
        return float(np.float32(self.far))


def measure(
    true_range: Float[np.ndarray, "m n"],
    what: Int[np.ndarray, "m n"],
    cosine: Float[np.ndarray, "m n"],
    reflectance: Float[np.ndarray, "m n"],
    scanner: Scanner,
    law: Reflectance,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """Ranges [m] and intensities as the scanner says them, 32-bit numbers; a range of `range_max` is no return."""
    shape = true_range.shape
    noise = rng.standard_normal((3, *shape))
    seen = what >= 0
    r = np.where(seen, true_range, scanner.far)
    sigma = np.maximum(scanner.noise, scanner.relative_noise * r)
    said = np.round((r + sigma * noise[0]) / RANGE_STEP) * RANGE_STEP
    light = law.from_white(r) * (reflectance * cosine**law.exponent + law.specular * cosine**SHINE)
    if law.beams > 0.0:
        light = light * np.exp(law.beams * _alike(shape[1], BEAMS_ALIKE / np.degrees(scanner.angle_increment), rng))
    light = np.maximum(0.0, light * (1.0 + law.relative_noise * noise[1]) + law.noise * noise[2])
    said = said.astype(np.float32).astype(float)
    seen &= (said > scanner.near) & (said < scanner.range_max) & (light >= law.least)
    light = np.minimum(light, law.most)
    return np.where(seen, said, scanner.range_max), np.where(seen, np.round(light), 0.0)


def _alike(n: int, width: float, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Numbers of unit variance, alike within `width` of each other and independent farther apart."""
    half = max(1, round(width))
    bell = np.exp(-0.5 * (np.arange(-2 * half, 2 * half + 1) / (0.5 * half)) ** 2)
    drawn = np.convolve(rng.standard_normal(n + len(bell) - 1), bell, "valid")
    return np.asarray(drawn / np.sqrt(np.square(bell).sum()))


Stretch = tuple[float, float, float, float]  # from, to [m] along a wall; reflectance; depth behind the wall line [m]


@dataclass(frozen=True, slots=True)
class LaserWorld(Walls):
    """Walls with a name, for a laser to look at.

    shown: (s,) cosine of incidence from which on a wall returns light, which passes it at more of a slant: of glass;
    None where all are opaque.
    """

    name: str = "world"
    shown: Float[np.ndarray, " s"] | None = None

    def __post_init__(self) -> None:
        Walls.__post_init__(self)
        freeze(self, "shown")


@dataclass(frozen=True, slots=True, kw_only=True)
class WallStyle:
    """Paint with objects on it: gaps of paint, then a door or a poster, then paint again."""

    gap: tuple[float, float] = (0.8, 3.5)  # [m] of paint between objects
    paint: float = 0.6
    mottle: float = 0.03  # relative spread of the paint from piece to piece


class WorldBuilder:
    """Walls put up one by one; `world` is what stands at the end."""

    def __init__(self, name: str, style: WallStyle, rng: np.random.Generator) -> None:
        self.name, self.style, self.rng = name, style, rng
        self.shown = 0.0  # of the walls put up next, see `LaserWorld`
        self._segments: list[tuple[float, float, float, float]] = []
        self._reflectance: list[float] = []
        self._shown: list[float] = []

    def segment(self, a: np.ndarray, b: np.ndarray, reflectance: float) -> None:
        self._segments.append((float(a[0]), float(a[1]), float(b[0]), float(b[1])))
        self._reflectance.append(reflectance)
        self._shown.append(self.shown)

    def wall(self, a: tuple[float, float], b: tuple[float, float], *, recess: float = 0.0) -> None:
        """A wall from a to b, free space on its left, with objects; doors stand back by `recess` [m]."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        self._put(a, b, self._objects(length, recess))

    def plain(self, a: tuple[float, float], b: tuple[float, float], reflectance: float | None = None) -> None:
        """A wall of paint alone, or of one reflectance throughout."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        self._put(a, b, self._paint(0.0, length) if reflectance is None else [(0.0, length, reflectance, 0.0)])

    def marked(self, a: tuple[float, float], b: tuple[float, float], marks: list[Stretch]) -> None:
        """A painted wall that carries `marks` (ascending, apart from each other)."""
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        out, at = [], 0.0
        for mark in marks:
            out += [*self._paint(at, mark[0]), mark]
            at = mark[1]
        self._put(a, b, out + self._paint(at, length))

    def box(self, x: float, y: float, wide: float, deep: float, reflectance: float) -> None:
        """A closed box with its lower left corner at x, y."""
        corners = [(x, y), (x + wide, y), (x + wide, y + deep), (x, y + deep), (x, y)]
        for a, b in pairwise(corners):
            self.segment(np.array(a), np.array(b), reflectance)

    def world(self) -> LaserWorld:
        shown = np.array(self._shown) if any(self._shown) else None
        return LaserWorld(np.array(self._segments), np.array(self._reflectance), name=self.name, shown=shown)

    def _objects(self, length: float, recess: float) -> list[Stretch]:
        style, rng = self.style, self.rng
        out: list[Stretch] = []
        at = 0.0
        while True:
            start = at + rng.uniform(*style.gap)
            if rng.random() < DOOR_SHARE:
                end, light, depth = start + DOOR_WIDTH, rng.uniform(*DOOR_PAINT), recess
            else:
                end = start + rng.uniform(*POSTER_WIDTH)
                light = rng.uniform(*(POSTER_DARK if rng.random() < 0.5 else POSTER_BRIGHT))
                depth = 0.0
            if end > length - 0.2:
                return out + self._paint(at, length)
            out += [*self._paint(at, start), (start, end, float(light), depth)]
            at = end

    def _paint(self, start: float, end: float) -> list[Stretch]:
        style = self.style
        if end - start < 1e-9:
            return []
        cuts = np.linspace(start, end, max(1, round((end - start) / MOTTLE_LENGTH)) + 1)
        light = style.paint * (1.0 + style.mottle * self.rng.standard_normal(len(cuts) - 1))
        return [(float(p), float(q), float(v), 0.0) for p, q, v in zip(cuts, cuts[1:], light, strict=False)]

    def _put(self, a: tuple[float, float], b: tuple[float, float], stretches: list[Stretch]) -> None:
        start = np.array(a, dtype=float)
        along = np.array(b, dtype=float) - start
        along /= np.hypot(*along)
        behind = np.array([along[1], -along[0]])
        for p, q, light, depth in stretches:
            u, v = start + p * along, start + q * along
            if depth > 0:
                self.segment(u, u + depth * behind, self.style.paint)
                self.segment(v + depth * behind, v, self.style.paint)
            self.segment(u + depth * behind, v + depth * behind, light)


@dataclass(frozen=True, slots=True)
class Route:
    """Pieces of constant curvature from `start` on. length: (k,) [m]; curvature: (k,) [1/m], to the left."""

    start: Float[np.ndarray, "3"]
    length: Float[np.ndarray, " k"]
    curvature: Float[np.ndarray, " k"]

    def __post_init__(self) -> None:
        freeze(self, "start", "length", "curvature")

    @property
    def total(self) -> float:
        return float(self.length.sum())

    def poses(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Poses (n, 3) at the distances `s` [m] from the start; beyond the end the last piece goes on."""
        ends = np.cumsum(self.length)
        corner = [np.asarray(self.start)]
        for span, bend in zip(self.length, self.curvature, strict=True):
            corner.append(se2.compose(corner[-1], se2.exp(np.array([span, 0.0, span * bend]))))
        piece = np.minimum(np.searchsorted(ends, s, side="right"), len(ends) - 1)
        rest = s - (ends[piece] - self.length[piece])
        twist = np.column_stack([rest, np.zeros_like(rest), rest * self.curvature[piece]])
        return se2.compose(np.array(corner)[piece], se2.exp(twist))


def ring(wide: float, high: float, radius: float, distance: float, start: float) -> Route:
    """Round a rectangle `wide` x `high` [m] to the left, corners rounded, `distance` [m] long.

    It begins at the origin heading along +x, `start` [m] after the lower left corner.
    """
    arc = (0.5 * np.pi * radius, 1.0 / radius)
    first = (wide - start - radius, 0.0)
    lap = [arc, (high - 2 * radius, 0.0), arc, (wide - 2 * radius, 0.0), arc, (high - 2 * radius, 0.0), arc]
    pieces = [first, *lap]
    while sum(length for length, _ in pieces) < distance:
        pieces += [(wide - 2 * radius, 0.0), *lap]
    return _cut(np.zeros(3), pieces, distance)


def through(points: Sequence[tuple[float, float]], radius: float) -> Route:
    """Past the `points` [m], corners rounded with `radius` [m] or as the legs allow; no leg turns straight back."""
    P = np.array(points, dtype=float)
    legs = np.diff(P, axis=0)
    length = np.hypot(legs[:, 0], legs[:, 1])
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turn = se2.wrap_angle(np.diff(heading))
    half = np.tan(0.5 * np.abs(turn))
    room = 0.5 * np.minimum(length[:-1], length[1:])
    bend = np.minimum(radius, room / np.maximum(half, 1e-9))
    cut = np.concatenate([[0.0], bend * half, [0.0]])
    pieces = []
    for k in range(len(legs)):
        pieces.append((float(length[k] - cut[k] - cut[k + 1]), 0.0))
        if k < len(turn) and abs(turn[k]) > 1e-9:
            pieces.append((float(bend[k] * abs(turn[k])), float(np.sign(turn[k]) / bend[k])))
    return _cut(np.array([P[0, 0], P[0, 1], heading[0]]), pieces, float("inf"))


def _cut(start: np.ndarray, pieces: Sequence[tuple[float, float]], distance: float) -> Route:
    kept: list[tuple[float, float]] = []
    left = distance
    for length, bend in pieces:
        if left <= 0:
            break
        if length > 1e-9:
            kept.append((min(length, left), bend))
            left -= length
    lengths, bends = zip(*kept, strict=True)
    return Route(start, np.array(lengths), np.array(bends))


MOST_BIAS = np.radians(0.8)  # [rad/m]


@config
class DriftConfig:
    scale: float = 0.03  # standing deviation of the scale error, an Ornstein-Uhlenbeck process
    translation: float = 0.005  # [m per sqrt(m)]
    rotation: float = np.radians(0.3)  # [rad per sqrt(m)]
    end_error: tuple[float, float] | None = (15.0, 20.0)  # [m]; the heading bias is chosen for it; None: no bias


def drifted(
    truth: Float[np.ndarray, "n 3"], cfg: DriftConfig, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """`T_odom_robot` (n, 3) along `truth`, from the origin, and the heading bias [rad/m] that was chosen.

    The bias is the smallest, left or right, with which the last pose errs by a draw from `end_error`; where none up to
    0.8 degrees a metre does, the one that comes nearest.
    """
    step = se2.log(se2.between(truth[:-1], truth[1:]))
    ds = np.abs(step[:, 0])
    n = len(ds)
    noise = rng.standard_normal((n, 3))
    shock = rng.standard_normal(n)
    scale = np.empty(n)
    now = cfg.scale * float(rng.standard_normal())
    for k in range(n):
        keep = np.exp(-ds[k] / SCALE_LENGTH)
        now = now * keep + cfg.scale * np.sqrt(max(0.0, 1 - keep * keep)) * shock[k]
        scale[k] = now
    root = np.sqrt(ds)
    u = step.copy()
    u[:, 0] += step[:, 0] * scale + cfg.translation * root * noise[:, 0]
    u[:, 1] += cfg.translation * root * noise[:, 1]
    u[:, 2] += cfg.rotation * root * noise[:, 2]
    bias = 0.0
    if cfg.end_error is not None:
        bias = _bias_for(u, ds, truth, float(rng.uniform(*cfg.end_error)))
        u[:, 2] += bias * ds
    poses = _integrated(u)
    poses[:, 2] = [representable_heading(float(theta)) for theta in poses[:, 2]]
    return poses, bias


def _bias_for(u: np.ndarray, ds: np.ndarray, truth: np.ndarray, wanted: float) -> float:
    end = se2.between(truth[0], truth[-1])[:2]

    def miss(bias: float) -> float:
        v = u.copy()
        v[:, 2] += bias * ds
        return float(np.hypot(*(_integrated(v)[-1, :2] - end))) - wanted

    tried = np.linspace(-MOST_BIAS, MOST_BIAS, 161)
    missed = np.array([miss(bias) for bias in tried])
    roots = np.flatnonzero(missed[:-1] * missed[1:] <= 0)
    if not len(roots):
        return float(tried[np.argmin(np.abs(missed))])
    k = roots[np.argmin(np.abs(tried[roots] + tried[roots + 1]))]
    return float(brentq(miss, tried[k], tried[k + 1], xtol=1e-9))


def _integrated(u: np.ndarray) -> np.ndarray:
    """Poses (n + 1, 3) from the origin through the twists u (n, 3)."""
    theta = np.concatenate([[0.0], np.cumsum(u[:, 2])])
    local = se2.exp(u)
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    dx = c * local[:, 0] - s * local[:, 1]
    dy = s * local[:, 0] + c * local[:, 1]
    return np.column_stack(
        [np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)]), se2.wrap_angle(theta)]
    )


START_NS = 1_000_000_000_000  # logs begin at 1000 s


@config
class DriveConfig:
    """How the world is driven and seen."""

    scan_every: float = 0.25  # [m]
    odometry_every: float = 0.05  # [m]; a whole part of `scan_every`
    speed: float = 0.5  # [m/s]
    people: int = 0
    sweep: float = 0.0  # [s] that a scan takes, its stamp in the middle; negative: its beams are given in reverse
    sensor_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # T_robot_sensor
    scanner: Scanner = Scanner()
    law: Reflectance = Reflectance()
    drift: DriftConfig = DriftConfig()


@dataclass(frozen=True, slots=True)
class LaserSimulation:
    """What was driven. truth: poses in the world's frame at every stamp of the log.

    reflectance: (m, n), the true one of what each beam of each scan hit, 0 where nothing came back.
    """

    log: LaserLog
    truth: Track
    reflectance: Float[np.ndarray, "m n"]
    world: LaserWorld
    heading_bias: float


def drive(world: LaserWorld, route: Route, cfg: DriveConfig, seed: int) -> LaserSimulation:
    """The log of one drive along `route`, the same for the same seed.

    Walls, odometry, scanner and people draw from streams of their own: changing one leaves the others as they were.
    """
    each = max(1, round(cfg.scan_every / cfg.odometry_every))
    step = cfg.scan_every / each
    s = step * np.arange(int(route.total / step + 1e-9) + 1)
    t = (START_NS + np.round(s / cfg.speed * 1e9).astype(np.int64)) / 1e9
    truth = route.poses(s)
    odometry, bias = drifted(truth, cfg.drift, stream(seed, "odometry"))
    x, y, theta = cfg.sensor_pose
    T_robot_sensor = frozen([x, y, representable_heading(theta)])
    at = np.arange(0, len(s), each)
    discs, clothes = walking(cfg.people, route, t[at], truth[at], stream(seed, "people"))
    true_range, what, cosine = _cast(world, cfg, Track(t, truth, frame="world"), at, T_robot_sensor, discs)
    surface = np.concatenate([world.reflectance, clothes, [0.0]])
    rho = surface[what]
    ranges, light = measure(true_range, what, cosine, rho, cfg.scanner, cfg.law, stream(seed, "scanner"))
    hit = ranges < cfg.scanner.range_max
    scans = tuple(
        Scan(
            frozen(ranges[k]),
            frozen(hit[k], dtype=bool),
            frozen(light[k]),
            cfg.scanner.angle_min,
            cfg.scanner.angle_increment,
            cfg.scanner.range_max,
            T_robot_sensor,
            "",
            frozen(odometry[i]),
        )
        for k, i in enumerate(at.tolist())
    )
    rows = Track(t, odometry, frame="odom")
    log = LaserLog("1", f"simulated {world.name}, seed {seed}", t[at], scans, rows, sweep=abs(cfg.sweep))
    return LaserSimulation(log, Track(t, truth, frame="world"), frozen(np.where(hit, rho, 0.0)), world, bias)


def _cast(
    world: LaserWorld,
    cfg: DriveConfig,
    truth: Track,
    at: Int[np.ndarray, " m"],
    T_robot_sensor: Float[np.ndarray, "3"],
    discs: Float[np.ndarray, "m d 3"],
) -> tuple[Float[np.ndarray, "m n"], Int[np.ndarray, "m n"], Float[np.ndarray, "m n"]]:
    """What `cast` gives of the scans at rows `at` of `truth`; where they take their time each beam is on its own."""
    angles, far = cfg.scanner.angles(), cfg.scanner.far + 0.3
    walls = world.segments if world.shown is None else frozen(np.column_stack([world.segments, world.shown]))
    if cfg.sweep == 0.0:
        return cast(se2.compose(truth.pose[at], T_robot_sensor), angles, walls, discs, far)
    n = len(angles)
    beam_t = truth.t[at][:, None] + cfg.sweep * (np.arange(n) / (n - 1) - 0.5)
    sensor = se2.compose(se2.interpolate(beam_t.ravel(), truth.t, truth.pose), T_robot_sensor)
    sensor[:, 2] += np.tile(angles, len(at))
    alone = cast(sensor, np.zeros(1), walls, np.repeat(discs, n, axis=0), far)
    true_range, what, cosine = (part.reshape(len(at), n) for part in alone)
    return true_range, what, cosine


def stream(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for each purpose."""
    return np.random.default_rng([seed, *purpose.encode()])


RADIUS, SPEED, ASIDE, APART = 0.22, (0.6, 1.4), 0.6, 0.6  # [m], [m/s], [m] off the line, [m] kept from the robot


def walking(
    count: int, route: Route, t: Float[np.ndarray, " m"], robot: Float[np.ndarray, "m 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "m d 3"], Float[np.ndarray, " d"]]:
    """Discs (m, d, 3) as x y radius at the times `t` [s], and the reflectance (d,) of their clothes.

    Each walks at its own speed between the ends of the route, turning round there; one that would stand in the robot
    is not there (radius 0).
    """
    total = route.total
    speed = rng.uniform(*SPEED, count) * np.where(rng.random(count) < 0.5, 1.0, -1.0)
    start, aside = rng.uniform(0, total, count), rng.uniform(-ASIDE, ASIDE, count)
    discs = np.zeros((len(t), count, 3))
    for k in range(count):
        way = np.abs((start[k] + speed[k] * (t - t[0]) + total) % (2 * total) - total)
        poses = route.poses(way)
        discs[:, k, 0] = poses[:, 0] - aside[k] * np.sin(poses[:, 2])
        discs[:, k, 1] = poses[:, 1] + aside[k] * np.cos(poses[:, 2])
        free = np.hypot(discs[:, k, 0] - robot[:, 0], discs[:, k, 1] - robot[:, 1]) > APART
        discs[:, k, 2] = np.where(free, RADIUS, 0.0)
    return discs, rng.uniform(0.1, 0.7, count)


DATUM = np.array([35.7, 139.75, 40.0])
"""Latitude [deg], longitude [deg], height [m] of the point from which simulated worlds measure east and north."""
EVERY = 1.0  # [s] from fix to fix
JUMPS, JUMP = 0.03, 60.0  # share of fixes that lie elsewhere, and sd of how far [m] on either axis
DRIVES_APART = 150.0  # [m] sd of where a drive begins, on either axis


def placed(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """Where a simulated world lies east and north of `DATUM`, and how it is turned."""
    return np.array([*(DRIVES_APART * rng.standard_normal(2)), rng.uniform(-np.pi, np.pi)])


def simulated_fixes(truth: Track, sd: float, rng: np.random.Generator) -> Fixes:
    """The fixes of a robot that drives along `truth` (east and north of `DATUM`), with `sd` [m] on either axis."""
    t = np.arange(truth.t[0] + rng.uniform(0.0, EVERY), truth.t[-1], EVERY)
    xy = se2.interpolate(t, truth.t, truth.pose)[:, :2] + sd * rng.standard_normal((len(t), 2))
    xy = xy + (rng.random(len(t)) < JUMPS)[:, None] * JUMP * rng.standard_normal((len(t), 2))
    place = place_of(np.column_stack([xy, np.zeros(len(t))]), DATUM)
    return Fixes(t, place, np.tile(sd**2 * np.eye(2), (len(t), 1, 1)), topic="/fix")
