"""A ROS 2 robot whose graph is on Zenoh, driven as `live_robot` drives a log."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from threading import Event

from ..core.config import load
from ..core.errors import UsageError
from ..core.paths import AnyConfig
from ..live.driven import LaserRobot
from ..live.messages import Header, RefusedError, Topics
from ..live.robot import Driving, Listeners, Pace, RobotProcess
from ..live.ros2.feed import Chosen, RosFeed
from ..live.ros2.shown import RosView
from ..live.store import Store
from ..live.told import LiveTeam, hear_team
from ..live.transport import LISTENING, Network, Session, session
from .map_laser import LaserMapConfig

ROUTER = "tcp/localhost:7447"  # where rmw_zenoh's router stands unless told otherwise
AGAIN = 2000  # [ms] between two tries to reach it
LARGEST_DOMAIN = 232  # a domain of ROS 2 is 0 to 232

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class RosOptions:
    """Which robot of which ROS 2 graph is driven. domain: ROS_DOMAIN_ID; pattern: of the robot's namespace, as `tb*`.

    graph: where the graph's router is, when it is another than the team's `connect`; sensor_pose: where the scanner
    stands on the robot [m, m, rad], when tf does not tell; all_scanners: the scans of all that the robot has.
    team_map: the graph gets the team's map too, and where its other robots are; goals: where a planner of the team
    sends the robot, as `goal_pose`, to which Nav2 drives.
    """

    domain: int = 0
    pattern: str | None = None
    graph: str | None = None
    sensor_pose: tuple[float, float, float] | None = None
    all_scanners: bool = False
    team_map: bool = False
    goals: bool = False

    def check(self, network: Network) -> None:
        """Raises UsageError for what cannot be."""
        if not 0 <= self.domain <= LARGEST_DOMAIN:
            raise UsageError(f"--domain: expected 0 to {LARGEST_DOMAIN}, found {self.domain}")
        if self.sensor_pose is not None and not all(math.isfinite(x) for x in self.sensor_pose):
            raise UsageError(f"--sensor-pose: expected finite numbers, found {self.sensor_pose}")
        if network.tls is not None and self.graph is None:
            raise UsageError("--tls: ROS speaks under names no certificate has: --graph says where it is reached")


def drive_ros2(
    name: str,
    options: RosOptions,
    fixes: str | None,
    store: Store,
    run: str,
    period: float,
    linger: float,
    config: AnyConfig | None,
    network: Network,
    stop: Event,
    say: Say,
    wall: Callable[[], float] = time.time,
) -> tuple[int, Listeners]:
    """Drives `name` by what its ROS graph tells, until `stop`; how many messages there are, and who hears them.

    options: checked against the network; fixes: topics that tell where it is, as of `map`.
    """
    cfg = load(LaserMapConfig, config, {"laser": {"method": "graph"}}).laser
    cfg.check()
    topics = Topics(network.team)
    with ExitStack() as open_ones:
        mine = _graph_network(options, network)
        graph = open_ones.enter_context(_reached(mine, stop, lambda words: say(f"{name}: {words}")))
        if graph is None:
            return 0, Listeners()
        team = graph if options.graph is None else open_ones.enter_context(session(network))
        process = RobotProcess(name, team, topics, store, say, wall)
        process.join()
        o = options
        asked = Chosen(name, run, period, o.domain, o.pattern, o.sensor_pose, o.all_scanners, fixes)
        feed = RosFeed(graph, asked, say)
        told = LiveTeam()
        held = hear_team(team, topics, told, name) if o.team_map or o.goals else []
        shared = {"shared": o.team_map, "goals": o.goals}
        view = RosView(graph, feed, process.listeners, network.team, say, told, **shared)
        say(
            f"{name}: domain {options.domain} at {', '.join(mine.connect or mine.listen)}, team {network.team}, "
            f"history in {store.path}"
        )

        def begin(header: Header) -> Driving:
            return LaserRobot(header, cfg)

        def shown(driving: Driving) -> None:
            assert isinstance(driving, LaserRobot)  # noqa: S101  (begun above)
            view.show(driving)

        try:
            sent = process.follow(feed, begin, Pace(linger=linger), stop, shown)
        except RefusedError as error:
            raise UsageError(str(error).partition(": ")[2]) from None
        finally:
            held.clear()
        if refused := feed.summary():
            say(f"{name}: refused {refused}")
        return sent, process.listeners


def _graph_network(options: RosOptions, network: Network) -> Network:
    """The session with the graph: a client of its router, or the router itself where nothing else listens."""
    extra = network.extra | {"timestamping/enabled": True}
    if options.graph is not None:
        joined = Network((options.graph,), (), None, network.team, network.lease, extra=extra)
    elif network.listen:
        return replace(network, extra=extra | {"scouting/gossip/enabled": True})
    else:
        joined = replace(network, connect=network.connect or (ROUTER,), extra=extra)
    waiting = {"mode": "client", "connect/timeout_ms": AGAIN, "connect/exit_on_failure": True}
    return replace(joined, extra=joined.extra | waiting)


@contextmanager
def _reached(network: Network, stop: Event, say: Say) -> Iterator[Session | None]:
    """The session, as soon as there is a router; None when `stop` is set before."""
    announced = False
    while not stop.is_set():
        with ExitStack() as opening:
            try:
                opened = opening.enter_context(session(network, lambda at: say(f"{LISTENING}{at}")))
            except UsageError as error:
                if network.listen:
                    raise
                if not announced:
                    announced = True
                    say(f"waits for {', '.join(network.connect)}: {error}")
                stop.wait(AGAIN / 1000)
                continue
            yield opened
            return
    yield None
