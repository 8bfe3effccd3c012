"""How far, which way and how much the matched scans moved, against the wheels: other units, a scanner mounted turned.

Scan matching needs the wheels for a first guess alone: where walls stand across the motion the matched poses move as
the scanner measured it, so that over short ways their motion over the wheels' is the factor between the two
instruments. In a corridor walls say nothing along the way, and the poses move as the wheels do: such ways are left out.
Turns are seen wherever there are walls.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.findings import Finding, turned_scanner
from ..core.records import Scan
from .beam import BeamConfig, Beams, beams

MOTION_TURN_SCALE = 0.08  # share of the wheels' turns by which the scans' may differ
MOTION_WALLS = 20  # that tell a motion, at least

MOTION_WAY = 0.5  # [m] by the wheels, of each way,
WAY_TURN = 0.5  # [rad] and at most turned in one
MOTION_ACROSS = 0.1  # share of what a scan's walls tell that must be told along the motion
MOTION_LEAST_RETURNS = 20  # on walls, in a scan
MOTION_TURN = 0.3  # [rad] by the wheels, of each turn
MOTION_STIFF = 1.5  # [rad] that scans turn while wheels that drive tell of none
MOTION_LEAST = 15  # ways, or turns, that are left
MOTION_PARTS = 12  # of the log, at most, whose scatter tells the standard error,
PART_OF = 5  # ways or turns, at least
MOTION_SURE = 4.0  # standard errors, and
MOTION_SCALE = 0.08  # of the wheels' way by which the scans' may differ,
MOTION_TURNED = 0.07  # [rad] by which its direction may,
MOTION_OTHER = 0.5  # of a way, or of a turn, by which a motion is another one
MOST_OTHER = 0.25  # share of ways that may be,
MOST_OTHER_TURNS = 0.5  # and of turns, which are short
MOTION_WALL = 0.8  # [rad] of a scan and more that one wall spans, whose straightness tells beams' angles,
MOTION_STRAIGHT = 0.1  # [m] root mean square from a line, at most, by one of the two angles,
MOTION_STRAIGHTER = 1.1  # times as straight as by the other
MOTION_SHARE = 0.8  # of which say the same
ALL_ROUND = 6.2  # [rad] of its beams from which on a scanner looks all round: angles that close cannot all be scaled

SCANS = 200  # whose walls are looked at
GUESSED = {"wheels-unlike", "scanner-askew", "scanner-turned"}  # what a reader finds before there is a map


@dataclass(frozen=True, slots=True)
class MotionRatio:
    """A median, its standard error, and of how many ways or turns."""

    value: float
    sd: float
    n: int

    def differs(self, other: float, by: float) -> bool:
        """Whether it differs from `other` by more than `by`, and by more than chance allows."""
        return abs(self.value - other) > max(by, MOTION_SURE * self.sd)


@dataclass(frozen=True, slots=True)
class MotionAgreement:
    """scale: of the scans' motion over the wheels'; direction: of it in the wheels' [rad], left positive; turn: of the
    scans' turns over the wheels'. None where too little tells it. other, other_turns: shares of ways and of turns in
    which scans and wheels move otherwise than by these. walls: where turns differ, the share of walls that are straight
    by the angles that the log states, rather than by those that the wheels' turns would make of them.
    """

    scale: MotionRatio | None = None
    direction: MotionRatio | None = None
    turn: MotionRatio | None = None
    other: float = 0.0
    other_turns: float = 0.0
    walls: float | None = None

    def findings(self, robot: str) -> tuple[Finding, ...]:
        """One for each that differs clearly and by more than instruments do."""
        out = []
        apart = self.other > MOST_OTHER or self.other_turns > MOST_OTHER_TURNS
        if apart:
            aside = 0.0 if self.direction is None else float(np.degrees(self.direction.value))
            told = {"ways": 100 * self.other, "turns": 100 * self.other_turns, "aside": aside}
            out.append(Finding("wheels-other", robot, value=told))
        if not apart and (s := self.scale) is not None and s.differs(1.0, MOTION_SCALE):
            out.append(Finding("wheels-scale", robot, value={"value": s.value, "sd": s.sd}))
        if not apart and (d := self.direction) is not None and d.differs(0.0, MOTION_TURNED):
            out.append(turned_scanner(robot, d.value, d.sd))
        same = self.other_turns <= MOST_OTHER_TURNS
        if same and (w := self.turn) is not None and w.differs(1.0, MOTION_TURN_SCALE):
            told = {"value": w.value, "sd": w.sd}
            if self.walls is not None and self.walls >= MOTION_SHARE:
                out.append(Finding("wheels-turns", robot, value=told))
            elif self.walls is not None and self.walls <= 1 - MOTION_SHARE:
                out.append(Finding("beams-apart", robot, value=told))
            else:
                out.append(Finding("turns-scale", robot, value=told))
        return tuple(out)

    def factor(self) -> float:
        """Of the wheels' ways that makes them as long as the scans', where such a factor is told; else 1."""
        clear = self.scale is not None and self.other <= MOST_OTHER and self.scale.differs(1.0, MOTION_SCALE)
        return self.scale.value if clear and self.scale is not None else 1.0


def instead_of(findings: Sequence[Finding], measured: Sequence[Finding]) -> tuple[Finding, ...]:
    """`findings` of the log's reader and what was measured after mapping, without the reader's guesses of the same."""
    better = any(f.code in {"wheels-scale", "scanner-askew", "scanner-turned"} for f in measured)
    return (*(f for f in findings if not (better and f.code in GUESSED)), *measured)


def motion_agreement(poses: Float[np.ndarray, "m 3"], scans: Sequence[Scan], beam: BeamConfig) -> MotionAgreement:
    """What the matched `poses` of `scans` tell of the motion that their odometry reports: medians over ways and turns.

    Standard errors come from how the medians of parts of the log scatter: wheels err for metres on end.
    """
    if not scans or scans[0].odometry is None:
        return MotionAgreement()
    wheels = np.array([scan.odometry for scan in scans], dtype=float)
    turned = _turned(poses, wheels)[:, None]
    driven = float(np.hypot(*np.diff(wheels[:, :2], axis=0).T).sum())
    stiff = not len(turned) and driven > MOTION_WAY and float(np.ptp(np.unwrap(poses[:, 2]))) > MOTION_STIFF
    motions = _motions(poses, wheels, scans, beam)
    turn, move = _measured(turned), _measured(motions)
    scale = direction = None
    if move is not None:
        along, left = move
        scale = MotionRatio(float(np.hypot(along.value, left.value)), along.sd, along.n)
        direction = MotionRatio(float(np.arctan2(left.value, along.value)), left.sd / max(scale.value, 1e-9), left.n)
    return MotionAgreement(
        scale,
        direction,
        None if turn is None else turn[0],
        0.0 if move is None else _other(motions),
        float(stiff) if turn is None else _other(turned),
        None if turn is None or not turn[0].differs(1.0, MOTION_TURN_SCALE) else straight(scans, turn[0].value),
    )


def straight(scans: Sequence[Scan], factor: float) -> float | None:
    """The share of walls that are straighter by the angles of `scans` than by `factor` times smaller ones.

    None where too few walls tell. Seen by wrong angles a wall across many beams is bent. 1 where the scanner looks all
    round, unless walls are bent.
    """
    stated, other = 0, 0
    for scan in scans[:: max(1, len(scans) // SCANS)]:
        angle = scan.angles()
        for wall in _walls(scan):
            here, there = (_off_line(scan.ranges[wall], angle[wall] / by) for by in (1.0, factor))
            stated += here <= MOTION_STRAIGHT and there > MOTION_STRAIGHTER * here
            other += there <= MOTION_STRAIGHT and here > MOTION_STRAIGHTER * there
    share = stated / (stated + other) if stated + other >= MOTION_WALLS else None
    closed = all(len(scan.ranges) * abs(scan.angle_increment) > ALL_ROUND for scan in scans)
    return 1.0 if closed and (share is None or share > 1 - MOTION_SHARE) else share


def _walls(scan: Scan) -> list[slice]:
    """Beams side by side that hit one thing, cut into pieces of `cfg.wall`."""
    r, n = scan.ranges, round(MOTION_WALL / max(abs(scan.angle_increment), 1e-6))
    if n < 5 or len(r) < n:
        return []
    joined = scan.hit[:-1] & scan.hit[1:] & (np.abs(np.diff(r)) < 0.25 * np.minimum(r[:-1], r[1:]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], joined.astype(np.int8), [0]])))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [slice(k, k + n) for first, last in runs for k in range(first, last + 2 - n, n)]


def _off_line(ranges: Float[np.ndarray, " n"], angle: Float[np.ndarray, " n"]) -> float:
    """[m] root mean square distance of points from the line that fits them best."""
    p = np.column_stack([ranges * np.cos(angle), ranges * np.sin(angle)])
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(np.cov(p.T, bias=True))[0])))


def _motions(
    poses: Float[np.ndarray, "m 3"],
    wheels: Float[np.ndarray, "m 3"],
    scans: Sequence[Scan],
    beam: BeamConfig,
) -> Float[np.ndarray, "n 2"]:
    """Of each way whose walls tell it: the scans' motion ahead and to the left of the wheels', over its length."""
    out = []
    seen: dict[int, Beams] = {}
    for i, j in ways(wheels):
        step = se2.between(wheels[i], wheels[j])
        length = float(np.hypot(step[0], step[1]))
        ahead = step[:2] / length
        after = se2.rotation(-float(step[2])) @ ahead
        seen = {k: seen[k] if k in seen else beams(scans[k], "none", None, beam) for k in (i, j)}
        if min(told_along(seen[i], ahead), told_along(seen[j], after)) >= MOTION_ACROSS:
            motion = se2.between(poses[i], poses[j])[:2] / length
            out.append([motion @ ahead, ahead[0] * motion[1] - ahead[1] * motion[0]])
    return np.array(out).reshape(-1, 2)


def _turned(poses: Float[np.ndarray, "m 3"], wheels: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " n"]:
    """Of each turn of the wheels, from where they have turned by `cfg.turn` to the next: the scans' over it."""
    by, seen = np.unwrap(wheels[:, 2]), np.unwrap(poses[:, 2])
    out, first = [], 0
    for k in range(len(by)):
        if abs(by[k] - by[first]) >= MOTION_TURN:
            out.append((seen[k] - seen[first]) / (by[k] - by[first]))
            first = k
    return np.array(out)


