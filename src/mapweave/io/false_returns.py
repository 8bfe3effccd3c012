"""Returns that are no walls: the robot's own body, and a greatest range that stands for nothing seen.

Matched as walls they hold the robot in its place: what it carries along never moves against it, and a ring of greatest
ranges stands round it wherever it is.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.config import config
from ..core.records import Scan, frozen

OWN = "return of the robot itself"
GREATEST = "greatest range, which stands for no return"


@config
class FalseReturnConfig:
    """When returns are the robot's own, and when a greatest range is none."""

    near: float = 1.0  # [m] and nearer: the robot itself
    same: float = 0.03  # [m] about its middle a beam's range stays there,
    share: float = 0.9  # in so many of the places looked at,
    beside: float = 0.3  # or in so many beside such a beam: edges flicker
    apart: float = 0.25  # [m] or [rad] from one place to the next
    places: int = 20  # at least, and
    most_places: int = 200  # at most
    turned: float = 6.0  # [rad] in all from place to place: driving straight, walls stay where they are, too
    scans: int = 20  # at least, and
    equal_share: tuple[float, float] = (0.02, 0.9)  # of their returns that have exactly the greatest range of all,
    times: float = 20.0  # as many as have any one range
    below: float = 0.1  # of it beneath, on average


def without_false_returns(
    scans: Sequence[Scan], cfg: FalseReturnConfig | None = None
) -> tuple[list[Scan], Counter[str]]:
    """The scans without such returns, and how many of either kind were left out. Needs `Scan.odometry` for its own."""
    cfg = cfg or FalseReturnConfig()
    out, count = list(scans), Counter[str]()
    for rows in _alike(scans):
        if len(rows) < cfg.scans:
            continue
        group = [scans[k] for k in rows]
        far = stands_for_nothing(np.concatenate([scan.ranges[scan.hit] for scan in group]), cfg)
        depth = own_body(group, cfg)
        for k in rows:
            scan = out[k]
            greatest, own = scan.hit & (scan.ranges >= far), scan.hit & (scan.ranges <= depth)
            if greatest.any() or own.any():
                count.update({GREATEST: int(greatest.sum()), OWN: int((own & ~greatest).sum())})
                out[k] = _without(scan, greatest | own)
    return out, +count


def stands_for_nothing(ranges: Float[np.ndarray, " n"], cfg: FalseReturnConfig) -> float:
    """The greatest of `ranges` where far more returns have exactly it than any other range near it, else infinite."""
    if not len(ranges):
        return np.inf
    top = float(ranges.max())
    equal = int((ranges == top).sum())
    below = ranges[(ranges < top) & (ranges >= (1.0 - cfg.below) * top)]
    usual = len(below) / max(1, len(np.unique(below)))
    least, most = cfg.equal_share
    few = equal < max(least * len(ranges), cfg.times * usual) or equal > most * len(ranges)
    return np.inf if few else top


def own_body(scans: Sequence[Scan], cfg: FalseReturnConfig) -> Float[np.ndarray, " n"]:
    """Up to which range [m] each beam sees the robot itself; minus infinity for beams that see past it.

    scans: of one scanner with the same beams. A beam sees the robot where its range is near and stays the same
    wherever the robot stands and turns.
    """
    none = np.full(len(scans[0].ranges), -np.inf)
    rows = _places(scans, cfg)
    if len(rows) < cfg.places:
        return none
    heading = np.array([scans[k].odometry[2] for k in rows])  # type: ignore[index]
    if np.abs(se2.wrap_angle(np.diff(heading))).sum() < cfg.turned:
        return none
    rows = rows[:: max(1, len(rows) // cfg.most_places)]
    ranges, hit = np.array([scans[k].ranges for k in rows]), np.array([scans[k].hit for k in rows])
    middle = np.median(np.where(hit, ranges, np.inf), axis=0)
    stays = (hit & (np.abs(ranges - np.where(middle < np.inf, middle, -1.0)) <= cfg.same)).mean(axis=0)
    own = (middle <= cfg.near) & (stays >= cfg.share)
    beside = (middle <= cfg.near) & (stays >= cfg.beside) & (np.roll(own, 1) | np.roll(own, -1))
    return np.asarray(np.where(own | beside, middle + 2 * cfg.same, -np.inf))


def _alike(scans: Sequence[Scan]) -> Iterator[list[int]]:
    """The scans of each scanner that have ranges, by how their beams lie."""
    groups: dict[tuple[bytes, int, float, float], list[int]] = {}
    for k, scan in enumerate(scans):
        if len(scan.ranges):
            beams = scan.T_robot_sensor.tobytes(), len(scan.ranges), scan.angle_min, scan.angle_increment
            groups.setdefault(beams, []).append(k)
    return iter(groups.values())


def _places(scans: Sequence[Scan], cfg: FalseReturnConfig) -> list[int]:
    """Scans from one place to the next by the wheels; none without odometry."""
    if any(scan.odometry is None for scan in scans):
        return []
    poses = np.array([scan.odometry for scan in scans], dtype=float).tolist()
    out, last = [0], poses[0]
    for k, pose in enumerate(poses):
        if max(abs(pose[0] - last[0]), abs(pose[1] - last[1]), abs(pose[2] - last[2])) >= cfg.apart:
            out.append(k)
            last = pose
    return out


def _without(scan: Scan, gone: Bool[np.ndarray, " n"]) -> Scan:
    hit = scan.hit & ~gone
    light = None if scan.intensities is None else frozen(np.where(hit, scan.intensities, 0.0))
    return replace(
        scan, ranges=frozen(np.where(hit, scan.ranges, scan.range_max)), hit=frozen(hit, np.bool_), intensities=light
    )
