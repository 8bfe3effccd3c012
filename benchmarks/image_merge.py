"""Two maps laid on each other as pictures: ORB features, RANSAC, and the confidence rule of the common map merger.

The merger that ROS users run (`multirobot_map_merge`) takes the occupancy pictures of the robots, matches features
between them, fits a transform and believes it where `inliers / (8 + 0.3 matches)` reaches 1 (Brown and Lowe 2007). This
is that rule, written anew; it stands beside ours in `merge_trials.py`. Needs `opencv-python-headless` (extra `bench`).
"""

from collections.abc import Iterator

import cv2
import numpy as np

from mapweave.core import se2
from mapweave.laser.occupancy_mapper import Returns, render_returns
from mapweave.mapping.map_overlap import KeyframeMap

RESOLUTION = 0.05  # [m]
FEATURES = 500  # of a picture at most, as the merger asks for
RATIO = 0.7  # of the second nearest feature's distance
REACH = 3.0  # [pixels] of an inlier
CONFIDENCE = 1.0
SCALE = 0.1  # a fit that stretches by more is none: both pictures have one resolution
UNKNOWN, FREE, WALL = 205, 254, 0


def picture(m: KeyframeMap) -> tuple[np.ndarray, np.ndarray]:
    """The occupancy picture of a map, and the map's coordinates [m] of its first pixel."""
    none = np.zeros((0, 2))
    laid = [Returns(np.asarray(points), none, np.zeros(2)) for points in m.points]
    grid = render_returns(laid, np.asarray(m.pose), RESOLUTION, "map")
    out = np.full(grid.shape, UNKNOWN, np.uint8)
    seen = grid.hits + grid.passes > 0
    out[seen] = np.where(grid.occupancy()[seen] > 0.5, WALL, FREE)
    return out, np.asarray(grid.origin) + 0.5 * RESOLUTION


def merged_by_features(a: KeyframeMap, b: KeyframeMap) -> np.ndarray | None:
    """Where b lies in a's map, (3,) [m, m, rad]; None where the rule does not believe it."""
    (one, at_one), (other, at_other) = picture(a), picture(b)
    orb = cv2.ORB_create(nfeatures=FEATURES)
    (keys_one, told_one), (keys_other, told_other) = (orb.detectAndCompute(p, None) for p in (one, other))
    if told_one is None or told_other is None or min(len(keys_one), len(keys_other)) < 2:
        return None
    pairs = dict(_nearest(told_other, told_one))
    pairs |= {j: i for i, j in _nearest(told_one, told_other) if j not in pairs}
    if len(pairs) < 6:
        return None
    source = np.array([keys_other[j].pt for j in pairs])
    target = np.array([keys_one[i].pt for i in pairs.values()])
    cv2.setRNGSeed(0)
    fitted, inlier = cv2.estimateAffinePartial2D(
        source, target, method=cv2.RANSAC, ransacReprojThreshold=REACH, maxIters=5_000, confidence=0.99
    )
    if fitted is None or inlier.sum() / (8.0 + 0.3 * len(pairs)) < CONFIDENCE:
        return None
    if abs(np.hypot(fitted[0, 0], fitted[1, 0]) - 1.0) > SCALE:
        return None
    turn = np.arctan2(fitted[1, 0], fitted[0, 0])
    middle = source[inlier.ravel() > 0].mean(axis=0)
    shift = at_one + RESOLUTION * (fitted @ np.append(middle, 1.0))
    held = at_other + RESOLUTION * middle
    return np.array([*(shift - se2.rotation(float(turn)) @ held), se2.wrap_angle(turn)])


def _nearest(asked: np.ndarray, among: np.ndarray) -> Iterator[tuple[int, int]]:
    """Features whose nearest is much nearer than their second nearest, with that nearest."""
    for found in cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(asked, among, k=2):
        if len(found) == 2 and found[0].distance < RATIO * found[1].distance:
            yield found[0].queryIdx, found[0].trainIdx
