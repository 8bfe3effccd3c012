"""Whether a robot's wheels and what it sees speak of one motion: wrong signs, units, or a sensor mounted askew.

A landmark's bearing falls as the robot turns, and its range by the distance driven towards it. So the changes between
two sightings of one landmark, over what was commanded in between, are a turn and a speed scale: of no unit, near one
where all is well, and robust, as the weighted median of the ratios. No map and no filter is needed.

Wheels with a sign or a unit that is not ours are mended and it is told; other contradictions leave a log without them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.config import config
from ..core.errors import DataError
from ..core.findings import Finding
from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.records import Odometry
from .config import EkfSlamConfig
from .ekf_slam import is_landmark

AGREEMENT_APART = (1, 2, 4, 8)  # sightings of one landmark, from one of a pair to the other
TURN_SPAN = (0.1, 2.0)  # [s] between two sightings whose bearings are compared,
WAY_SPAN = (0.5, 4.0)  # [s] and whose ranges are
AGREEMENT_PAIRS = 100  # from which a scale is judged
AGREEMENT_BETTER = 0.3  # share of the errors that must go where what was commanded is scaled
AGREEMENT_ASIDE = 0.3  # share of the ranges' changes that motion to a side must explain,
MORE_ASIDE = 0.15  # and how much more of them than motion ahead
AGREEMENT_UNIT = 30.0  # speed scale from which ranges are no metres whatever the speeds
AGREEMENT_NEAR = 1.6  # factor by which a scale may miss that of a unit
FULL_TURN = 6.3  # [rad] beyond which a bearing
AGREEMENT_BEYOND = 0.2  # in such a share of the sightings is in degrees
AGREEMENT_ABSURD = 50.0  # times what nine rows in ten stay under, from which a row is no command
WITH_IT = 0.1  # turn scale below which bearings do not follow the turns, whatever the sign
AGREEMENT_SURE = 6.0  # standard deviations of a median of independent pairs; pairs share sightings

SIFT_WINDOW = 4.0  # [s] either way, in which sightings of one name are compared
SIFT_TURNED = 1.2  # [rad] commanded between two sightings, from which they are not compared
SIFT_FLOOR = 0.15  # [m] by which places may differ,
SIFT_SHARE = 0.08  # and as a share of the distance,
TURN_ERROR = 0.25  # of the angle commanded in between, times the distance,
SIFT_DRIFT = 0.12  # of the distance commanded in between,
SIFT_MOVING = 0.35  # [m/s] and for another robot, which drives
SIFT_LEAST = 3  # others in the window, from which a sighting is judged
SIFT_SUPPORT = 0.5  # share of them that must agree with it
SIFT_ENOUGH = 2  # other sightings that must agree with one, in a log that is sifted
BLIND_WINDOW = 0.8  # [s] in place of window where no wheels say how the robot went,
BLIND_TURN = 0.5  # [rad/s] and how fast it may have turned there,
BLIND_ENOUGH = 1  # and that must agree there
TURN_SCALES = (0.65, 1.3, 1.6)  # of the expected one, one of which wheels may have instead
SIFT_FEW = 6  # sightings in a row left of a landmark, below which it may be another one that was misread
MOSTLY = 0.9  # share of all left out, from which what is left is not believed either
SIFT_DIRTY = 0.08  # share of the sightings judged that are contradicted, from which the log is sifted,
SIFT_GROSS = 2.5  # or contradicted by so many times the limits, as wrong labels are and noise is not,
DIRTY_GROSS = 0.005  # and that share,
BLIND_DIRTY = 0.0008  # or that one without wheels, where hardly a sighting can be contradicted

LEFT = "its odometry is left out"


@config
class AgreementConfig:
    """What pairs of sightings are compared, and between which scales wheels are used."""

    turn_scale: tuple[float, float] = (0.35, 2.2)  # between which turns are used,
    speed_scale: tuple[float, float] = (0.4, 2.5)  # and speeds


TINY = 1e-12  # scale that is none
TURN_UNITS = {"": 1.0, "degrees a second": np.pi / 180.0}
# what a number in each unit is in metres a second
SPEED_UNITS = {"": 1.0, "km/h": 1 / 3.6, "cm/s": 0.01, "mm/s": 0.001}


@dataclass(frozen=True, slots=True)
class Scale:
    """What was seen over what was commanded, from `pairs` pairs.

    fit: the share of the changes that it explains; better: the share of the errors that it removes from a scale of one;
    least: what it is not under, by `sure` standard deviations of the median.
    """

    value: float
    fit: float
    better: float
    pairs: int
    least: float = 0.0

    @classmethod
    def of(cls, commanded: Float[np.ndarray, " p"], seen: Float[np.ndarray, " p"], sure: float) -> "Scale":
        """The factor of least absolute errors: the median of the ratios, weighted by what was commanded."""
        nonzero = np.abs(commanded) > 0
        x, y = commanded[nonzero], seen[nonzero]
        whole = float(np.abs(y).sum())
        if not len(x) or whole == 0.0:
            return cls(0.0, 0.0, 0.0, len(x))
        ratio = y / x
        order = np.argsort(ratio, kind="stable")
        weight = np.cumsum(np.abs(x)[order])
        half, sd = weight[-1] / 2, float(np.sqrt((x**2).sum())) / 2
        value, least = (float(ratio[order][np.searchsorted(weight, w)]) for w in (half, max(half - sure * sd, 0.0)))
        left, at_one = float(np.abs(y - value * x).sum()), float(np.abs(y - x).sum())
        return cls(value, 1.0 - left / whole, 1.0 - left / at_one if at_one else 0.0, len(x), least)

    def elsewhere(self, span: tuple[float, float]) -> bool:
        """Whether it lies clearly outside `span`: noise in what is commanded lowers a scale, nothing raises it."""
        if self.pairs < AGREEMENT_PAIRS or span[0] <= self.value <= span[1]:
            return False
        return self.better >= AGREEMENT_BETTER or self.least > span[1]


@dataclass(frozen=True, slots=True)
class Agreement:
    """turn: of bearings over turns; speed: of ranges over motion ahead; aside: over motion to the left."""

    turn: Scale
    speed: Scale
    aside: Scale

    @classmethod
    def of(cls, seen: SightingTable, wheels: Odometry, ekf: EkfSlamConfig) -> "Agreement":
        angle, way = _commanded(seen.t, wheels, ekf)
        a, b = _pairs(seen, AGREEMENT_APART)
        dt = seen.t[b] - seen.t[a]
        near = (dt >= TURN_SPAN[0]) & (dt <= TURN_SPAN[1])
        far = (dt >= WAY_SPAN[0]) & (dt <= WAY_SPAN[1])
        i, j = a[near], b[near]
        turned = np.remainder(seen.bearing[j] - seen.bearing[i] + np.pi, 2 * np.pi) - np.pi
        turn = Scale.of(angle[i] - angle[j], turned, AGREEMENT_SURE)
        i, j = a[far], b[far]
        nearer, gone = seen.range[i] - seen.range[j], way[j] - way[i]
        ahead, left = (
            Scale.of(0.5 * gone * (part(seen.bearing[i]) + part(seen.bearing[j])), nearer, AGREEMENT_SURE)
            for part in (np.cos, np.sin)
        )
        return cls(turn, ahead, left)

    def looks_aside(self) -> bool:
        """Whether motion to a side explains the ranges clearly better than motion ahead."""
        enough = min(self.speed.pairs, self.aside.pairs) >= AGREEMENT_PAIRS
        return enough and self.aside.fit >= max(AGREEMENT_ASIDE, self.speed.fit + MORE_ASIDE)


def with_wheels_checked(log: LandmarkLog, ekf: EkfSlamConfig, cfg: AgreementConfig | None = None) -> LandmarkLog:
    """The log with wheels that its sightings do not contradict, mended or left out with a warning; often as it is.

    Raises DataError for bearings in degrees and for ranges in units smaller than metres.
    """
    cfg, seen, wheels = cfg or AgreementConfig(), log.sightings, log.odometry
    _check_bearings(log)
    if wheels is None or not len(seen):
        return log
    agreement = Agreement.of(seen, wheels, ekf)
    findings: list[Finding] = []
    turn, speed = agreement.turn, agreement.speed
    if turn.elsewhere(cfg.turn_scale):
        unit = _unit(turn.value, TURN_UNITS)
        if unit is None and abs(turn.value) < WITH_IT:
            why = (
                f"its bearings do not follow its turns ({turn.value:.2f} of them): its odometry is of another robot or "
                "another time, or wrong"
            )
        elif turn.value < 0:
            why = (
                f"its bearings run against its turns ({turn.value:.2f} of them): one of the two has the wrong sign, "
                "and if it is the bearings', what it maps is mirrored"
            )
        else:
            why = f"its bearings change {_times(turn.value)} what its turns say"
        if unit is None:
            return _without_wheels(log, [*findings, Finding("turns-unlike", log.robot, value=why, action=LEFT)])
        findings.append(
            Finding("turns-unlike", log.robot, value=why, action=f"its turns are taken {_as(unit, turn.value)}")
        )
        wheels = Odometry(wheels.t, wheels.v, wheels.w * np.copysign(TURN_UNITS[unit], turn.value))
    if agreement.looks_aside():
        side = "left" if agreement.aside.value > 0 else "right"
        return _without_wheels(log, [*findings, Finding("camera-turned", log.robot, value=side, action=LEFT)])
    if speed.elsewhere(cfg.speed_scale):
        if speed.value > AGREEMENT_UNIT:
            raise DataError(
                f"{log.source}: {log.robot}: its ranges change {_times(speed.value)} what its speed says: "
                "expected metres"
            )
        unit = _unit(speed.value, SPEED_UNITS)
        why = (
            "its ranges grow where its speed leads towards what it sees: its speed or its sensor is reversed"
            if speed.value < 0
            else f"its ranges change {_times(speed.value)} what its speed says: one of the two is not in metres"
        )
        if unit is None:
            return _without_wheels(log, [*findings, Finding("speeds-unlike", log.robot, value=why, action=LEFT)])
        findings.append(
            Finding("speeds-unlike", log.robot, value=why, action=f"its speeds are taken {_as(unit, speed.value)}")
        )
        wheels = Odometry(wheels.t, wheels.v * np.copysign(SPEED_UNITS[unit], speed.value), wheels.w)
    return replace(log, odometry=wheels, findings=(*log.findings, *findings)) if findings else log


def _check_bearings(log: LandmarkLog) -> None:
    bearings = np.concatenate([log.sightings.bearing, log.bearings.bearing])
    beyond = float((np.abs(bearings) > FULL_TURN).mean()) if len(bearings) else 0.0
    if beyond >= AGREEMENT_BEYOND:
        raise DataError(
            f"{log.source}: {log.robot}: {beyond:.0%} of its bearings are beyond a full turn: expected radians, "
            "found what looks like degrees"
        )


def _unit(scale: float, units: Mapping[str, float]) -> str | None:
    """The unit of `units` whose factor `scale` is nearest to, whatever its sign, if it is near."""
    missed = {name: abs(float(np.log(max(abs(scale), TINY) / factor))) for name, factor in units.items()}
    best = min(missed, key=missed.__getitem__)
    return best if missed[best] <= np.log(AGREEMENT_NEAR) else None


def _as(unit: str, scale: float) -> str:
    signed = ["with the other sign"] if scale < 0 else []
    return " and ".join([*signed, *([f"as {unit}"] if unit else [])])


def _without_wheels(log: LandmarkLog, findings: Sequence[Finding]) -> LandmarkLog:
    return replace(log, odometry=None, findings=(*log.findings, *findings))


def _times(ratio: float) -> str:
    return f"{ratio:.0f} times" if ratio >= 10 else f"{ratio:.2g} times"


def _pairs(seen: SightingTable, apart: tuple[int, ...]) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]:
    """Rows of the same landmark, so many of its sightings apart."""
    first, second = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for k, name in enumerate(seen.ids):
        if is_landmark(name):
            rows = np.flatnonzero(seen.what == k)
            first += [rows[:-n] for n in apart]
            second += [rows[n:] for n in apart]
    return np.concatenate(first), np.concatenate(second)


def _commanded(
    t: Float[np.ndarray, " n"], wheels: Odometry, ekf: EkfSlamConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The angle [rad] and the distance [m] commanded until `t`; absurd rows count as standing."""
    dt = np.append(np.minimum(np.diff(wheels.t), ekf.hold), 0.0)
    sane = (np.where(np.abs(x) <= AGREEMENT_ABSURD * np.quantile(np.abs(x), 0.9), x, 0.0) for x in (wheels.w, wheels.v))
    sums = (np.append(0.0, np.cumsum(rate * dt)[:-1]) for rate in sane)
    angle, way = (np.interp(t, wheels.t + ekf.lag, total) for total in sums)
    return angle, way


