"""How the robot moved between two scans: odometry, a match against the local map, and a gate between them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from ..core import se2
from ..core.records import Scan
from .beam import STEERING, Beams
from .config import LaserConfig
from .scan_matching import FrontEnd, allowed_sd
from .trace import ScanInfo

NO_INNOVATION = np.zeros(3)
LEAST_SHARE = 0.25  # of the returns must match, or odometry is taken
ALONE = np.array([0.25, 0.25, 0.35])  # [m, m, rad] a robot without odometry may move in a step, one sigma


def inside(innovation: Float[np.ndarray, "3"], eps: Float[np.ndarray, "3"]) -> bool:
    """Whether a match lies where odometry allows: the motion model is 1 inside eps and 0 outside # [Hara07] eq. 5."""
    allowed: Bool[np.ndarray, 3] = np.abs(innovation) <= eps
    return bool(allowed.all())


class Carrier:
    """A trajectory through all scans that drifts but never jumps. It belongs to one state, which `advance` changes.

    gated: a match outside the gate is refused and odometry taken; else only a match of too few returns is.
    """

    def __init__(self, cfg: LaserConfig, *, feature: str, gated: bool, matching: bool = True) -> None:
        self.cfg, self.gated, self.matching = cfg, gated, matching
        steers = feature in STEERING
        front_end = cfg.front_end if steers else replace(cfg.front_end, alpha=0.0)
        self.front_end = FrontEnd(front_end, front_end.tangent if steers else front_end.bare_tangent)
        self.poses: list[np.ndarray] = []
        self.odometry: np.ndarray | None = None
        self.step = np.zeros(3)

    def advance(self, scan: Scan, b: Beams) -> ScanInfo:
        """`poses` has one more: where the carrier's robot was at the scan."""
        u, sd = self._increment(scan)
        if not self.poses:
            return self._accept(
                b, np.zeros(3), ScanInfo(NO_INNOVATION, len(b.q), 0, "first", information=np.zeros((3, 3)))
            )
        predicted = se2.compose(self.poses[-1], u)
        if len(b.q) < self.cfg.filter.least_beams:
            info = ScanInfo(NO_INNOVATION, len(b.q), 0, "empty", information=np.diag(sd**-2.0))
            return self._accept(None, predicted, info)
        if not self.matching:
            info = ScanInfo(NO_INNOVATION, len(b.q), 0, "odometry", information=np.diag(sd**-2.0))
            return self._accept(None, predicted, info)
        found = self.front_end.match(b, predicted, sd)
        wanted = found.matches >= LEAST_SHARE * found.beams
        if wanted and self.gated and scan.odometry is not None:
            wanted = inside(found.innovation, self.cfg.eps(sd))
        info = ScanInfo(
            found.innovation,
            found.beams,
            found.matches,
            "matched" if wanted else "odometry",
            information=found.information if wanted else np.diag(sd**-2.0),
        )
        return self._accept(b, found.pose if wanted else predicted, info)

    def _increment(self, scan: Scan) -> tuple[np.ndarray, np.ndarray]:
        if scan.odometry is None:
            return self.step, ALONE
        u = np.zeros(3) if self.odometry is None else se2.between(self.odometry, scan.odometry)
        self.odometry = np.asarray(scan.odometry)
        return u, allowed_sd(u, self.cfg.front_end)

    def _accept(self, b: Beams | None, pose: np.ndarray, info: ScanInfo) -> ScanInfo:
        if self.poses:
            self.step = se2.between(self.poses[-1], pose)
        self.poses.append(pose)
        if b is not None and self.matching:
            self.front_end.insert(b, pose)
        return info
