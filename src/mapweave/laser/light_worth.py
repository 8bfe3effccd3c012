"""What light is worth in a log: whether a place seen again from elsewhere looks as it did, and those beside it not.

A small residual of the calibration is no proof of that: what hangs on the scanner (a beam's own gain, a law of range
that is not quite right) moves along with the robot and would hold it where it stands. So returns of two scans are
compared whose scanner stood elsewhere: at the same place of the wall, and a decimetre beside it towards either side.
Light that belongs to the wall differs more on both sides; light that belongs to the robot differs less on the side it
came from. The laws of range and incidence are those of the other half of the windows, so that no return tells of a law
that was fitted to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from ..core import se2
from .beam import NO_LIGHT, Beams, IntensityCalibration

MOVED, TURNED = 0.1, 0.2  # [m] and [rad] between scans that are compared
MOST_WINDOWS = 30  # in which pairs are made
MOST_RETURNS = 120  # of a scan that are compared with another, about
APART = (0.15, 1.5)  # [m] along the wall between the places from which a pair of scans was taken
BESIDE = 0.1  # [m] along the wall
REACH = 0.03  # [m] a return this near is of the same place
LEAST_COSINE = 0.3  # of incidence: what grazes a wall more is left out
MOST_Q = 1.2  # greater features count as this,
CAP = 0.3  # of a difference of the feature: a greater one counts as this
SURE = 2.0  # standard errors by which the rest must be told
LEAST = 0.15  # share by which a place beside must differ more, when that is taken off
TOGETHER = 3  # scans of a window whose differences are taken to be alike
LEAST_ROWS, LEAST_PAIRS = 6, 100  # of such scans, and of returns, that must have been compared
PARTS = 4  # of the log, each of which must not be told to be worth nothing
LEVEL = 0.3  # [log units] by which light of the same places changes from one scan to the next where its unit does,
LEVEL_SURE = 8.0  # times what it changes otherwise,
LEVEL_RETURNS = 20  # from so many returns, and
LEVEL_SCANS = 20  # scans before and after it differ as well


@dataclass(frozen=True, slots=True)
class LightWorth:
    """repeat: root mean square difference of q in the same place seen again; beside: the same a decimetre away, on the
    side where it is less; excess: `beside^2 / repeat^2 - 1`; sd: its standard error; pairs: of returns; information
    [1/m^2]: of a return along its wall, 0 where nothing is told, and then why.
    """

    repeat: float = np.nan
    beside: float = np.nan
    excess: float = 0.0
    sd: float = np.nan
    pairs: int = 0
    information: float = 0.0
    why: str = ""


def worth(
    scans: Sequence[Beams],
    poses: Float[np.ndarray, "m 3"],
    laws: tuple[IntensityCalibration, IntensityCalibration],
    window: int,
) -> LightWorth:
    """What light tells along walls, from scans apart from each other and poses that are right over a window of them.

    laws: of light in windows with even numbers and in those with odd ones.
    """
    if (change := _level_change(scans, poses, laws[0])) > 1.0:
        return LightWorth(why=f"light changes its unit in the middle of the log, by a factor of {change:.1f}")
    starts = np.arange(0, len(scans), window)
    if len(starts) > MOST_WINDOWS:
        starts = starts[np.linspace(0, len(starts) - 1, MOST_WINDOWS).astype(int)]
    sums = []
    for start in starts.tolist():
        law = laws[1 - (start // window) % 2]
        sums.append(_sums(scans, poses, apart(poses, start, start + window, MOVED, TURNED), law))
    every = np.concatenate([np.zeros((0, 4)), *sums])
    return _judged(every[every[:, 3] > 0])


def apart(poses: Float[np.ndarray, "m 3"], start: int, stop: int, moved: float, turned: float) -> list[int]:
    """The scans from `start` to `stop` that lie `moved` [m] or `turned` [rad] from the last of them."""
    rows = [start] if len(poses) > start else []
    for k in range(start + 1, min(stop, len(poses))):
        d = se2.between(poses[rows[-1]], poses[k])
        if np.hypot(d[0], d[1]) >= moved or abs(d[2]) >= turned:
            rows.append(k)
    return rows


def _judged(sums: Float[np.ndarray, "b 4"]) -> LightWorth:
    pairs = int(sums[:, 3].sum())
    if len(sums) < LEAST_ROWS or pairs < LEAST_PAIRS:
        return LightWorth(
            pairs=pairs, why="no wall was seen again from elsewhere often enough to tell what light is worth"
        )
    excess, sd = _excess(sums)
    total = sums.sum(axis=0)
    repeat, beside = np.sqrt(total[0] / pairs), np.sqrt(total[1:3].min() / pairs)
    told = excess - SURE * sd
    why = ""
    if told < LEAST:
        told = 0.0
        why = "light along walls does not repeat better in the same place than a decimetre beside it"
    for part in np.array_split(sums, PARTS):
        if told and len(part) >= LEAST_ROWS and part[:, 3].sum() >= LEAST_PAIRS:
            own, own_sd = _excess(part)
            if own + SURE * own_sd < LEAST:
                told, why = 0.0, "in a part of the log light does not repeat better in the same place than beside it"
    return LightWorth(
        float(repeat), float(beside), excess, sd, pairs, max(excess, 0.0) / BESIDE**2 if told else 0.0, why
    )


def _excess(sums: Float[np.ndarray, "b 4"]) -> tuple[float, float]:
    """By which share the nearer of both sides differs more than the place itself, and the jackknife's error of it."""

    def of(total: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "..."]:
        return np.asarray(total[..., 1:3].min(axis=-1) / np.maximum(total[..., 0], 1e-12) - 1.0)

    whole = sums.sum(axis=0)
    n = len(sums)
    without = of(whole - sums)
    return float(of(whole)), float(np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum()))


