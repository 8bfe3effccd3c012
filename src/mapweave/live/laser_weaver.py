"""The thread in which a laser team is followed, so that nobody waits for it; a second one searches for ties."""

import time
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import Condition, Thread
from typing import NamedTuple

import numpy as np

from ..core.errors import MapweaveError
from ..laser.config import LaserConfig
from ..laser.merge import Merge
from .laser_team import LaserTeam, Starts, WovenTeam, nobody
from .pair_search import PairTrial
from .store import Store

RESTED = 3.0  # the time from solving to solving, and from drawing to drawing, is at least so many times what it takes
SEARCHED = 1.0  # the time without a search is at least so many times what the search before took
DRAW_EVERY = 0.5  # [s]
OVERDUE = 8.0  # [s] that solving and searching are put off for messages that wait
PATIENCE = 0.5  # [s] until it is looked again whether to end


class _Searched(NamedTuple):
    """A trial under way since `begin` [s]."""

    trial: PairTrial
    begin: float
    merge: Future[Merge]


class LaserWeaver:
    """A laser team as it is followed, from what the store holds up to where there is no gap.

    newest: the last map, None before the first; failed: why the last solution gave none, empty when it did.
    """

    def __init__(self, store: Store, cfg: LaserConfig, every: float, starts: Starts = nobody) -> None:
        self.newest: WovenTeam | None = None
        self.failed = ""
        self._team = LaserTeam(store, replace(cfg, method="graph", threads=1), starts)
        self._every = every
        self._heard: dict[str, int] = {}
        self._changed = Condition()
        self._ended = False
        self._thread = Thread(target=self._run, name="weaver", daemon=True)
        self._searcher = ThreadPoolExecutor(1, thread_name_prefix="searcher")
        self._trial: _Searched | None = None
        self._search_due = self._weave_due = self._draw_due = 0.0

    def start(self) -> None:
        self._thread.start()

    def hear(self, heard: Mapping[str, int]) -> None:
        """Robot -> the first number missing: all before it is to be worked in."""
        with self._changed:
            if dict(heard) != self._heard:
                self._heard = dict(heard)
                self._changed.notify()

    def stop(self) -> None:
        """No more is worked in; what is under way ends first."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join()
        self._searcher.shutdown(cancel_futures=True)

    def _run(self) -> None:
        followed = {"": -1}
        unsolved = undrawn = False  # whether there is anything that the last solution, the last map lack
        waiting = 0  # messages that were heard and are not worked in
        while True:
            heard = self._next(followed, waiting=unsolved or undrawn)
            if heard is None:
                return
            try:
                if heard != followed:
                    before = self._worked_in()
                    waiting = left = self._team.follow(heard)
                    more = self._worked_in() > before
                    unsolved, undrawn = unsolved or more, undrawn or more
                    followed = {"": -1} if left and more else heard  # what is not in the store yet is waited for
                unsolved |= self._searched()
                now = time.monotonic()
                late = OVERDUE if waiting > len(heard) else 0.0  # what is new goes first
                if unsolved and now >= self._weave_due + late:
                    undrawn |= self._team.weave()
                    self.failed, unsolved = "", False
                    self._weave_due = _rested(now, self._every)
                now = time.monotonic()
                if undrawn and now >= self._draw_due:
                    drawn = self._team.draw(heard)
                    self.newest = drawn if drawn.placed else self.newest
                    undrawn = self._team.unlaid > 0
                    self._draw_due = _rested(now, DRAW_EVERY)
                if time.monotonic() >= self._search_due + late:
                    self._search()
            except (MapweaveError, np.linalg.LinAlgError) as error:
                self.failed, unsolved = str(error), False
                followed, self._weave_due = heard, time.monotonic() + self._every

    def _next(self, followed: Mapping[str, int], *, waiting: bool) -> dict[str, int] | None:
        """What was heard by now, as soon as it is more than `followed` or something is due; None to end."""
        with self._changed:
            if not self._ended and self._heard == followed:
                due = min(self._weave_due, self._draw_due) if waiting else np.inf
                self._changed.wait(max(min(PATIENCE, due - time.monotonic()), 0.01))
            return None if self._ended else dict(self._heard)

    def _search(self) -> None:
        """Two maps that are to be tried on each other are, beside everything else, and one pair at a time."""
        if self._trial is not None:
            return
        trial = self._team.trial()
        if trial is not None:
            self._trial = _Searched(trial, time.monotonic(), self._searcher.submit(trial.run))
            self._trial.merge.add_done_callback(self._wake)

    def _wake(self, done: object) -> None:  # noqa: ARG002
        with self._changed:
            self._changed.notify()

    def _searched(self) -> bool:
        """Whether a search has ended; what it came to stands from now on."""
        if self._trial is None or not self._trial.merge.done():
            return False
        trial, begin, future = self._trial
        self._trial = None
        self._search_due = time.monotonic() + SEARCHED * (time.monotonic() - begin)
        try:
            merge = future.result()
        except (MapweaveError, np.linalg.LinAlgError) as error:
            merge = Merge(trial.a, trial.b, merged=False, reason=str(error))
        self._team.search.decided(trial, merge)
        return True

    def _worked_in(self) -> int:
        return sum(robot.next for robot in self._team.robots.values())


def _rested(begin: float, every: float) -> float:
    """When what began at `begin` and ended now is due again [s]."""
    now = time.monotonic()
    return now + max(every, RESTED * (now - begin))
