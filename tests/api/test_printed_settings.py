"""`mapweave config` prints every class of settings of the rooms whose thresholds decide results."""

import ast
from dataclasses import fields, is_dataclass
from pathlib import Path

import mapweave
from mapweave.api.configuration import JOBS, configuration_class

HOUSE = Path(mapweave.__file__).parent
ESTIMATING = ("landmarks", "fusion", "laser", "mapping", "swarm", "team", "exploration")


def test_every_class_of_settings_of_the_estimating_rooms_is_printed_for_some_job():
    printed, waiting = set(), [configuration_class(job, laser=laser)() for job, laser in JOBS]
    while waiting:
        cfg = waiting.pop()
        printed.add(type(cfg).__name__)
        waiting += [value for f in fields(cfg) if is_dataclass(value := getattr(cfg, f.name))]
    # what another inherits, and worlds that a file tells
    own = {"LaserTrackingConfig", "WorldConfig", "ScenarioConfig", "LaserScenarioConfig"}
    classes = []
    for path in (p for room in ESTIMATING for p in (HOUSE / room).rglob("*.py")):
        made = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ClassDef)]
        classes += [c.name for c in made if any(ast.unparse(d) == "config" for d in c.decorator_list)]
    assert len(classes) > 40
    assert set(classes) - printed == own
