"""People and other things that move are left out of scans before anything is matched against them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.config import config
from ..core.records import Scan, frozen
from ..core.rows import spread
from ..kernels.laser.moving import BeamRanges, Thing, flat_faces, moving_returns

MOVING_EARLIER = 4  # earlier scans that are asked,
LEAST_AGE = 0.4  # [s] so old at least and
MOST_AGE = 2.5  # [s] at most; with none so old the latest that is older
MOVING_JUMP = 0.12  # [m] + jump_share r: ranges of neighbouring beams that differ by less belong to one thing
JUMP_SHARE = 0.03  # [m/m] by which that grows with range
MOVING_AHEAD = 0.3  # [m] a thing stands before what is seen beside it
MOVING_WIDEST = 1.2  # [m] a thing that moves
MOVING_MARGIN = 0.25  # [m] beyond a place that a scan must see to have seen through it
MOVING_SAME = 0.12  # [m] between ranges, and less: the same thing
MOVING_SLANT = 1.5  # times the range's change to the next beam: more of a margin for what is seen at a slant
MOVING_VOTES = 2  # more earlier scans that say that a return moved than say the opposite
LEAST_RUN = 3  # returns beside each other that seem to move, where they do not stand free
MOVING_BESIDE = 2  # returns on either side of such a run that move with it, where their ranges go on
FACE = 0.35  # [m] wide at least is a flat face: what is hit squarely and passed at a slant may be glass,
FLAT = 0.01  # [m] so flat,
FACE_PANE = 0.8  # [m] and so wide, where it is not hit less squarely than it is passed
MOVING_BLUR = 0.01  # [rad] the heading between scans may be wrong, and
BLUR_SHARE = 0.2  # [rad/rad] of what was turned between that is added
MOVING_ASTRAY = 0.006  # [rad] mean error of headings before matching from which on nothing is left out
MOVING_FORGET = 0.97  # of that mean, a scan
MOST_SHARE = 0.3  # of a scan's returns that may move: when more seem to, it is the robot's pose that is off
SUDDEN = 0.1  # of them that seem to move all at once, twice what seemed to lately aside: another scene, no glass
SHARE_LEARNED = 0.2  # of what seems to move in a scan, in what did lately
THING = Thing(
    MOVING_JUMP,
    JUMP_SHARE,
    MOVING_AHEAD,
    MOVING_WIDEST,
    MOVING_MARGIN,
    MOVING_SAME,
    MOVING_SLANT,
    MOVING_VOTES,
    LEAST_RUN,
    MOVING_BESIDE,
    FACE,
    FLAT,
    FACE_PANE,
)


@config
class MovingConfig:
    """What counts as a thing that moves; see `kernels.laser.moving.moving_returns`."""

    leave_out: bool = True  # whether returns of things that move are left out of matching and of the map


class _Earlier(NamedTuple):
    t: float
    ranges: Float[np.ndarray, " n"]
    hit: Bool[np.ndarray, " n"]
    faces: Float[np.ndarray, "n 4"]
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
        self._share = 0.0  # of returns, that seemed to move lately if nothing were glass

    def cleaned(self, t: float, scan: Scan, pose: Float[np.ndarray, "3"]) -> Scan:
        """The scan without returns of things that move. pose: of the robot, as far as it is known before matching."""
        sensor = np.asarray(se2.compose(pose, scan.T_robot_sensor))
        hit = frozen(scan.hit, dtype=np.bool_)
        faces = flat_faces(frozen(scan.ranges), hit, scan.angle_min, scan.angle_increment, THING)
        now = _Earlier(
            t, scan.ranges, scan.hit, faces, scan.angle_min, scan.angle_increment, scan.T_robot_sensor, sensor
        )
        self._latest, self._expected = scan.T_robot_sensor.tobytes(), np.asarray(pose)
        held = self._earlier.setdefault(scan.T_robot_sensor.tobytes(), [])
        if held and (len(held[-1].ranges), held[-1].first, held[-1].step) != (len(now.ranges), now.first, now.step):
            held.clear()
        asked = self._asked(held, t)
        held.append(now)
        while len(held) > 1 and held[1].t < t - MOST_AGE:
            held.pop(0)
        self.total += int(scan.hit.sum())
        if not asked or scan.angle_increment == 0.0 or self._astray > MOVING_ASTRAY:
            return scan
        poses = np.array([se2.between(one.pose, sensor) for one in asked])
        moves, opaque = moving_returns(
            BeamRanges(
                frozen(scan.ranges),
                hit,
                scan.angle_min,
                scan.angle_increment,
                float(min(scan.range_max, 1e6)),
                faces,
            ),
            np.array([one.ranges for one in asked]),
            np.array([one.hit for one in asked]),
            np.array([one.faces for one in asked]),
            poses,
            MOVING_BLUR + BLUR_SHARE * np.abs(poses[:, 2]),
            THING,
        )
        share = float(opaque.sum()) / max(1, int(scan.hit.sum()))
        if share > SUDDEN + 2.0 * self._share:
            moves = opaque
        self._share += SHARE_LEARNED * (share - self._share)
        moving = int(moves.sum())
        if not 0 < moving <= MOST_SHARE * int(scan.hit.sum()):
            return scan
        self.count += moving
        return replace(scan, hit=frozen(scan.hit & ~moves, dtype=np.bool_))

    def correct(self, pose: Float[np.ndarray, "3"]) -> None:
        """The latest scan was made from `pose`: later scans are held against it from there."""
        held = self._earlier.get(self._latest)
        miss = float(abs(se2.wrap_angle(pose[2] - self._expected[2])))
        self._astray = MOVING_FORGET * self._astray + (1.0 - MOVING_FORGET) * miss
        if held:
            held[-1] = held[-1]._replace(pose=np.asarray(se2.compose(pose, held[-1].sensor)))

    def _asked(self, held: list[_Earlier], t: float) -> list[_Earlier]:
        """The earlier scans that are asked, spread over the ages allowed."""
        old = [one for one in held if one.t <= t - LEAST_AGE]
        recent = [one for one in old if one.t >= t - MOST_AGE]
        if not recent:
            return old[-1:]
        return [recent[k] for k in spread(len(recent), MOVING_EARLIER)]
