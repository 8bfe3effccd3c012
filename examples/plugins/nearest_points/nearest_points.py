"""A scan matcher of one's own: point to line, against the nearest points of the last scans that were kept.

Once installed it is chosen by `[laser.front_end] matcher = "nearest-points"` in the file that `--config` names.
"""

import numpy as np
from scipy.spatial import cKDTree

from mapweave.core import se2
from mapweave.laser.scan_matching import ScanMatch

STEPS, REACH, KEPT, SIGMA = 15, 0.5, 60, 0.05  # Gauss-Newton steps; [m]; scans; [m] of a return from its wall
APART, TURNED = 0.4, 0.4  # [m], [rad] from the last scan that was kept, from which one is
TURNS = np.arange(-1.3, 1.31, 0.1)  # [rad] tried to either side where nothing is known of the motion


class NearestPoints:
    """A `mapweave.core.plugins.Matcher`."""

    def __init__(self, cfg, tangent) -> None:
        self.kept, self.last, self.tree = [], None, None

    def match(self, b, predicted, sd) -> ScanMatch:
        pose, prior = np.array(predicted, float), np.diag(np.asarray(sd, float) ** -2.0)
        for _ in range(STEPS):
            H, g, _ = self._walls(b, pose)
            step = np.linalg.solve(H + prior, g + prior @ se2.between(pose, predicted))
            pose = np.asarray(se2.compose(pose, step))
        H, _, near = self._walls(b, pose, REACH / 5)
        return ScanMatch(pose, H + prior, se2.between(predicted, pose), near, len(b.q))

    def match_alone(self, b, last, step, sd) -> ScanMatch:
        on = np.asarray(se2.compose(last, step))
        tried = [on + np.array([0, 0, turn]) for turn in TURNS]
        best = max(tried, key=lambda pose: self._walls(b, pose, REACH / 5)[2])
        match = self.match(b, best, sd)
        return match._replace(innovation=se2.between(on, match.pose))

    def insert(self, b, pose) -> bool:
        if self.last is not None:
            moved = se2.between(self.last, pose)
            if np.hypot(*moved[:2]) < APART and abs(moved[2]) < TURNED:
                return False
        self.hold([*self.kept, (b, np.array(pose))][-KEPT:])
        return True

    def hold(self, scans) -> None:
        self.kept, self.tree = list(scans), None
        if self.kept:
            self.last = self.kept[-1][1]
            points = np.concatenate([se2.act(pose, b.s) for b, pose in self.kept])
            self.normal = np.concatenate([b.normal @ se2.rotation(pose[2]).T for b, pose in self.kept])
            self.tree = cKDTree(points)

    def information(self, b, pose) -> np.ndarray:
        return self._walls(b, pose)[0]

    def _walls(self, b, pose, reach=REACH):
        """Information and gradient of a motion in the robot's frame, and how many returns have a wall near."""
        if self.tree is None or not len(b.q):
            return np.zeros((3, 3)), np.zeros(3), 0
        seen = se2.act(pose, b.s)
        far, k = self.tree.query(seen, distance_upper_bound=reach)
        near = np.isfinite(far)
        n, s = self.normal[k[near]] @ se2.rotation(pose[2]), b.s[near]
        off = np.einsum("ij,ij->i", n, (self.tree.data[k[near]] - seen[near]) @ se2.rotation(pose[2]))
        J = np.column_stack([n, n[:, 1] * s[:, 0] - n[:, 0] * s[:, 1]])
        weight = 60 / max(1, len(b.q)) / SIGMA**2 / (1 + (off / 0.1) ** 2)  # a scan is worth 60 returns; Cauchy
        return (J * weight[:, None]).T @ J, (J * weight[:, None]).T @ off, int(near.sum())
