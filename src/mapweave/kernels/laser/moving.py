"""Returns of things that move: where a scan shows a small thing in front, and earlier scans saw through its place."""

import math
from typing import NamedTuple

import numpy as np

from .._jit import kernel
from ..cells import cell_of

SCAN, SURE = -1, -2  # what was passed is of the scan, not of an earlier one; it is no glass
CLEARLY, REFUTED = 0.02, 3  # more of a cosine, and beams, by which something is passed where a pane would show itself
CHANCE = 8  # returns at least whose deviations from a line are looked at one after the other


class BeamRanges(NamedTuple):
    """A scan: ranges (n,) [m], which of them are returns, hit (n,), beam k at `first + k step` [rad], range_max [m];
    faces (n, 4), see `flat_faces`.
    """

    ranges: np.ndarray
    hit: np.ndarray
    first: float
    step: float
    range_max: float
    faces: np.ndarray


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
    face: float  # wide at least is a flat face,
    flat: float  # so flat
    pane: float  # and so wide a pane of glass, but for what of it is seen


@kernel
def moving_returns(
    scan: BeamRanges,
    earlier_ranges: np.ndarray,
    earlier_hit: np.ndarray,
    earlier_faces: np.ndarray,
    poses: np.ndarray,
    blur: np.ndarray,
    thing: Thing,
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) which returns of `scan` belong to something that moves, and (n,) which would if nothing were glass.

    earlier_ranges, earlier_hit: (m, n) scans of the same sensor, earlier_faces (m, n, 4), poses: (m, 3) of the sensor
    now as each of them sees it, blur: (m,) [rad] by which its heading may be wrong.

    An earlier scan that has a return within `same` [m] of one says that it stands; one that saw `margin` [m] beyond it,
    or was blocked there by something through which the scan now sees, that it moved; a return moved when more say so.
    That a beam goes through a flat face at such a slant that glass would let it by says nothing, unless others go
    through that face where a pane would have shown itself.
    Things are runs of returns whose ranges differ by less than `jump + jump_share r` from beam to beam. One at most
    `widest` [m] wide, with nothing on either side nearer than `ahead` [m] behind it, moves as a whole when half of its
    returns did; in others runs of returns that moved do, no wider than that.
    """
    if scan.step == 0.0:  # of a single beam: nothing is beside it
        nothing = np.zeros(scan.ranges.shape[0], dtype=np.bool_)
        return nothing, nothing
    moved, opaque = _moved(scan, earlier_ranges, earlier_hit, earlier_faces, poses, blur, thing)
    return _things(scan, moved, thing), _things(scan, opaque, thing)


@kernel
def _things(scan: BeamRanges, moved: np.ndarray, thing: Thing) -> np.ndarray:
    """(n,) which returns are of things that move, of those that moved by themselves."""
    ranges, hit, step = scan.ranges, scan.hit, scan.step
    n = ranges.shape[0]
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
def _moved(
    scan: BeamRanges,
    earlier_ranges: np.ndarray,
    earlier_hit: np.ndarray,
    earlier_faces: np.ndarray,
    poses: np.ndarray,
    blur: np.ndarray,
    thing: Thing,
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) which returns moved by themselves, and (n,) which would have if nothing were glass."""
    n, m = scan.ranges.shape[0], earlier_ranges.shape[0]
    votes, passed = np.zeros((n, m), np.int64), np.full((n, m), SURE, np.int64)
    opaque = np.zeros((m + 1, n), np.int64)  # beams that pass a face where a pane would have shown itself
    for b in range(n):
        if not scan.hit[b]:
            continue
        slack = thing.margin + thing.slant * _slope(scan.ranges, scan.hit, b, thing.jump, thing.jump_share)
        for j in range(m):
            past = earlier_ranges[j], earlier_hit[j], earlier_faces[j]
            votes[b, j], at, cosine = _vote(scan, b, past, poses[j], blur[j], slack, thing.same)
            if votes[b, j] == 1:
                face, of = (scan.faces[b], m) if at == SCAN else (earlier_faces[j, at], j)
                if cosine < face[2]:
                    passed[b, j] = at
                elif face[2] > 0.0 and cosine >= face[2] + CLEARLY:
                    opaque[of, int(face[3])] += 1
    moved, if_opaque = np.zeros((2, n), dtype=np.bool_)
    for b in range(n):
        total = 0
        for j in range(m):
            at = passed[b, j]
            as_glass = at == SCAN and opaque[m, int(scan.faces[b, 3])] < REFUTED
            as_glass |= at >= 0 and opaque[j, int(earlier_faces[j, at, 3])] < REFUTED
            total += 0 if as_glass else votes[b, j]
        moved[b] = scan.hit[b] and total >= thing.votes
        if_opaque[b] = scan.hit[b] and votes[b].sum() >= thing.votes
    return moved, if_opaque


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
    past: tuple[np.ndarray, np.ndarray, np.ndarray],
    pose: np.ndarray,
    blur: float,
    margin: float,
    same: float,
) -> tuple[int, int, float]:
    """1 when an earlier scan says that the return of beam b was not there, -1 when it was, 0 when it does not know.

    past: the earlier scan's ranges, hit and faces; pose: of the sensor now as it sees it. Of 1 also what was passed, a
    return of the earlier scan or SCAN, and the cosine of incidence there: zero where that is on no face, one where a
    scanner stood there itself.
    """
    ranges, first, step, range_max = scan.ranges, scan.first, scan.step, scan.range_max
    earlier, earlier_hit, faces = past
    n = ranges.shape[0]
    reach = 1 + max(cell_of(blur / abs(step)), 0)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    angle = first + b * step
    px, py = ranges[b] * math.cos(angle), ranges[b] * math.sin(angle)
    x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
    r = math.sqrt(x * x + y * y)
    at = _beam(math.atan2(y, x), first, step)
    if at < 0 or at >= n or r > range_max:
        return 0, SCAN, 0.0
    found, nearest = -1, math.inf
    for m in range(max(0, at - reach), min(n, at + reach + 1)):
        seen = earlier[m] if earlier_hit[m] else range_max
        if earlier_hit[m] and abs(seen - r) < same:
            return -1, SCAN, 0.0
        if seen < nearest:
            nearest, found = seen, m
    if nearest > r + margin:
        past_x, past_y = c * x + s * y, c * y - s * x  # from where the earlier scan stood, as the sensor is turned now
        return 1, SCAN, 1.0 if r < margin else abs(scan.faces[b, 0] * past_x + scan.faces[b, 1] * past_y) / r
    if nearest < r - margin and earlier_hit[found]:
        far, dx, dy = _gone(scan, nearest, first + found * step, pose, reach, margin)
        if far > 0.0:
            return 1, found, 1.0 if far < margin else abs(faces[found, 0] * dx + faces[found, 1] * dy) / far
    return 0, SCAN, 0.0