@dataclass(frozen=True, slots=True)
class Witnesses:
    """For each of n sightings, how many others there are to compare it with, and how many of them agree."""

    of: Int[np.ndarray, " n"]
    agree: Int[np.ndarray, " n"]
    blind: bool = False  # without wheels

    def contradicted(self) -> Bool[np.ndarray, " n"]:
        """Those that enough others could have borne out, and did not."""
        return np.asarray((self.of >= SIFT_LEAST) & (self.agree < SIFT_SUPPORT * self.of))

    def borne_out(self) -> Bool[np.ndarray, " n"]:
        """Those that enough others bear out, and no majority contradicts."""
        enough = BLIND_ENOUGH if self.blind else SIFT_ENOUGH
        return np.asarray((self.agree >= enough) & ~self.contradicted())

    def contradicted_share(self) -> float:
        """Of those judged, the share that is contradicted."""
        return float(self.contradicted().sum() / max(int((self.of >= SIFT_LEAST).sum()), 1))


def sifted(log: LandmarkLog, ekf: EkfSlamConfig) -> LandmarkLog:
    """The log without the sightings that its others contradict, where those are many; they are counted and told.

    A log with few of them comes back as it is. In one with many, a sighting that hardly another bears out goes too:
    wrong labels scatter over all names, and most have nothing near that could contradict them. So do few in a row of a
    name mostly contradicted that lie where another, or a robot, was seen: misreadings of one that was looked at for
    long bear each other out. Where wheels of another turn scale are contradicted less, theirs is taken.
    """
    if not len(log.sightings):
        return log
    if _clean(log, ekf):
        return log
    support = witnesses(log.sightings, log.odometry, ekf)
    scales = () if log.odometry is None else TURN_SCALES
    for turning in (replace(ekf, turn_scale=scale * ekf.turn_scale) for scale in scales):
        other = witnesses(log.sightings, log.odometry, turning)
        if other.contradicted().sum() < support.contradicted().sum():
            support, ekf = other, turning
    if _clean(log, ekf):
        return log
    keep = support.borne_out()
    keep &= ~_misread(log.sightings, keep, log.odometry, ekf)
    gone = int((~keep).sum())
    value = {"value": gone, "all": len(keep)}
    found = (
        Finding("sightings-sifted", log.robot, value=value, action="left out")
        if gone <= MOSTLY * len(keep)
        else Finding("sightings-doubted", log.robot, value=value, action="left out")
    )
    return replace(
        log,
        sightings=log.sightings.select(keep),
        dropped={**log.dropped, "sighting: contradicted": gone},
        findings=(*log.findings, found),
    )


