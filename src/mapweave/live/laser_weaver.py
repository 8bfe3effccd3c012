"""The thread in which a laser team is followed, so that nobody waits for it, and a second one that searches and solves.

What costs as much as the team, trying two maps on each other and solving the graph of all, takes place in the second,
one at a time: a scan that comes meanwhile is in the map all the same.
"""

import time
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import replace
from threading import Condition, Thread
from typing import NamedTuple

import numpy as np

from ..mapping.config import LaserConfig
from ..mapping.merge import Merge
from .isolation import HUNG, beside, in_words
from .joined import Joined
from .laser_team import LiveLaserTeam, Starts, WovenTeam, nobody
from .pair_search import PairTrial
from .store import Store
from .weaving import WovenGraphs

RESTED = 3.0  # the time from solving to solving, and from drawing to drawing, is at least so many times what it takes
SEARCHED = 0.25  # the time without a search is at least so many times what the search before took
DRAW_EVERY = 0.5  # [s]
OVERDUE = 8.0  # [s] that solving and searching are put off for messages that wait
ENDING = 1.0  # [s] that its thread is waited for
MOST_FAILED = 100  # failures kept: what goes wrong as often goes wrong on
PATIENCE = 0.5  # [s] until it is looked again whether to end


class _Searched(NamedTuple):
    """A trial under way since `begin` [s]."""

    trial: PairTrial
    begin: float
    merge: Future[Merge]


class _Solving(NamedTuple):
    """A solution under way since `begin` [s]."""

    begin: float
    woven: Future[WovenGraphs]


