"""A small simulated team, its logs, its fused map and what is true of it."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import mapweave
from mapweave.api.evaluate import TeamTruth, read_team_truth
from mapweave.api.team import team_maps
from mapweave.core.landmark_log import LandmarkLog
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.fusion.result import Fusion
from mapweave.io.landmark_logs import read_landmark_logs
from mapweave.landmarks.mapping import local_map
from mapweave.team.team_map import TeamMap


@dataclass(frozen=True)
class World:
    logs: tuple[LandmarkLog, ...]
    fusion: Fusion
    map: TeamMap
    truth: TeamTruth


@cache
def world(seed: int, robots: int = 3, minutes: float = 3.0, misreads: float = 0.0, noise: float = 1.0) -> World:
    with TemporaryDirectory() as folder:
        home = Path(folder) / "team"
        mapweave.simulate_landmarks(
            home, robots=robots, landmarks=12, minutes=minutes, misreads=misreads, noise=noise, seed=seed
        )
        logs = tuple(read_landmark_logs(home, None))
        truth = read_team_truth([home], [log.robot for log in logs])
    local = [local_map(log) for log in logs]
    fusion = fuse(local, FuseConfig())
    return World(logs, fusion, team_maps(local, fusion)[0], truth)
