"""A log under two names is told and carries the first one's hash; logs of two robots are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from mapweave.core.landmark_log import LandmarkLog, SightingTable
from mapweave.core.records import Odometry
from mapweave.fusion.compared_logs import with_copies_marked


def a_log(robot: str, seed: int, n: int = 60) -> LandmarkLog:
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.5
    seen = SightingTable(t, rng.integers(0, 3, n), rng.uniform(1, 4, n), rng.uniform(-1, 1, n), ("6", "7", "robot2"))
    return LandmarkLog(robot, Odometry(t, np.ones(n), np.zeros(n)), seen)


def test_logs_of_two_robots_are_left_as_they_are():
    logs = [a_log("robot1", 1), a_log("robot2", 2), a_log("robot3", 3)]
    assert all(a is b for a, b in zip(with_copies_marked(logs), logs, strict=True))


def test_logs_of_many_robots_are_sorted_once_each_and_once_together(monkeypatch):
    sorts, unique = [], np.unique

    def counted(*args, **kw):
        sorts.append(len(args[0]))
        return unique(*args, **kw)

    logs = [a_log(f"robot{k}", k) for k in range(1, 21)]
    monkeypatch.setattr(np, "unique", counted)
    with_copies_marked(logs)
    assert sorts == [59] * 20 + [20 * 59]


@pytest.mark.parametrize("change", ["later", "without robots", "a part"])
def test_a_copy_carries_the_hash_of_the_first_and_says_so(change):
    log, other = a_log("robot1", 1, 200), a_log("robot2", 2)
    s = log.sightings
    seen = {
        "later": SightingTable(s.t + 5.0, s.what, s.range, s.bearing, s.ids),
        "without robots": s.select(s.what != 2),
        "a part": s.select(np.arange(50)),
    }[change]
    copy = replace(log, robot="robot3", sightings=seen, log_hash="")
    assert copy.log_hash != log.log_hash
    first, second, third = with_copies_marked([log, other, copy])
    assert first is log
    assert second is other
    assert third.log_hash == log.log_hash
    assert [(f.code, f.value) for f in third.findings] == [("log-twice", "robot1")]


def test_numbers_that_hardly_vary_prove_no_copy():
    logs = [a_log(f"robot{k}", k) for k in (1, 2)]
    flat = [
        replace(
            x,
            sightings=SightingTable(
                x.sightings.t, x.sightings.what, 0 * x.sightings.t + 2, 0 * x.sightings.t, x.sightings.ids
            ),
        )
        for x in logs
    ]
    assert all(a is b for a, b in zip(with_copies_marked(flat), flat, strict=True))
