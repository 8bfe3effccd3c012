"""A live team for programs: a laser robot whose scans are handed in, what the team tells it, what the team knows."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Self

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.config import load
from ..core.errors import UsageError
from ..core.paths import AnyConfig
from ..core.records import Event as ScanEvent
from ..core.records import Scan, frozen
from ..core.workers import one_blas_thread
from ..io.laser_arrays import NOWHERE, LaserStream, Numbers
from ..live.credentials import expect_heard
from ..live.driven import LaserRobot
from ..live.laser_feed import ScanFeed, log_robot
from ..live.messages import Header, Topics, check_name, square
from ..live.robot import Driving, Pace, RobotProcess
from ..live.store import Store, begun
from ..live.tiles import LEVELS
from ..live.told import LiveTeam, hear_team
from ..live.transport import LISTENING, Network, session
from .map_laser import LaserMapConfig


@dataclass(frozen=True, slots=True)
class LivePlace:
    """Where a robot is, at the stamp `t` [s] of the newest scan it told.

    own: (3,) `T_local_robot` [m, m, rad], in the frame of its own estimate, which never jumps but where a loop closes;
    own_cov: (3, 3) of it. part: of the team's map in which the robot stands, 0 while it stands in none, and then the
    rest is None; pose: (3,) `T_map_robot`; cov: (3, 3) as the map process told it last; frame: (3,) `T_map_local`.
    """

    t: float
    own: Float[np.ndarray, "3"]
    own_cov: Float[np.ndarray, "3 3"]
    part: int
    pose: Float[np.ndarray, "3"] | None
    cov: Float[np.ndarray, "3 3"] | None
    frame: Float[np.ndarray, "3"] | None


class LiveLaser:
    """One laser robot of a live team, driven by a program: scans in as they come; place, map and goal back.

    It is what `live_robot` makes of a log: what it tells is in `history` first, and whoever comes later asks for it
    there. Use it in a `with` block, whose end tells the team that the drive has ended.

    Parameters
    ----------
    name
        What the team calls it.
    period
        Seconds of scans in one message, and so how long at least the team waits for a scan (1).
    history
        The file that keeps what it told (`mapweave-live/TEAM-NAME.sqlite`).
    fresh
        Forget an earlier history; else this goes on after it, with stamps later than its last.
    linger
        How long it stays at most after the drive's end for those who lack something [s] (30).
    config
        Settings, as for `map`.
    level
        Of the map's squares that are heard: 0 is as fine as the map, 1 and 2 four times coarser each (0).
    network
        How to reach the others (those on this network find each other).
    say
        Called with a line where something happens.

    Raises
    ------
    UsageError
        For a name or a history that cannot be; when a robot of that name is in the team already.
    """

    def __init__(
        self,
        name: str,
        *,
        period: float = 1.0,
        history: Path | str | None = None,
        fresh: bool = False,
        linger: float = 30.0,
        config: AnyConfig | None = None,
        level: int = 0,
        network: Network | None = None,
        say: Callable[[str], None] = print,
    ) -> None:
        check_name(name)
        network = network or Network()
        check_name(network.team, "--team")
        if network.tls is not None:
            expect_heard(network.tls, name, network.team, "robot")
        if not 0 < period < np.inf:
            raise UsageError(f"period: expected seconds above 0, found {period}")
        if not linger >= 0:
            raise UsageError(f"linger: expected seconds, found {linger}")
        self._cfg = load(LaserMapConfig, config, {"laser": {"method": "graph"}}).laser
        self._cfg.check()
        self.name, self.team = name, LiveTeam()
        self._network, self._level, self._linger, self._say = network, level, linger, say
        self._path = Path("mapweave-live", f"{network.team}-{name}.sqlite") if history is None else Path(history)
        self._fresh, self._period = fresh, period
        self._stream = LaserStream(log_robot(name))
        self._odometry: Float[np.ndarray, 3] | None = None
        self._here: tuple[float, np.ndarray, np.ndarray, np.ndarray | None] | None = None
        self._stop, self._open = Event(), ExitStack()
        self._feed: ScanFeed | None = None
        self._failed: Exception | None = None

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            store = opening.enter_context(Store(self._path, f"robot {self.name} of team {self._network.team}"))
            if self._fresh:
                store.clear()
            run = begun(store, "laser", self._period)
            listening = lambda at: self._say(f"{self.name}: {LISTENING}{at}")  # noqa: E731
            opened = opening.enter_context(session(self._network, listening))
            topics = Topics(self._network.team)
            process = RobotProcess(self.name, opened, topics, store, self._say)
            process.join()
            self._held = hear_team(opened, topics, self.team, self.name, self._level)
            self._feed = ScanFeed(self.name, run, self._period)
            thread = Thread(target=self._drive, args=(process, self._feed), name=f"robot {self.name}", daemon=True)
            opening.callback(thread.join)
            thread.start()
            self._open = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """The last scans are told, and that the drive has ended; then who lacks something is waited for."""
        self._stop.set()
        self._open.close()
        if error is None:
            self._raise_failed()

    def add_scan(
        self,
        t: float,
        ranges: Numbers,
        angles: Numbers,
        *,
        odometry: Numbers | None = None,
        intensities: Numbers | None = None,
        range_max: float = float("inf"),
        sensor_pose: Numbers = NOWHERE,
    ) -> None:
        """One scan is told the team, and worked in beside. Waits where scans come faster than they are worked in.

        Parameters
        ----------
        t
            The stamp [s], after that of the scan before.
        ranges
            (n,) [m]; those that are NaN, infinite, 0 or reach `range_max` are no returns.
        angles
            (n,) [rad], evenly spaced, counter-clockwise from ahead of the scanner.
        odometry
            `T_odom_robot` at `t` [m, m, rad]; of every scan or of none.
        intensities
            (n,), in the scanner's units; of every scan or of none.
        range_max
            [m] what the scanner says where nothing came back.
        sensor_pose
            `T_robot_sensor`: where the scanner stands on the robot [m, m, rad].

        Raises
        ------
        DataError
            For a scan that cannot be; nothing is told of it.
        UsageError
            Outside the `with` block, or where the history has ended.
        """
        if self._feed is None or self._stop.is_set():
            raise UsageError(f"{self.name} takes scans within its with block alone")
        self._raise_failed()
        event: ScanEvent = self._stream.add(
            t,
            ranges,
            angles,
            odometry=odometry,
            intensities=intensities,
            range_max=range_max,
            sensor_pose=sensor_pose,
        )
        self._stream.forget(range(max(len(self._stream) - 2, 0), len(self._stream) - 1))  # the next is compared with it
        assert isinstance(event.record, Scan)  # noqa: S101  (of a stream of scans)
        self._feed.put(event.t, event.record)
        self._odometry = event.record.odometry
        self._raise_failed()

    @property
    def place(self) -> LivePlace | None:
        """Where the robot is now; None before its first scan is worked in.

        From the newest scan that was worked in it is carried on by the odometry of the newest that was told.
        """
        here, wheels = self._here, self._odometry
        if here is None:
            return None
        t, own, own_cov, driven = here
        if wheels is not None and driven is not None:
            own = np.asarray(se2.compose(own, se2.between(driven, wheels)))
        mine = self.team.robots().get(self.name)
        if mine is None or mine.frame is None:
            return LivePlace(t, frozen(own), own_cov, 0, None, None, None)
        pose = frozen(se2.compose(mine.frame, own))
        return LivePlace(t, frozen(own), own_cov, mine.part, pose, mine.cov, mine.frame)

    def _drive(self, process: RobotProcess, feed: ScanFeed) -> None:
        """The robot's process, in a thread of its own; what ends it is raised where scans are handed in."""
        try:
            with one_blas_thread():
                process.follow(feed, self._begin, Pace(linger=self._linger), self._stop, self._shown)
        except Exception as error:  # noqa: BLE001
            self._failed = error

    def _begin(self, header: Header) -> Driving:
        return LaserRobot(header, self._cfg)

    def _shown(self, driving: Driving) -> None:
        assert isinstance(driving, LaserRobot)  # noqa: S101  (begun above)
        if driving.t is not None and (self._here is None or self._here[0] != driving.t):
            pose, triangle, _ = driving.status()
            self._here = driving.t, frozen(pose), frozen(square(triangle)), driving.odometry

    def _raise_failed(self) -> None:
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed


@contextmanager
def live_follow(*, level: int = 0, network: Network | None = None) -> Iterator[LiveTeam]:
    """Follow a live team from a program: within the block what it gives tells how the team stands, at any time.

    Parameters
    ----------
    level
        Of the map's squares that are heard: 0 is as fine as the map is made, 1 and 2 four times coarser each (0).
    network
        How to reach the team (those on this network find each other).

    Raises
    ------
    UsageError
        For a level that there is none of, a team's name that cannot be, an endpoint that is none.
    """
    network = network or Network()
    check_name(network.team, "--team")
    if level not in range(LEVELS):
        raise UsageError(f"level: expected 0 to {LEVELS - 1}, found {level}")
    team = LiveTeam()
    with session(network) as opened:
        held = hear_team(opened, Topics(network.team), team, level=level)
        yield team
        del held