def _clean(log: LandmarkLog, ekf: EkfSlamConfig) -> bool:
    """Whether so few sightings are contradicted that a filter's gates are enough; few grossly, as wrong labels are."""
    most = BLIND_DIRTY if log.odometry is None else DIRTY_GROSS
    return (
        witnesses(log.sightings, log.odometry, ekf).contradicted_share() <= SIFT_DIRTY
        and witnesses(log.sightings, log.odometry, ekf, SIFT_GROSS).contradicted_share() <= most
    )


def witnesses(seen: SightingTable, wheels: Odometry | None, ekf: EkfSlamConfig, by: float = 1.0) -> Witnesses:
    """Which sightings bear each other out along the path that `wheels` tell, or in moments where there are none.

    by: how many times the usual limits places may differ by.
    """
    driven = _Driven.of(seen, wheels, ekf, by)
    of, agree = np.zeros(len(seen), np.int64), np.zeros(len(seen), np.int64)
    for k, name in enumerate(seen.ids):
        rows = np.flatnonzero(seen.what == k)
        moving = 0.0 if is_landmark(name) else by * SIFT_MOVING
        for apart in range(1, len(rows)):
            a, b = rows[:-apart], rows[apart:]
            if (seen.t[b] - seen.t[a]).min() > driven.window:
                break
            compared, fits = driven.compared(a, b, moving)
            for end in (a, b):
                np.add.at(of, end[compared], 1)
                np.add.at(agree, end[compared & fits], 1)
    return Witnesses(of, agree, wheels is None)


