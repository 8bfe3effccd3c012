"""Several robots of one ROS graph, driven in one process."""

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import replace
from threading import Event

from ..core.errors import UsageError
from ..core.paths import AnyConfig, path_arguments
from ..live.transport import Network
from .live import live_robot
from .live_result import LiveRobot
from .live_ros2 import RosOptions

LOOK = 0.2  # [s] until it is looked again whether to stop


@path_arguments
def live_robots(
    names: Sequence[str],
    patterns: Sequence[str] | None = None,
    *,
    period: float = 1.0,
    fresh: bool = False,
    linger: float = 30.0,
    config: AnyConfig | None = None,
    ros: RosOptions | None = None,
    network: Network | None = None,
    stop: Event | None = None,
    say: Callable[[str], None] = print,
) -> list[LiveRobot]:
    """Run several robots of one ROS 2 graph in one process until `stop` is set, each as `live_robot` does.

    Where one of them can't be driven the others end too, and its error is raised.

    Parameters
    ----------
    names
        What the team calls them.
    patterns
        Of each robot's namespace (the robots of these names).
    period
        Seconds of scans in one message (1).
    fresh
        Forget earlier histories.
    linger
        How long they stay at most after `stop` for those who lack something [s] (30).
    config
        Settings, as for `map`.
    ros
        Of which ROS graph; its `pattern` is not read.
    network
        How to reach the others, as for `live_robot`; the graph's router is another process.
    stop
        Ends the run as soon as it is set.
    say
        Called with a line where something happens.
    """
    network, ros = network or Network(), ros or RosOptions()
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise UsageError(f"--name: {twice[0]} comes twice")
    if patterns is not None and len(patterns) != len(names):
        raise UsageError(f"--pattern: expected one a robot, {len(names)}, found {len(patterns)}")
    if network.listen:
        raise UsageError("--listen: of one robot; several in one process connect to a router")
    ended = Event()

    def drive(name: str, pattern: str) -> LiveRobot:
        return live_robot(
            name,
            "ros2",
            period=period,
            fresh=fresh,
            linger=linger,
            config=config,
            ros=replace(ros, pattern=pattern),
            network=network,
            stop=ended,
            say=say,
        )

    with ThreadPoolExecutor(len(names), thread_name_prefix="robot") as pool:
        driving = [pool.submit(drive, *one) for one in zip(names, patterns or names, strict=True)]
        try:
            while not (stop is not None and stop.is_set()):
                done, going = wait(driving, LOOK, FIRST_EXCEPTION)
                if not going or any(future.exception() for future in done):
                    break
        finally:
            ended.set()
    failed = [error for future in driving if (error := future.exception()) is not None]
    if failed:
        raise failed[0]
    return [future.result() for future in driving]
