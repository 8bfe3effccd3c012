"""A log format of one's own: once installed, `mapweave map drive.ring --out result` reads it like any other.

The first line is `RING angle_min step range_max` [rad, rad, m], each further one `t x y theta r1 r2 ..` in seconds,
metres and radians:
where the wheels believe the robot to be, and a range a beam, 0 where nothing came back.
"""

import hashlib

import numpy as np

from mapweave import Finding, LaserLog, ReaderError, Track
from mapweave.core.records import Scan


class Ring:
    """A `mapweave.core.plugins.Reader`."""

    def reads(self, log) -> bool:
        return log.text.startswith("RING ")

    def read(self, log, robot, *, sensor_pose=None, mirrored=False) -> LaserLog:
        if mirrored:
            raise ReaderError(log.path, "a RING log tells itself which way its beams run: --mirrored is not for it")
        rows, beams = list(log.lines()), None
        first, step, reach = self._numbers(log, *rows[0])[:3]
        place = np.zeros(3) if sensor_pose is None else np.array(sensor_pose, float)
        times, poses, scans = [], [], []
        for number, line in rows[1:]:
            t, *pose = self._numbers(log, number, line)[:4]
            ranges = np.array(self._numbers(log, number, line)[4:])
            beams = beams or len(ranges)
            if len(ranges) != beams or (times and t <= times[-1]):
                raise ReaderError(log.path, f"expected {beams} ranges and a later time than the row before", number)
            hit = (ranges > 0) & (ranges < reach)
            scan = Scan(np.where(hit, ranges, reach), hit, None, first, step, reach, place, odometry=np.array(pose))
            times.append(t)
            poses.append(pose)
            scans.append(scan)
        findings = () if scans else (Finding("log-short", f"{log.path.name}: no scan", "nothing is mapped"),)
        return LaserLog(
            robot,
            str(log.path),
            np.array(times),
            tuple(scans),
            Track(np.array(times), np.array(poses).reshape(-1, 3), frame="odom"),
            findings=findings,
            log_hash=hashlib.sha256(log.text.encode()).hexdigest(),
        )

    @staticmethod
    def _numbers(log, number, line) -> list[float]:
        try:
            return [float(word) for word in line.removeprefix("RING ").split()]
        except ValueError as error:
            raise ReaderError(log.path, str(error), number) from None


RING = Ring()
