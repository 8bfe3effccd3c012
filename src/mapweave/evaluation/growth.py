"""How a map grew while the logs played: the global map's uncertainty, and its error and consistency against truth."""

from dataclasses import dataclass

import numpy as np

from ..core.truth import Survey
from ..landmarks.landmark_map import LandmarkMap
from .landmarks import score_landmarks


@dataclass(frozen=True, slots=True)
class GrowthPoint:
    """The largest component after `t` [s] since the first row; robots: how many are tied in.

    trace [m^2] and log_det of the joint covariance; rmse [m] and nees_per_dof against a survey, None without one.
    """

    t: float
    robots: int
    landmarks: int
    trace: float | None
    log_det: float | None
    rmse: float | None = None
    nees_per_dof: float | None = None


def growth_point(t: float, robots: int, landmarks: LandmarkMap, survey: Survey) -> GrowthPoint:
    """What there is to say about the global map at `t`."""
    n = len(landmarks)
    score = score_landmarks(landmarks, survey)
    sign, log_det = np.linalg.slogdet(landmarks.cov) if n else (0.0, 0.0)
    return GrowthPoint(
        t=t,
        robots=robots,
        landmarks=n,
        trace=float(np.trace(landmarks.cov)) if n else None,
        log_det=float(log_det) if sign > 0 else None,
        rmse=score.rmse,
        nees_per_dof=score.nees_per_dof,
    )
