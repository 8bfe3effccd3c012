"""Small mixed teams, what their robots made of their own logs, and what is true of them."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import mapweave
from mapweave.api.evaluate import TeamTruth, read_team_truth
from mapweave.api.team import team_maps
from mapweave.core.landmark_log import LandmarkLog
from mapweave.evaluation.team import score_team
from mapweave.fusion.config import FuseConfig
from mapweave.fusion.join import fuse
from mapweave.io.laser_logs import LaserSource, read_laser
from mapweave.io.mixed_logs import read_mixed_landmarks, sorted_logs
from mapweave.landmarks.mapping import local_map
from mapweave.mapping.config import LaserConfig
from mapweave.mapping.laser_mapping import map_laser
from mapweave.team.config import PlacingConfig, SmoothingConfig
from mapweave.team.mixed import map_mixed
from mapweave.team.team_map import TeamMap
from mapweave.team.walls import Scanned


@dataclass(frozen=True)
class Mixed:
    logs: tuple[LandmarkLog, ...]
    scanned: dict[str, Scanned]
    mapped: tuple[TeamMap, ...]
    truth: TeamTruth
    clocks: dict[str, float]

    def map(self, logs=None, scanned=None, mapped=None, smoothing=None, **options):
        return map_mixed(
            self.logs if logs is None else logs,
            self.scanned if scanned is None else scanned,
            self.mapped if mapped is None else mapped,
            {},
            smoothing or SmoothingConfig(),
            PlacingConfig(),
            **options,
        )

    def score(self, made):
        return score_team([s.map for s in made.components], {}, self.truth.survey, self.truth.robots)


@cache
def mixed(seed: int, **world: object) -> Mixed:
    with TemporaryDirectory() as folder:
        home = Path(folder) / "team"
        made = mapweave.simulate_team(home, seed=seed, **world)
        found = sorted_logs([home], LaserSource())
        logs = tuple(read_mixed_landmarks(found))
        graph = LaserConfig(method="graph", feature="none")
        maps = {robot: map_laser(read_laser(log.path, robot[5:]), graph, 0) for robot, log in found.lasers.items()}
        truth = read_team_truth([home], [log.robot for log in logs])
    local = [local_map(log) for log in logs if any(not name.startswith("robot") for name in log.sightings.counts())]
    mapped = [team for team in team_maps(local, fuse(local, FuseConfig())) if len(team.landmarks)] if local else []
    scanned = {robot: Scanned(m.graph, m.track) for robot, m in maps.items()}
    return Mixed(logs, scanned, tuple(mapped), truth, {r.name: r.clock for r in made.robots})
