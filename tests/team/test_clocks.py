"""Clocks that cannot be right are named."""

from dataclasses import replace

import numpy as np

import mapweave
from mapweave.core.landmark_log import LandmarkLog
from mapweave.team.clocks import of_another_time

from .teams import world


def later(log: LandmarkLog, by: float) -> LandmarkLog:
    assert log.odometry is not None
    return replace(
        log,
        odometry=replace(log.odometry, t=log.odometry.t + by),
        sightings=replace(log.sightings, t=log.sightings.t + by),
    )


def test_a_clock_an_hour_off_is_named_where_robots_saw_each_other():
    logs = list(world(4, minutes=1.0).logs)
    assert of_another_time(logs) == {}
    off = [logs[0], later(logs[1], 3600.0), *logs[2:]]
    assert 3530.0 < of_another_time(off)[logs[1].robot] < 3600.0
    assert len(of_another_time(off)) == 1


def test_logs_of_two_days_whose_robots_never_met_are_no_wrong_clocks():
    logs = list(world(4, minutes=1.0).logs)[:2]
    alone = []
    for log in logs:
        met = np.isin(log.sightings.what, [i for i, name in enumerate(log.sightings.ids) if name.startswith("robot")])
        alone.append(replace(log, sightings=log.sightings.select(~met)))
    assert of_another_time([alone[0], later(alone[1], 3600.0)]) == {}


def test_the_map_says_so(tmp_path):
    home = tmp_path / "team"
    mapweave.simulate_landmarks(home, robots=2, minutes=1.0, seed=7013)
    for name in ("Odometry", "Measurement"):
        rows = [r.split() for r in (home / f"Robot2_{name}.dat").read_text().splitlines() if not r.startswith("#")]
        moved = [" ".join([repr(float(t) + 3600.0), *rest]) for t, *rest in rows]
        (home / f"Robot2_{name}.dat").write_text("\n".join(moved) + "\n")
    made = mapweave.map(home, refine=False)
    assert any("robot 2: its clock has nothing in common" in w for w in made.metrics["warnings"])
