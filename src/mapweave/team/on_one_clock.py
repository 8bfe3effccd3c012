"""A team smoothed with every robot's clock put right that is clearly off the others'.

Smoothing with a wrong clock bends the trajectories a little and makes sightings of each other count less; what still
pulls tells how far the clock is off (`clock_scores`). So stamps are moved as it seems, and the team is smoothed again,
until no clock moves any more.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..core.landmark_log import LandmarkLog, SightingTable
from ..core.names import in_order, robot_key
from .clocks import RobotClock
from .config import ClockConfig, SmoothingConfig
from .known import PlacePriors
from .smooth import Calibration, Smoothed, smooth
from .team_map import TeamMap


def smooth_on_one_clock(
    team: TeamMap,
    logs: Sequence[LandmarkLog],
    labels: Mapping[str, Mapping[str, str]],
    cfg: SmoothingConfig,
    calibration: Mapping[str, Calibration] | None = None,
    soften: Sequence[float] = (),
    known: PlacePriors | None = None,
) -> Smoothed:
    """`smooth`, stamps of robots whose clocks are off by `cfg.clocks.least` [s] or more moved to the others' clock.

    Of each such robot a sentence stands in its notes, and its clock in `clocks`; where little tells of it, it is told
    and nothing is moved. A team whose clocks are right comes out as `smooth` has it, smoothed once.
    """

    def on(clocks: Mapping[str, float]) -> Smoothed:
        moved = [_moved(log, clocks.get(log.robot, 0.0)) for log in logs]
        tracks = {r: replace(track, t=track.t - clocks.get(r, 0.0)) for r, track in team.tracks.items()}
        first = replace(team, tracks=tracks) if clocks else team
        return smooth(first, moved, labels, cfg, calibration, soften=soften, known=known, clocks=clocks)

    limits = cfg.clocks
    as_is = done = on({})
    ahead: dict[str, float] = {}
    for _ in range(limits.rounds):
        wrong = _wrong(done, ahead, limits)
        if not wrong or done.refused:
            break
        ahead.update({robot: ahead.get(robot, 0.0) + by for robot, by in wrong.items()})
        done = on(ahead)
    found = {
        r: RobotClock(by, float(np.hypot(done.clocks[r].sd, limits.still)))
        for r, by in ahead.items()
        if r in done.clocks and not done.refused
    }
    gain = _gain(as_is, done)
    sure = {r: c for r, c in found.items() if _off(c, limits.sure, limits) and gain >= limits.gain_sure}
    told = {r: c for r, c in found.items() if r not in sure and _off(c, limits.told, limits) and gain >= limits.gain}
    if set(sure) != set(ahead):
        done = on({r: c.ahead for r, c in sure.items()}) if sure else as_is
    notes = [*done.notes, *(_sentence(r, c, right=True) for r, c in _in_order(sure))]
    notes += [_sentence(r, c, right=False) for r, c in _in_order(told)]
    return replace(done, notes=tuple(notes), clocks=sure)


def _wrong(done: Smoothed, moved: Mapping[str, float], cfg: ClockConfig) -> dict[str, float]:
    """By how much [s] the stamps are to be moved yet; those of robots moved before, until they are still."""
    return {
        robot: clock.ahead
        for robot, clock in done.clocks.items()
        if abs(clock.ahead) >= (cfg.still if robot in moved else max(cfg.least, cfg.tried * clock.sd))
    }


def _off(clock: RobotClock, deviations: float, cfg: ClockConfig) -> bool:
    return abs(clock.ahead) >= max(cfg.least, deviations * clock.sd)


def _gain(before: Smoothed, after: Smoothed) -> float:
    """The cost that moving clocks took away, beyond that of sightings for which no pose is known any more."""
    n, left = (sum(done.used.values()) for done in (before, after))
    return before.cost * min(1.0, left / max(n, 1)) - after.cost


def _moved(log: LandmarkLog, ahead: float) -> LandmarkLog:
    """The log with its stamps `ahead` [s] earlier."""
    if not ahead:
        return log
    odometry = log.odometry
    return replace(
        log,
        odometry=None if odometry is None else replace(odometry, t=odometry.t - ahead),
        sightings=_earlier(log.sightings, ahead),
        bearings=_earlier(log.bearings, ahead),
        cuts=tuple(t - ahead for t in log.cuts),
    )


def _earlier(table: SightingTable, by: float) -> SightingTable:
    return replace(table, t=table.t - by)


def _in_order(clocks: Mapping[str, RobotClock]) -> list[tuple[str, RobotClock]]:
    return sorted(clocks.items(), key=lambda item: in_order(item[0]))


def _sentence(robot: str, clock: RobotClock, *, right: bool) -> str:
    where = "ahead of" if clock.ahead > 0 else "behind"
    far = f"{abs(clock.ahead):.2f} s {where} the others' (sd {clock.sd:.2f} s)"
    if right:
        return f"robot {robot_key(robot)}: its clock is {far}, by what they saw of each other; its stamps were moved"
    return (
        f"robot {robot_key(robot)}: its clock seems {far}, by what they saw of each other; too little tells to move it"
    )
