"""Returns of things that move: where a scan shows a small thing in front, and earlier scans saw through its place."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of


class BeamRanges(NamedTuple):
    """A scan: ranges (n,) [m], which of them are returns, hit (n,), beam k at `first + k step` [rad], range_max [m]."""

    ranges: np.ndarray
    hit: np.ndarray
    first: float
    step: float
    range_max: float


class Thing(NamedTuple):
    """What a thing is, and what counts as its having moved, lengths in metres; see `moving_returns`."""

    jump: float
    jump_share: float  # of the range
    ahead: float
    widest: float
    margin: float
    same: float
    slant: float  # times the range's change to the next beam: more of a margin for what is seen at a slant
    votes: int  # more earlier scans that say so than say the opposite
    least_run: int  # returns beside each other that seem to move, where they do not stand free
    beside: int  # returns on either side of such a run that move with it, where their ranges go on


@kernel
def moving_returns(
    scan: BeamRanges,
    earlier_ranges: np.ndarray,
    earlier_hit: np.ndarray,
    poses: np.ndarray,
    blur: np.ndarray,
    thing: Thing,
) -> np.ndarray:
    """(n,) which returns of `scan` belong to something that moves.

    earlier_ranges, earlier_hit: (m, n) scans of the same sensor, poses: (m, 3) of the sensor now as each of them sees
    it, blur: (m,) [rad] by which its heading may be wrong.

    An earlier scan that has a return within `same` [m] of one says that it stands; one that saw `margin` [m] beyond it,
    or was blocked there by something through which the scan now sees, that it moved; a return moved when more say so.
    Things are runs of returns whose ranges differ by less than `jump + jump_share r` from beam to beam. One at most
    `widest` [m] wide, with nothing on either side nearer than `ahead` [m] behind it, moves as a whole when half of its
    returns did; in others runs of returns that moved do, no wider than that.
    """
    ranges, hit, step = scan.ranges, scan.hit, scan.step
    n = ranges.shape[0]
    moved = np.zeros(n, dtype=np.bool_)
    if step == 0.0:  # of a single beam: nothing is beside it
        return moved
    for b in range(n):
        if hit[b]:
            votes = 0
            for j in range(earlier_ranges.shape[0]):
                slack = thing.margin + thing.slant * _slope(ranges, hit, b, thing.jump, thing.jump_share)
                votes += _vote(scan, b, earlier_ranges[j], earlier_hit[j], poses[j], blur[j], slack, thing.same)
            moved[b] = votes >= thing.votes
    out = np.zeros(n, dtype=np.bool_)
    i = 0
    while i < n:
        if not hit[i]:
            i += 1
            continue
        k = i
        while k + 1 < n and hit[k + 1] and abs(ranges[k + 1] - ranges[k]) < thing.jump + thing.jump_share * ranges[k]:
            k += 1
        if _stands_free(ranges, hit, i, k, step, thing.ahead, thing.widest):
            if 2 * np.sum(moved[i : k + 1]) >= k - i + 1:
                out[i : k + 1] = True
        else:
            _mark_runs(out, moved, ranges, i, k, step, thing)
        i = k + 1
    return out


@kernel
def _slope(ranges: np.ndarray, hit: np.ndarray, b: int, jump: float, jump_share: float) -> float:
    """[m] by which the range changes to the next beam of the same thing, the larger of both sides."""
    most = 0.0
    for m in (b - 1, b + 1):
        if 0 <= m < ranges.shape[0] and hit[m]:
            d = abs(ranges[m] - ranges[b])
            if d < jump + jump_share * ranges[b] and d > most:
                most = d
    return most


@kernel
def _mark_runs(
    out: np.ndarray, moved: np.ndarray, ranges: np.ndarray, i: int, k: int, step: float, thing: Thing
) -> None:
    """`out` has the runs of beams i to k that moved, and what goes on beside them."""
    b = i
    while b <= k:
        if not moved[b]:
            b += 1
            continue
        e = b
        while e < k and moved[e + 1]:
            e += 1
        if e - b + 1 >= thing.least_run and _across(ranges[b], ranges[e], (e - b) * step) <= thing.widest:
            out[max(i, b - thing.beside) : min(k, e + thing.beside) + 1] = True
        b = e + 1


@kernel
def _across(a: float, b: float, angle: float) -> float:
    """[m] between returns at ranges a and b, `angle` [rad] apart."""
    return math.sqrt(max(0.0, a * a + b * b - 2.0 * a * b * math.cos(angle)))


@kernel
def _stands_free(ranges: np.ndarray, hit: np.ndarray, i: int, k: int, step: float, ahead: float, widest: float) -> bool:
    """Whether beams i to k, two at least, are a small thing in front of what is beside it, off the scan's edge."""
    if k == i or i <= 0 or k >= ranges.shape[0] - 1:
        return False
    if (hit[i - 1] and ranges[i - 1] < ranges[i] + ahead) or (hit[k + 1] and ranges[k + 1] < ranges[k] + ahead):
        return False
    return bool(_across(ranges[i], ranges[k], (k - i) * step) <= widest)


@kernel
def _vote(
    scan: BeamRanges,
    b: int,
    earlier: np.ndarray,
    earlier_hit: np.ndarray,
    pose: np.ndarray,
    blur: float,
    margin: float,
    same: float,
) -> int:
    """1 when an earlier scan says that the return of beam b was not there, -1 when it was, 0 when it does not know."""
    ranges, first, step, range_max = scan.ranges, scan.first, scan.step, scan.range_max
    n = ranges.shape[0]
    reach = 1 + max(cell_of(blur / abs(step)), 0)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    angle = first + b * step
    px, py = ranges[b] * math.cos(angle), ranges[b] * math.sin(angle)
    x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
    r = math.sqrt(x * x + y * y)
    at = _beam(math.atan2(y, x), first, step)
    if at < 0 or at >= n:
        return 0
    nearest, found = np.inf, at
    for m in range(max(0, at - reach), min(n, at + reach + 1)):
        seen = earlier[m] if earlier_hit[m] else range_max
        if earlier_hit[m] and abs(seen - r) < same:
            return -1
        if seen < nearest:
            nearest, found = seen, m
    if nearest > r + margin:
        return 1
    if nearest < r - margin and earlier_hit[found]:
        before = first + found * step
        return 1 if _gone(scan, nearest, before, pose, reach, margin) else 0
    return 0


@kernel
def _gone(scan: BeamRanges, r: float, angle: float, pose: np.ndarray, reach: int, margin: float) -> bool:
    """Whether the scan now sees through what an earlier one saw at `r` [m] under `angle` [rad]."""
    ranges, hit, first, step, range_max = scan
    dx, dy = r * math.cos(angle) - pose[0], r * math.sin(angle) - pose[1]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = c * dx + s * dy, -s * dx + c * dy
    far = math.sqrt(x * x + y * y)
    at = _beam(math.atan2(y, x), first, step)
    if at < 0 or at >= ranges.shape[0]:
        return False
    for m in range(max(0, at - reach), min(ranges.shape[0], at + reach + 1)):
        seen = ranges[m] if hit[m] else range_max
        if seen < far + margin:
            return False
    return True


@kernel
def _beam(angle: float, first: float, step: float) -> int:
    """The number of the beam nearest to `angle` [rad]; it may lie outside the scan."""
    turns = (angle - first) / step
    around = 2.0 * math.pi / abs(step)
    turns -= around * np.floor(turns / around)
    return cell_of(turns + 0.5)