@kernel
def _gone(
    scan: BeamRanges, r: float, angle: float, pose: np.ndarray, reach: int, margin: float
) -> tuple[float, float, float]:
    """How far [m], and where from the sensor as the earlier scan has it, lies what that one saw at `r` [m] under
    `angle` [rad], where the scan now sees through it; else zeros.
    """
    ranges, hit, first, step = scan.ranges, scan.hit, scan.first, scan.step
    dx, dy = r * math.cos(angle) - pose[0], r * math.sin(angle) - pose[1]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = c * dx + s * dy, -s * dx + c * dy
    far = math.sqrt(x * x + y * y)
    at = _beam(math.atan2(y, x), first, step)
    if at < 0 or at >= ranges.shape[0]:
        return 0.0, 0.0, 0.0
    for m in range(max(0, at - reach), min(ranges.shape[0], at + reach + 1)):
        seen = ranges[m] if hit[m] else scan.range_max
        if seen < far + margin:
            return 0.0, 0.0, 0.0
    return far, dx, dy


@kernel
def flat_faces(ranges: np.ndarray, hit: np.ndarray, first: float, step: float, thing: Thing) -> np.ndarray:
    """(n, 4) of the flat face that each return lies on its unit normal, the cosine from which on a beam that passes
    there is not like glass, both zero where it lies on none, and the first return of that face.

    Of a face are returns beside each other that span `face` [m] at least; of them those within `face` of one lie on a
    line, but for `flat` [m] on the mean square, or for twice that and a hundredth of the range where they leave it up
    and down by chance: what is round leaves it slowly. The cosine is that of incidence here; on a face less wide than
    `pane` [m], as people and carts have it, the least of all of it: a pane would have shown itself there.
    """
    n = ranges.shape[0]
    out = np.zeros((n, 4))
    xy = np.empty((n, 2))
    for b in range(n):
        xy[b, 0], xy[b, 1] = ranges[b] * math.cos(first + b * step), ranges[b] * math.sin(first + b * step)
    i = 0
    while i < n:
        if not hit[i]:
            i += 1
            continue
        k = i
        while k + 1 < n and hit[k + 1] and abs(ranges[k + 1] - ranges[k]) < thing.jump + thing.jump_share * ranges[k]:
            k += 1
        low = high = i
        for b in range(i, k + 1):
            while _apart(xy, low, b) > thing.face:
                low += 1
            while high < k and _apart(xy, high + 1, b) <= thing.face:
                high += 1
            if high - low >= 3 and _apart(xy, low, high) >= thing.face:
                _lie_on(xy[low : high + 1], thing.flat, 2.0 * thing.flat + 0.01 * ranges[b], out[b])
        _least_cosines(out, xy, i, k, thing.pane)
        i = k + 1
    return out


