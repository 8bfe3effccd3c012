"""How far a robot's clock is ahead of the others', from what they saw of each other along their smoothed paths."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.landmark_log import LandmarkLog
from .relative_frame import Body, Labels, PlacingConfig, costs, mutual_sightings, sharpened
from .team_map import TeamMap


@dataclass(frozen=True, slots=True)
class RobotClock:
    """ahead: [s] of the team's clock, with its standard deviation."""

    ahead: float
    sd: float


def clock_of(
    robot: str, team: TeamMap, logs: Mapping[str, LandmarkLog], labels: Labels, cfg: PlacingConfig
) -> RobotClock | None:
    """What the robot's stamps want to be moved by in `team`; None where too little was seen, or all stood still."""
    others = Body({name: track for name, track in team.tracks.items() if name != robot and len(track.t)}, {})
    own = Body({robot: team.tracks[robot]}, {})
    sharp, reach, step = sharpened(cfg), cfg.clock_fine, cfg.clock_fine_step
    here = np.zeros(3)

    def cost(ahead: float) -> float:
        z = mutual_sightings(others, replace(own, clock=ahead), logs, labels)
        return np.inf if len(z) < cfg.clock_sightings else float(costs(z, here, sharp)) / len(z)

    tried = np.arange(-reach, reach + 0.5 * step, step)
    value = np.array([cost(t) for t in tried])
    if not np.isfinite(value).all():
        return None
    middle = float(tried[int(np.argmin(value))])
    near = np.array([middle - step, middle, middle + step])
    bottom = np.array([cost(t) for t in near])
    bend = float(bottom[0] - 2 * bottom[1] + bottom[2]) / step**2
    if bend <= 0 or not np.isfinite(bend):
        return None
    ahead = middle + float(np.clip(0.5 * step * (bottom[0] - bottom[2]) / (bend * step**2), -step, step))
    n = len(mutual_sightings(others, own, logs, labels))
    return RobotClock(ahead, cfg.clock_together / np.sqrt(2.0 * bend * n))


def of_another_time(logs: Sequence[LandmarkLog]) -> dict[str, float]:
    """Robots that saw another of the team, or were seen, with a log of another time than all others' -> the gap [s].

    One of the two clocks is wrong then, by the gap at least: who stands before a camera drives at that moment.
    """
    spans = {log.robot: log.span for log in logs if len(log)}
    met = {frozenset((log.robot, name)) for log in logs for name in log.sightings.counts() if name in spans}
    out = {}
    for robot, (first, last) in spans.items():
        gaps = [max(a - last, first - b) for other, (a, b) in spans.items() if frozenset((robot, other)) in met]
        everybody = [max(a - last, first - b) for other, (a, b) in spans.items() if other != robot]
        if gaps and min(everybody) > 0.0:
            out[robot] = min(everybody)
    return out