def _measured(values: Float[np.ndarray, "n k"]) -> tuple[MotionRatio, ...] | None:
    """Of each column; None where there are too few rows."""
    n = len(values)
    if n < MOTION_LEAST:
        return None
    parts = np.array_split(values, max(2, min(MOTION_PARTS, n // PART_OF)))
    scatter = np.std([np.median(part, axis=0) for part in parts], axis=0, ddof=1)
    sd = np.sqrt(np.pi / 2 / len(parts)) * scatter
    return tuple(MotionRatio(float(v), float(s), n) for v, s in zip(np.median(values, axis=0), sd, strict=True))


def _other(values: Float[np.ndarray, "n k"]) -> float:
    """The share of rows that are far from their median, or all if that is next to no motion."""
    middle = np.median(values, axis=0)
    if float(np.linalg.norm(middle)) < MOTION_OTHER / 2:
        return 1.0
    return float(
        np.mean(np.linalg.norm(values - middle, axis=1) > MOTION_OTHER * max(1.0, float(np.linalg.norm(middle))))
    )


def ways(wheels: Float[np.ndarray, "m 3"]) -> list[tuple[int, int]]:
    """(scan, later scan) between which the wheels drive `cfg.way` and turn little; none begins before the last ends."""
    place, heading = wheels[:, :2], np.unwrap(wheels[:, 2])
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(place, axis=0).T))])
    last = np.searchsorted(driven, driven + MOTION_WAY)
    there = np.minimum(last, len(wheels) - 1)
    chord = np.hypot(*(place[there] - place).T)
    straight = (np.abs(heading[there] - heading) <= WAY_TURN) & (chord >= MOTION_WAY / 2) & (chord <= 3 * MOTION_WAY)
    out, end = [], 0
    for i in np.flatnonzero(straight & (last < len(wheels))).tolist():
        if i >= end:
            end = int(there[i])
            out.append((i, end))
    return out


def told_along(b: Beams, direction: Float[np.ndarray, "2"]) -> float:
    """The share of what the walls of a scan tell that they tell along `direction`, in the robot's frame."""
    lined = b.support >= 3
    return float(np.mean((b.normal[lined] @ direction) ** 2)) if lined.sum() >= MOTION_LEAST_RETURNS else 0.0
