"""A team's result as files."""

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

from ..io.calibration import write_calibration
from ..io.directory import write_json
from ..io.landmarks import write_landmark_arrays, write_landmarks
from ..io.local_map import write_local_map
from ..io.team_map import write_tracks
from ..report.team import write_team_report
from ..report.team_story import TeamStory
from ..team.team_map import TeamMap


def write_team(folder: Path, story: TeamStory, metrics: Mapping[str, Any]) -> None:
    """Landmarks and trajectories of every component, local maps, report and, last, `metrics.json`."""
    began = perf_counter()
    for k, team in enumerate(story.maps, 1):
        _write_component(folder if k == 1 else folder / "components" / str(k), team)
    for local in story.local:
        home = folder / "local" / local.robot
        write_local_map(home, local)
        write_landmark_arrays(home, local.submap.landmarks)
    if story.smoothed:
        found = {robot: known for s in story.smoothed for robot, known in s.calibration.items()}
        write_calibration(folder / "calibration.json", found, story.smoothed[0].prior)
    wrote = perf_counter()
    write_team_report(folder, story)
    timing = {**metrics["timing"], "write": wrote - began, "report": perf_counter() - wrote}
    timing["total"] = sum(timing.values())
    write_json(folder / "metrics.json", {**metrics, "timing": {k: round(v, 4) for k, v in timing.items()}})


def _write_component(folder: Path, team: TeamMap) -> None:
    write_landmarks(folder, team)
    write_tracks(folder, team)
