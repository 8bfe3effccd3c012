"""People and other things that move are left out of scans before anything is matched against them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.config import config
from ..core.records import Scan, frozen
from ..core.rows import spread
from ..kernels.laser.moving import BeamRanges, Thing, moving_returns


@config
class MovingConfig:
    """What counts as a thing that moves; see `kernels.laser.moving.moving_returns`."""

    leave_out: bool = True  # whether returns of things that move are left out of matching and of the map
    earlier: int = 4  # earlier scans that are asked,
    least_age: float = 0.4  # [s] so old at least and
    most_age: float = 2.5  # [s] at most; with none so old the latest that is older
    jump: float = 0.12  # [m] + jump_share r: ranges of neighbouring beams that differ by less belong to one thing
    jump_share: float = 0.03  # [m/m] the same, growing with range
    ahead: float = 0.3  # [m] a thing stands before what is seen beside it
    widest: float = 1.2  # [m] a thing that moves
    margin: float = 0.25  # [m] beyond a place that a scan must see to have seen through it
    same: float = 0.12  # [m] and less between ranges: the same thing
    slant: float = 1.5  # times the range's change to the next beam: more of a margin for what is seen at a slant
    votes: int = 2  # more earlier scans that say that a return moved than say the opposite
    least_run: int = 3  # returns beside each other that seem to move, where they do not stand free
    beside: int = 2  # returns on either side of such a run that move with it, where their ranges go on
    blur: float = 0.01  # [rad] the heading between scans may be wrong, and
    blur_share: float = 0.2  # [rad/rad] so much more of what was turned between
    astray: float = 0.006  # [rad] mean error of headings before matching from which on nothing is left out
    forget: float = 0.97  # of that mean, a scan
    most_share: float = 0.3  # of a scan's returns that may move: when more seem to, it is the robot's pose that is off


class _Earlier(NamedTuple):
    t: float
    ranges: Float[np.ndarray, " n"]
    hit: Bool[np.ndarray, " n"]
    first: float
    step: float
    sensor: Float[np.ndarray, "3"]  # on the robot
    pose: Float[np.ndarray, "3"]  # of the sensor, in the frame of the front end


class MovingReturns:
    """What one robot's scanners saw lately. `cleaned` and `correct` change it.

    count: returns found to move, of `total` asked about.
    """

    def __init__(self, cfg: MovingConfig) -> None:
        self.cfg = cfg
        self.count = self.total = 0
        self._earlier: dict[bytes, list[_Earlier]] = {}
        self._latest = b""
        self._expected = np.zeros(3)  # of the robot, when the latest scan came
        self._astray = 0.0  # [rad] mean error of such headings

    def cleaned(self, t: float, scan: Scan, pose: Float[np.ndarray, "3"]) -> Scan:
        """The scan without returns of things that move. pose: of the robot, as far as it is known before matching."""
        c = self.cfg
        sensor = np.asarray(se2.compose(pose, scan.T_robot_sensor))
        now = _Earlier(t, scan.ranges, scan.hit, scan.angle_min, scan.angle_increment, scan.T_robot_sensor, sensor)
        self._latest, self._expected = scan.T_robot_sensor.tobytes(), np.asarray(pose)
        held = self._earlier.setdefault(scan.T_robot_sensor.tobytes(), [])
        if held and (len(held[-1].ranges), held[-1].first, held[-1].step) != (len(now.ranges), now.first, now.step):
            held.clear()
        asked = self._asked(held, t)
        held.append(now)
        while len(held) > 1 and held[1].t < t - c.most_age:
            held.pop(0)
        self.total += int(scan.hit.sum())
        if not asked or scan.angle_increment == 0.0 or self._astray > c.astray:
            return scan
        poses = np.array([se2.between(one.pose, sensor) for one in asked])
        moves = moving_returns(
            BeamRanges(
                frozen(scan.ranges),
                frozen(scan.hit, dtype=np.bool_),
                scan.angle_min,
                scan.angle_increment,
                float(min(scan.range_max, 1e6)),
            ),
            np.array([one.ranges for one in asked]),
            np.array([one.hit for one in asked]),
            poses,
            c.blur + c.blur_share * np.abs(poses[:, 2]),
            Thing(c.jump, c.jump_share, c.ahead, c.widest, c.margin, c.same, c.slant, c.votes, c.least_run, c.beside),
        )
        moving = int(moves.sum())
        if not 0 < moving <= c.most_share * int(scan.hit.sum()):
            return scan
        self.count += moving
        return replace(scan, hit=frozen(scan.hit & ~moves, dtype=np.bool_))

    def correct(self, pose: Float[np.ndarray, "3"]) -> None:
        """The latest scan was made from `pose`: later scans are held against it from there."""
        held = self._earlier.get(self._latest)
        miss = float(abs(se2.wrap_angle(pose[2] - self._expected[2])))
        self._astray = self.cfg.forget * self._astray + (1.0 - self.cfg.forget) * miss
        if held:
            held[-1] = held[-1]._replace(pose=np.asarray(se2.compose(pose, held[-1].sensor)))

    def _asked(self, held: list[_Earlier], t: float) -> list[_Earlier]:
        """The earlier scans that are asked, spread over the ages allowed."""
        c = self.cfg
        old = [one for one in held if one.t <= t - c.least_age]
        recent = [one for one in old if one.t >= t - c.most_age]
        if not recent:
            return old[-1:]
        return [recent[k] for k in spread(len(recent), c.earlier)]