def _misread(
    seen: SightingTable, keep: Bool[np.ndarray, " n"], wheels: Odometry | None, ekf: EkfSlamConfig
) -> Bool[np.ndarray, " n"]:
    """Of names that lose most, the kept sightings that are few in a row and mostly lie where another was seen."""
    driven = _Driven.of(seen, wheels, ekf)
    n, kept = (np.bincount(seen.what[rows], minlength=len(seen.ids)) for rows in (np.ones(len(keep), bool), keep))
    stands = np.array([is_landmark(name) for name in seen.ids])
    out = np.zeros(len(seen), bool)
    for k in np.flatnonzero(stands & (kept > 0) & (2 * kept < n)).tolist():
        mine = np.flatnonzero(keep & (seen.what == k))
        others = np.flatnonzero(keep & (seen.what != k))
        for row in np.split(mine, np.flatnonzero(np.diff(seen.t[mine]) > driven.window) + 1):
            if len(row) >= SIFT_FEW:
                continue
            a, b = np.repeat(row, len(others)), np.tile(others, len(row))
            moving = np.where(stands[seen.what[b]], 0.0, SIFT_MOVING)
            compared, fits = driven.compared(a, b, moving)
            elsewhere = np.bincount(a[compared & fits], minlength=len(seen))[row] >= SIFT_ENOUGH
            out[row] = 2 * elsewhere.sum() > len(row)
    return out


