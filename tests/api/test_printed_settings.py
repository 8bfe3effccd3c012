"""`mapweave config` prints every class of settings of the rooms whose thresholds decide results."""

import ast
import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

import mapweave
from mapweave.api.configuration import JOBS, configuration_class
from mapweave.api.localize import LocalizeJobConfig
from mapweave.core.config import load

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


def test_of_a_table_that_a_job_shares_only_what_it_reads_is_printed_and_all_of_it_is_taken():
    printed = tomllib.loads(mapweave.configuration("localize"))
    assert set(printed["laser"]) == {"particles", "beam", "cells", "front_end"}
    assert set(printed["laser"]["cells"]) == {"alpha"}
    whole = tomllib.loads(mapweave.configuration("map", laser=True))
    assert load(LocalizeJobConfig, {"laser": whole["laser"]}) == LocalizeJobConfig()


def test_localize_reads_the_settings_that_it_prints():
    """Every other key of `[laser]` may be anything that is allowed: the result is the same."""
    drive = mapweave.simulate_laser(world=mapweave.CorridorConfig(distance=4.0), seed=1)
    where = mapweave.map(drive.log, method="gated")
    other = {"gate": 9.0, "icp": {"gate": 1.0}, "filter": {"neff": 3.0, "sd_xy": 1.0}, "resolution": 0.5}
    other |= {"graph": {"unsure": 9.0}, "cells": {"size": 0.3}, "likelihood": "paper", "resample": 0.1}
    tracks = [
        mapweave.localize(drive.log, where, start=(0.0, 0.0, 0.0), config={"laser": laser}).localisation.track.pose
        for laser in ({}, other, {"particles": 150})
    ]
    assert np.array_equal(tracks[0], tracks[1])
    assert not np.array_equal(tracks[0], tracks[2])