def _walls(
    b: Beams, pose: Float[np.ndarray, "3"], law: IntensityCalibration
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Points, normals and features, in the poses' frame, of returns with light from walls not too much grazed."""
    keep = (b.support >= 3) & (b.intensity > 0) & (b.intensity != NO_LIGHT) & (b.c > LEAST_COSINE)
    q = law.feature(b.intensity[keep], b.r[keep], b.c[keep])
    return se2.act(pose, b.s[keep]), b.normal[keep] @ se2.rotation(float(pose[2])).T, q


def _sums(
    scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], rows: Sequence[int], law: IntensityCalibration
) -> Float[np.ndarray, "b 4"]:
    """A row for every `TOGETHER` scans, compared with all later ones: capped squared differences in the same place,
    beside it against the scanner's motion and along it, and how many returns were compared at all three.
    """
    seen = [_walls(scans[k], poses[k], law) for k in rows]
    trees = [cKDTree(points) if len(points) else None for points, _, _ in seen]
    out = np.zeros((len(rows) // TOGETHER + 1, 4))
    for i, tree in enumerate(trees):
        for j in range(i + 1, len(rows)):
            points, normal, q = (a[:: len(seen[j][2]) // MOST_RETURNS + 1] for a in seen[j])
            if tree is None or not len(points):
                continue
            along = np.column_stack([-normal[:, 1], normal[:, 0]])
            moved = along @ (poses[rows[j], :2] - poses[rows[i], :2])
            used = (np.abs(moved) >= APART[0]) & (np.abs(moved) <= APART[1])
            along = (along * np.sign(moved)[:, None])[used]
            squares, every = [], np.ones(int(used.sum()), bool)
            for lag in (0.0, -BESIDE, BESIDE):
                distance, at = tree.query(points[used] + lag * along, distance_upper_bound=REACH)
                at = np.where(np.isfinite(distance), at, 0)
                every &= np.isfinite(distance) & ((seen[i][1][at] * normal[used]).sum(axis=1) > 0.9)
                difference = np.minimum(q[used], MOST_Q) - np.minimum(seen[i][2][at], MOST_Q)
                squares.append(np.minimum(np.abs(difference), CAP) ** 2)
            out[i // TOGETHER] += [*(a[every].sum() for a in squares), every.sum()]
    return out


def _level_change(scans: Sequence[Beams], poses: Float[np.ndarray, "m 3"], law: IntensityCalibration) -> float:
    """By which factor light changes at once, in the same places and for good; 1 where it does not."""
    changes, levels, at_level = [], [], []
    tree, before = None, np.zeros(0)
    for k in range(len(scans)):
        points, _, q = _walls(scans[k], poses[k], law)
        if len(points) < LEVEL_RETURNS:
            continue
        if tree is not None:
            distance, at = tree.query(points, distance_upper_bound=REACH)
            near = np.isfinite(distance)
            if near.sum() >= LEVEL_RETURNS:
                changes.append(float(np.median(np.log(q[near] / before[np.asarray(at)[near]]))))
                at_level.append(len(levels))
        levels.append(float(np.median(np.log(q))))
        tree, before = cKDTree(points), q
    size = np.abs(changes)
    if not len(size) or size.max() <= max(LEVEL, LEVEL_SURE * 1.4826 * float(np.median(size))):
        return 1.0
    most = int(np.argmax(size))
    cut = at_level[most]
    stays = float(np.median(levels[cut : cut + LEVEL_SCANS]) - np.median(levels[max(0, cut - LEVEL_SCANS) : cut]))
    return float(np.exp(size[most])) if stays * np.sign(changes[most]) > 0.5 * size[most] else 1.0
