"""A laser robot that is driving: the estimator of `map --method graph`, one message at a time."""

import numpy as np

from ..core.records import Scan
from ..laser.laser_map import GridMap
from ..laser.occupancy_mapper import render_keyframes
from ..mapping.config import LaserConfig
from .columns import TRIANGLE
from .driven import DrivenSession
from .laser_stream import LaserRecord
from .messages import Header, Numbered, Snapshot


class LaserRobot:
    """The estimate of one robot after the messages so far, by geometry: light is calibrated when the log is whole.

    t: [s] of it, the stamp of the latest scan that is in it; odometry: `T_odom_robot` (3,) there; None before it, or
    without any.
    """

    def __init__(self, header: Header, cfg: LaserConfig, seed: int = 0) -> None:
        self.record = LaserRecord(header)
        self.t: float | None = None
        self.odometry: np.ndarray | None = None
        self.last = 0
        self._cfg = cfg
        self._session = DrivenSession(header.log_robot, cfg, seed)

    def add(self, message: Numbered) -> None:
        """The estimate with the scans of `message`."""
        self.last = message.seq
        if isinstance(message, Header):  # it was begun with it
            return
        part = self.record.add(message)
        if part is None:
            return
        for event in part.events():
            if self._session.push(event) is not None and isinstance(event.record, Scan):
                self.t, self.odometry = event.t, event.record.odometry
            self._session.left.clear()

    def status(self) -> tuple[tuple[float, ...], tuple[float, ...], int]:
        """`T_local_robot`, the upper triangle of its covariance, how many landmarks there are: none."""
        now = self._session.now
        cov = np.nan_to_num(now.cov)
        return tuple(now.pose.tolist()), tuple(cov[TRIANGLE].tolist()), 0

    def map(self) -> GridMap | None:
        """The grid so far, of the keyframes' scans, in the frame that poses are told in; None before the first scan."""
        graph = self._session.graph(covariances=False)
        frame = f"local_{self.record.header.log_robot}"
        return None if graph is None else render_keyframes(graph, self._cfg.resolution, frame)

    def snapshot(self) -> Snapshot | None:
        """A laser robot hands over scans alone."""
        return None
