"""A landmark robot that is driving: the estimator of `map`, one message at a time."""

from collections.abc import Callable

import numpy as np

from ..core.errors import EstimateError
from ..core.run import Runner
from ..landmarks import ekf_slam
from ..landmarks.config import EkfSlamConfig
from ..landmarks.landmark_map import LocalMap, Submap
from ..landmarks.mapping import local_map, without_impossible
from .door import decode
from .landmark_stream import LandmarkRecord
from .messages import Header, Numbered, Snapshot, pack, pack_triangle
from .store import Store

WANDERING_EVERY = 32  # messages: a robot without odometry is mapped anew from its first row
WANDERING_FIRST = frozenset({4, 8, 16})  # messages after which it is, before


class LandmarkRobot:
    """The estimate of one robot after the messages so far; with its log's end it is the one that a whole log gives."""

    def __init__(self, header: Header, cfg: EkfSlamConfig) -> None:
        self.record = LandmarkRecord.begin(header)
        self.t: float | None = None
        self.last = 0
        self._cfg = cfg
        self._driven = False  # whether a row of its wheels is there
        self._wandering = not (cfg.odometry and header.odometry)
        self._submap: Submap | None = None
        self._counts: dict[str, int] = {}
        self._runner = Runner(ekf_slam, self._cfg, 0)

    def add(self, message: Numbered) -> None:
        """The estimate with the rows of `message`."""
        self.last = message.seq
        if isinstance(message, Header):  # it was begun with it
            return
        part = self.record.add(message)
        if part is None or part.end is None:
            return
        self.t = part.end if self.t is None else max(self.t, part.end)
        log = without_impossible(self.record.log_of(part))
        for name, n in log.sightings.counts().items():
            self._counts[name] = self._counts.get(name, 0) + n
        self._driven |= log.odometry is not None
        announced = self._cfg.odometry and self.record.header.odometry
        if not announced or (self.record.wheelless and not self._driven):
            if not self._wandering or message.seq % WANDERING_EVERY == 0 or message.seq in WANDERING_FIRST:
                self._map_anew()
            self._wandering = True
            return
        if self._wandering:  # its wheels were late
            self._wandering = False
            self._runner = Runner(ekf_slam, self._cfg, 0)
            log = without_impossible(self.record.log)
        for event in log.events():
            self._runner.push(event)
            self._submap = None

    def _map_anew(self) -> None:
        log = self.record.log
        mapped = local_map(log, self._cfg, 0) if len(log.sightings) else None
        self._submap = mapped.submap if mapped is not None and mapped.submap.ids else None

    @property
    def submap(self) -> Submap:
        """Pose and landmarks in `local_k`; raises EstimateError when the estimate left finite numbers."""
        if self._submap is None:
            robot = self.record.header.log_robot
            state = self._runner.states.get(robot) or ekf_slam.initial(robot, self._cfg)
            if not np.isfinite(state.x).all():
                raise EstimateError(f"{robot}: EKF-SLAM left finite numbers")
            self._submap = state.submap
        return self._submap

    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """`T_local_robot`, the upper triangle of its covariance, how many landmarks there are."""
        m = self.submap
        return tuple(m.pose.tolist()), tuple(m.cov[:3, :3][np.triu_indices(3)].tolist()), len(m.ids)

    def snapshot(self) -> Snapshot:
        """What a map process fuses while the robot drives on."""
        m, h = self.submap, self.record.header
        return Snapshot(
            robot=h.robot,
            run=h.run,
            last=self.last,
            t=self.t or 0.0,
            pose=tuple(m.pose.tolist()),
            ids=list(m.ids),
            mean=pack(*m.mean.T),
            cov=pack_triangle(m.cov),
            counts=[self._counts.get(name, 0) for name in m.ids],
        )


def mapped_again(store: Store, robot: str, end: int, cfg: EkfSlamConfig, ended: Callable[[], bool]) -> Snapshot | None:
    """What `robot` would have told after its messages before `end`, which are in the store.

    None when they make no map, or when it is `ended` meanwhile.
    """
    record: LandmarkRecord | None = None
    try:
        for _, payload in store.get(robot, 0, end - 1):
            message = decode(payload)
            if ended():
                return None
            if isinstance(message, Header):
                record = LandmarkRecord.begin(message)
            elif record is not None and isinstance(message, Numbered):
                record.add(message)
        return None if record is None else _told(record, end - 1, local_map(record.log, cfg))
    except Exception:  # noqa: BLE001  (whatever it told, it makes no map)
        return None


def _told(record: LandmarkRecord, last: int, m: LocalMap) -> Snapshot:
    return Snapshot(
        robot=record.header.robot,
        run=record.header.run,
        last=last,
        t=record.log.span[1],
        pose=tuple(m.submap.pose.tolist()),
        ids=list(m.submap.ids),
        mean=pack(*m.submap.mean.T),
        cov=pack_triangle(m.submap.cov),
        counts=[m.sightings.get(name, 0) for name in m.submap.ids],
    )