class LaserWeaver:
    """A laser team as it is followed, from what the store holds up to where there is no gap.

    newest: the last map, None before the first; failed: what failed so far, each once and the first of many alone.
    """

    def __init__(self, store: Store, cfg: LaserConfig, every: float, starts: Starts = nobody) -> None:
        self.newest: WovenTeam | None = None
        self.failed: list[str] = []
        self._died = ""
        self._moved = time.monotonic()
        self._team = LiveLaserTeam(store, replace(cfg, method="graph", threads=1), starts)
        self._every = every
        self._heard: dict[str, int] = {}
        self._void: set[str] = set()
        self._joined = Joined()
        self._changed = Condition()
        self._ended = False
        self._thread = Thread(target=self._live, name="weaver", daemon=True)
        self._work: _Searched | _Solving | None = None
        self._search_due = self._weave_due = self._draw_due = 0.0

    def start(self) -> None:
        self._thread.start()

    @property
    def died(self) -> str:
        """What ended its thread, or that it has stood still for too long; empty while it lives."""
        hung = time.monotonic() > self._moved + HUNG
        return self._died or (f"it has stood still for {HUNG:g} s" if hung else "")

    def hear(self, heard: Mapping[str, int]) -> None:
        """Robot -> the first number missing: all before it is to be worked in."""
        with self._changed:
            if dict(heard) != self._heard:
                self._heard = dict(heard)
                self._changed.notify()

    def tie(self, joined: Joined) -> None:
        """What sightings tie: it is drawn in one frame from now on, and no wall is believed against it."""
        self._joined = joined

    def begin_again(self, robot: str) -> None:
        """What this robot had told is void: from here on it has told what the store holds."""
        with self._changed:
            self._void.add(robot)
            self._changed.notify()

    def stop(self) -> None:
        """No more is worked in; what is under way is waited for no longer than a moment."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(ENDING)

    def _live(self) -> None:
        try:
            self._run()
        except BaseException as error:  # noqa: BLE001  (who started it is told, and starts another)
            self._died = in_words(error)

    def _run(self) -> None:
        followed = {"": -1}
        unsolved = undrawn = False  # whether there is anything that the last solution, the last map lack
        waiting = 0  # messages that were heard and are not worked in
        while True:
            heard = self._next(followed, self._due(unsolved=unsolved, undrawn=undrawn))
            if heard is None:
                return
            try:
                for name in self._taken():
                    self._team.lost.pop(name, None)
                    self._team.forget(name)
                    followed = {"": -1}
                if heard != followed:
                    before = self._worked_in()
                    waiting = left = self._team.follow(heard)
                    more = self._worked_in() > before
                    unsolved, undrawn = unsolved or more, undrawn or more
                    followed = {"": -1} if left and more else heard  # what is not in the store yet is waited for
                done = self._done()
                unsolved |= done is _Searched
                undrawn |= done is _Solving
                late = OVERDUE if waiting > len(heard) else 0.0  # what is new goes first
                now = time.monotonic()
                if self._team.joined is not self._joined:
                    self._team.joined, unsolved, undrawn = self._joined, True, True
                if unsolved and self._work is None and now >= self._weave_due + late:
                    unsolved = False
                    self._solve()
                if undrawn and now >= self._draw_due:
                    drawn = self._team.draw(heard)
                    self.newest = drawn if drawn.placed else self.newest
                    undrawn = self._team.unlaid > 0
                    self._draw_due = _rested(now, DRAW_EVERY)
                if self._work is None and time.monotonic() >= self._search_due + late:
                    self._search()
            except Exception as error:  # noqa: BLE001  (what fails is told; the thread goes on with what comes)
                self._tell(in_words(error))
                followed, unsolved = heard, True
                self._weave_due = max(self._weave_due, time.monotonic() + self._every)

    def _taken(self) -> set[str]:
        """The robots that begin again."""
        with self._changed:
            void, self._void = self._void, set()
        return void

    def _due(self, *, unsolved: bool, undrawn: bool) -> float:
        """When anything is to be done but for what is heard or ends meanwhile [s]."""
        solve = self._weave_due if unsolved and self._work is None else np.inf
        return float(min(solve, self._draw_due if undrawn else np.inf))

    def _next(self, followed: Mapping[str, int], due: float) -> dict[str, int] | None:
        """What was heard by now, as soon as it is more than `followed` or something is due; None to end."""
        self._moved = time.monotonic()
        with self._changed:
            ended = self._work is not None and self._work[-1].done()
            if not (self._ended or self._void or ended) and self._heard == followed:
                self._changed.wait(max(min(PATIENCE, due - time.monotonic()), 0.01))
            return None if self._ended else dict(self._heard)

    def _solve(self) -> None:
        """The graph of all robots is solved, beside everything else."""
        weaving = self._team.weaving()
        if weaving is not None:
            self._work = _Solving(time.monotonic(), beside(weaving.run))
            self._work.woven.add_done_callback(self._wake)

    def _search(self) -> None:
        """Two maps that are to be tried on each other are, beside everything else, and one pair at a time."""
        trial = self._team.trial()
        if trial is not None:
            self._work = _Searched(trial, time.monotonic(), beside(trial.run))
            self._work.merge.add_done_callback(self._wake)

    def _wake(self, done: object) -> None:  # noqa: ARG002
        with self._changed:
            self._changed.notify()

    def _done(self) -> type | None:
        """What has ended beside, if anything has: what it came to stands from now on."""
        work = self._work
        if work is None or not work[-1].done():
            return None
        self._work = None
        if isinstance(work, _Searched):
            self._search_due = time.monotonic() + SEARCHED * (time.monotonic() - work.begin)
            try:
                merge = work.merge.result()
            except Exception as error:  # noqa: BLE001  (no tie comes of it, and no harm to others)
                merge = Merge(work.trial.a, work.trial.b, merged=False, reason=in_words(error))
                self._tell(f"{merge.a} and {merge.b}, tried on each other: {merge.reason}")
            if {work.trial.a, work.trial.b} <= self._team.robots.keys():
                self._team.search.decided(work.trial, merge)
            return _Searched
        self._weave_due = _rested(work.begin, self._every)
        self._team.take(work.woven.result())
        return _Solving

    def _tell(self, why: str) -> None:
        if why not in self.failed and len(self.failed) < MOST_FAILED:
            self.failed.append(why)

    def _worked_in(self) -> int:
        return sum(robot.next for robot in self._team.robots.values())


def _rested(begin: float, every: float) -> float:
    """When what began at `begin` and ended now is due again [s]."""
    now = time.monotonic()
    return now + max(every, RESTED * (now - begin))