@kernel
def _least_cosines(faces: np.ndarray, xy: np.ndarray, i: int, k: int, pane: float) -> None:
    """`faces` get their cosines, and first returns, of the returns from i to k."""
    begin, least = i, 1.0
    for b in range(i, k + 1):
        r = math.hypot(xy[b, 0], xy[b, 1])
        faces[b, 2], faces[b, 3] = abs(faces[b, 0] * xy[b, 0] + faces[b, 1] * xy[b, 1]) / r if r > 0.0 else 0.0, b
        flat = faces[b, 2] > 0.0
        least = min(least, faces[b, 2]) if flat else least
        if b == k or not flat:
            end = b if flat else b - 1
            if end > begin and _apart(xy, begin, end) < pane:
                faces[begin : end + 1, 2], faces[begin : end + 1, 3] = least, begin
            begin, least = b + 1, 1.0


@kernel
def _apart(xy: np.ndarray, i: int, k: int) -> float:
    return math.hypot(xy[i, 0] - xy[k, 0], xy[i, 1] - xy[k, 1])


@kernel
def _lie_on(xy: np.ndarray, flat: float, rough: float, normal: np.ndarray) -> None:
    """`normal` becomes that of the line on which the points lie, in their order; it stays where they lie on none."""
    m = xy.shape[0]
    mx, my = xy[:, 0].mean(), xy[:, 1].mean()
    xx = xy_ = yy = 0.0
    for k in range(m):
        dx, dy = xy[k, 0] - mx, xy[k, 1] - my
        xx, xy_, yy = xx + dx * dx, xy_ + dx * dy, yy + dy * dy
    along = 0.5 * math.atan2(2.0 * xy_, xx - yy)
    nx, ny = -math.sin(along), math.cos(along)
    squares = steps = before = 0.0
    for k in range(m):
        e = nx * (xy[k, 0] - mx) + ny * (xy[k, 1] - my)
        squares += e * e
        steps += (e - before) ** 2 if k else 0.0
        before = e
    chance = m >= CHANCE and steps >= squares  # twice the squares on the mean, where each is by itself
    if squares <= m * flat * flat or (chance and squares <= m * rough * rough):
        normal[0], normal[1] = nx, ny


@kernel
def _beam(angle: float, first: float, step: float) -> int:
    """The number of the beam nearest to `angle` [rad]; it may lie outside the scan."""
    turns = (angle - first) / step
    around = 2.0 * math.pi / abs(step)
    turns -= around * np.floor(turns / around)
    return cell_of(turns + 0.5)
