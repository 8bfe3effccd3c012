"""Kernels of a laser team compiled before anybody waits for them; they stay on disk for every process after it."""

from itertools import takewhile
from pathlib import Path

from ..mapping.config import LaserConfig
from .laser_team import LiveLaserTeam, nobody
from .messages import encode
from .sources import OFFICE, messages, open_source
from .store import Store

ROBOTS = ("r1", "r2")
DRIVEN = 25.0  # [s] of their drives: long enough for their maps to be tried on each other


def compile_kernels(path: Path) -> None:
    """Two simulated robots are followed, tried on each other, solved and drawn once; `path` keeps what they tell."""
    with Store(path, "a map") as store:
        for name in ROBOTS:
            told = messages(open_source(OFFICE, name, None), name, "run", 1.0)
            begin, header = next(told)
            some = takewhile(lambda one: one[0] < begin + DRIVEN, told)  # noqa: B023  (used at once)
            store.put([(name, m.seq, encode(m)) for m in (header, *(message for _, message in some))])
        team = LiveLaserTeam(store, LaserConfig(method="graph", threads=1), nobody)
        while team.follow(dict.fromkeys(ROBOTS, 1 + max(store.numbers(ROBOTS[0])))):
            pass
        trial = team.trial()
        if trial is not None:
            team.search.decided(trial, trial.run())
        weaving = team.weaving()
        if weaving is not None:
            team.take(weaving.run())
        team.draw({})