@dataclass(frozen=True, slots=True)
class _Driven:
    """Sightings carried into one frame by the wheels: place [m]; distance [m] and angle [rad] driven until then.

    window: [s] in which they are compared; turning, going: [rad/s] and [m/s] at which the robot may have moved besides;
    by: how many times the usual limits places may differ by.
    """

    t: Float[np.ndarray, " n"]
    range: Float[np.ndarray, " n"]
    place: Float[np.ndarray, "n 2"]
    way: Float[np.ndarray, " n"]
    angle: Float[np.ndarray, " n"]
    window: float
    turning: float = 0.0
    going: float = 0.0
    by: float = 1.0

    @classmethod
    def of(cls, seen: SightingTable, wheels: Odometry | None, ekf: EkfSlamConfig, by: float = 1.0) -> "_Driven":
        if wheels is None:
            still = np.zeros(len(seen))
            ahead = seen.range[:, None] * np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=-1)
            return cls(seen.t, seen.range, ahead, still, still, BLIND_WINDOW, BLIND_TURN, by * SIFT_MOVING, by)
        pose, way, angle = _driven(seen.t, wheels, ekf)
        bearing = pose[:, 2] + seen.bearing
        place = pose[:, :2] + seen.range[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
        return cls(seen.t, seen.range, place, way, angle, SIFT_WINDOW, by=by)

    def compared(
        self,
        a: Int[np.ndarray, " p"],
        b: Int[np.ndarray, " p"],
        moving: float | Float[np.ndarray, " p"],
    ) -> tuple[Bool[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
        """Which pairs of rows are near enough in time to be compared, and which of all lie at one place."""
        dt, angle = np.abs(self.t[b] - self.t[a]), np.abs(self.angle[b] - self.angle[a])
        r = np.minimum(self.range[a], self.range[b])
        by = self.by
        most = by * SIFT_FLOOR + (by * SIFT_SHARE + by * TURN_ERROR * angle) * r
        most += by * SIFT_DRIFT * np.abs(self.way[b] - self.way[a]) + (moving + self.going + self.turning * r) * dt
        fits = np.hypot(*(self.place[a] - self.place[b]).T) <= most
        return (dt <= self.window) & (angle <= SIFT_TURNED), fits


def _driven(
    t: Float[np.ndarray, " n"], wheels: Odometry, ekf: EkfSlamConfig
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Poses at `t` as commands with the expected calibration say; distance [m] and angle [rad] driven until then."""
    dt = np.append(np.minimum(np.diff(wheels.t), ekf.hold), 0.0)
    angle, way = ekf.turn_scale * wheels.w * dt, ekf.speed_scale * wheels.v * dt
    heading = np.cumsum(angle) - 0.5 * angle
    steps = [way * np.cos(heading), way * np.sin(heading), angle, np.abs(way), np.abs(angle)]
    then = wheels.t + ekf.lag
    path = np.stack([np.interp(t, then, np.append(0.0, np.cumsum(s)[:-1])) for s in steps], axis=-1)
    return np.column_stack([path[:, :2], path[:, 2]]), path[:, 3], path[:, 4]
