"""`mapweave live`: a team that drives now."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from threading import Event, current_thread, main_thread
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from ..core.errors import UsageError
from .terminal import say

if TYPE_CHECKING:
    from ..api.live_ros2 import RosOptions
    from ..live.transport import Network

app = App(name="live", help="A team that drives now, over a real network.", help_format="plaintext", help_epilogue="")
Endpoints = Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Link:
    """How a process reaches the others of its team.

    Parameters
    ----------
    team
        The team's name; teams with different names ignore each other.
    connect
        Where others listen, as tcp/host:port; by default processes on one network find each other (--source ros2:
        tcp/localhost:7447).
    listen
        Where to listen, as tcp/host:port; messages are passed on between those that connect. Port 0 takes a
        free one and prints it.
    tls
        The folder of this process's certificate, as mapweave live keys makes them.
    lease
        Seconds without a sign of life after which another process counts as gone; longer than a round trip.
    """

    team: str = "team"
    connect: Endpoints = None
    listen: Endpoints = None
    tls: Path | None = None
    lease: float = 3.0


NEEDS = {"zenoh": "eclipse-zenoh", "msgspec": "msgspec", "cryptography": "cryptography"}


@app.command(help_epilogue="Example: mapweave live robot --name r1 --source sim:office")
def robot(
    *,
    name: str,
    source: str,
    robot: str | None = None,
    rate: float = 1.0,
    period: float = 1.0,
    history: Path | None = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    linger: float = 30.0,
    seed: int = 0,
    config: Path | None = None,
    domain: int | None = None,
    pattern: str | None = None,
    graph: str | None = None,
    sensor_pose: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None,
    all_scanners: Annotated[bool, Parameter(negative="")] = False,
    link: Link | None = None,
) -> None:
    """Map one robot as `mapweave map` does, and publish it to the team. Ctrl-C ends it.

    Parameters
    ----------
    name
        The name of the robot in the team; with ros2 also several, as r1,r2.
    source
        An MRCLAM data set (folder or zip), a folder with odometry.csv and sightings.csv, a laser log, sim:landmarks or
        sim:office; or ros2: a robot whose ROS 2 runs rmw_zenoh, until Ctrl-C.
    robot
        Which robot of the log it is, if the name does not end with its number.
    rate
        Seconds of the log played in one second; inf is as fast as possible.
    period
        Seconds of the log in one message.
    history
        The file that keeps its messages (mapweave-live/TEAM-NAME.sqlite); started again, it continues there.
    fresh
        Forget an earlier history.
    linger
        How many seconds it stays at most after the end of the log for map processes that still miss messages.
    seed
        Of a simulated world; every robot of a team takes the same.
    config
        A TOML file with settings, as for map.
    domain
        Of ros2: the graph's ROS_DOMAIN_ID (0).
    pattern
        Of ros2: the robot's namespace, which may hold * and ? (the one called --name, or the only one); of several
        robots one each, as tb1,tb2.
    graph
        Of ros2: where the graph's router is, when --connect is the team's and another; needed with --tls.
    sensor_pose
        Of ros2: where the scanner stands on the robot, as x,y,theta [m, m, rad], when tf does not have it.
    all_scanners
        Of ros2: use every scanner of the robot, not only the first.
    """
    _expect_extra()
    from ..api.live import ROS2, live_robot
    from ..api.live_robots import live_robots

    network = _network(link)
    asked = _ros(domain, pattern, graph, sensor_pose, all_scanners=all_scanners)
    several = _names(name, "--name") if "," in name and source == ROS2 else []
    if several and not (robot is None and history is None and rate == 1.0):
        raise UsageError("--robot, --history, --rate: of a single robot")
    with _until_interrupted() as stop:
        if several:
            all_done = live_robots(
                several,
                None if pattern is None else _names(pattern, "--pattern"),
                period=period,
                fresh=fresh,
                linger=linger,
                config=config,
                ros=asked,
                network=network,
                stop=stop,
                say=say,
            )
        else:
            done = live_robot(
                name,
                source,
                robot=robot,
                rate=rate,
                period=period,
                history=history,
                fresh=fresh,
                linger=linger,
                seed=seed,
                config=config,
                ros=asked,
                network=network,
                stop=stop,
                say=say,
            )
            all_done = [done]
    for done in all_done:
        say(f"{done.name}: {done.messages} messages, {done.heard_by} map processes have all of them")


@app.command(name="map", help_epilogue="Example: mapweave live map --out result --listen tcp/127.0.0.1:7447")
def map_team(
    *,
    out: Path,
    robots: str | None = None,
    start: Annotated[list[str] | None, Parameter(negative="")] = None,
    name: str = "map",
    store: Path | None = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    every: float = 2.0,
    config: Path | None = None,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
    insecure: Annotated[bool, Parameter(negative="")] = False,
    link: Link | None = None,
) -> None:
    """Make the shared map of a team that drives; any number of such processes may run, anywhere.

    Ends when all of --robots have sent their logs to the end, or with Ctrl-C; both leave a whole result, the one that
    `mapweave map` makes of the same logs.

    Parameters
    ----------
    out
        The folder the map, the trajectories, metrics.json and report.html are written to.
    robots
        The names of the robots, as r1,r2; all others are refused.
    start
        Where a robot starts in the map if that is known, as r2=x,y,theta in metres and radians, of laser robots also
        with a standard deviation in metres: r2=x,y,theta,sigma.
    name
        What this map process is called, where a team has several.
    store
        The file that keeps the messages received (OUT.sqlite); started again, the process continues from it.
    fresh
        Forget the messages of an earlier run.
    every
        Seconds between two shared maps of laser robots while they drive; a quarter of it, of landmark robots.
    config
        A TOML file with settings, as for map.
    seed
        As for map.
    force
        Write into the folder even when something other than a result stands there.
    insecure
        Hear other machines without --tls: anyone who reaches the network can write the map, which is told with it.
    """
    _expect_extra()
    from ..api.live import live_map
    from ..api.map_options import parse_starts
    from .live_door import LOG_LEVELS, watched

    names = None if robots is None else _names(robots, "--robots")
    network = replace(_network(link), insecure=insecure)
    with _until_interrupted() as stop, ExitStack() as door:
        counts = None
        if network.tls is not None:
            counts = door.enter_context(watched())
            network = replace(network, log_levels=LOG_LEVELS)
        result = live_map(
            out,
            robots=names,
            start=parse_starts(start),
            name=name,
            store=store,
            fresh=fresh,
            every=every,
            config=config,
            seed=seed,
            force=force,
            network=network,
            stop=stop,
            say=say,
            at_the_door=counts,
        )
    say(result.summary())
    say(f"report: {out / 'report.html'}")


@app.command(help_epilogue="Example: mapweave live view")
def view(
    *,
    port: int = 8642,
    host: str = "127.0.0.1",
    browser: bool = False,
    link: Link | None = None,
) -> None:
    """Show the shared map in a browser: robots, who is there, what was decided. Ctrl-C ends it.

    Parameters
    ----------
    port
        Where the page stands; 0 is any that is free.
    host
        The address it is served on; 127.0.0.1 is this machine alone.
    browser
        Open it in a browser.
    """
    _expect_extra()
    from ..api.live_view import live_view

    network = _network(link)
    with _until_interrupted() as stop:
        live_view(port=port, host=host, browser=browser, network=network, stop=stop, say=say)


@app.command(help_epilogue="Example: mapweave live demo --world office")
def demo(
    *,
    out: Path = Path("live-demo"),
    robots: int = 3,
    world: Literal["landmarks", "office"] = "landmarks",
    seconds: float = 45.0,
    port: int = 8642,
    seed: int = 0,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Let a simulated team drive, each robot in a process, mapped in another and shown in the browser.

    Parameters
    ----------
    out
        The folder of the result.
    robots
        How many drive.
    world
        landmarks: with cameras; office: with lasers.
    seconds
        How long they drive, by the clock.
    port
        Where the page stands.
    seed
        Of the simulated world.
    force
        Write into the folder even when something other than a result stands there.
    """
    _expect_extra()
    from ..api.live_demo import live_demo

    with _until_interrupted() as stop:
        live_demo(
            out, robots=robots, world=world, seconds=seconds, port=port, seed=seed, force=force, stop=stop, say=say
        )


@app.command(help_epilogue="Example: mapweave live keys --out keys --robots r1,r2")
def keys(
    *,
    out: Path,
    robots: str,
    maps: str = "map,view",
    team: str = "team",
    days: float = 365.0,
) -> None:
    """Make an authority for a team and a certificate for each of its processes; robots added later get theirs too.

    Parameters
    ----------
    out
        The folder of the authority; a folder in it for each process is what --tls takes.
    robots
        Their names, as r1,r2: each may speak under its own name alone.
    maps
        The names of map processes and views, which may also pass on what others say.
    team
        The team's name.
    days
        How long the certificates serve.
    """
    _expect_extra()
    from ..api.live_keys import live_keys

    for folder in live_keys(out, robots=_names(robots, "--robots"), maps=_names(maps, "--maps"), team=team, days=days):
        say(f"--tls {folder}")
    say(f"{out / 'authority-key.pem'} signs certificates: keep it off the robots")


def _names(words: str, option: str) -> list[str]:
    names = [word.strip() for word in words.split(",") if word.strip()]
    if not names:
        raise UsageError(f"{option}: expected names as r1,r2, found {words!r}")
    return names


def _network(link: Link | None) -> "Network":
    from ..live.transport import Network, endpoints

    link = link or Link()
    return Network(
        endpoints(link.connect, "--connect"), endpoints(link.listen, "--listen"), link.tls, link.team, link.lease
    )


def _ros(
    domain: int | None, pattern: str | None, graph: str | None, place: str | None, *, all_scanners: bool
) -> "RosOptions | None":
    """What was asked of a ROS graph; None when nothing was."""
    if all(word is None for word in (domain, pattern, graph, place)) and not all_scanners:
        return None
    from ..api.live_ros2 import RosOptions
    from ..live.transport import endpoints
    from .terminal import numbers

    where = None if graph is None else endpoints([graph], "--graph")[0]
    pose = None
    if place is not None:
        x, y, theta = numbers(place, 3, "--sensor-pose")
        pose = (x, y, theta)
    return RosOptions(domain or 0, pattern, where, pose, all_scanners)


def _expect_extra() -> None:
    missing = [name for module, name in NEEDS.items() if find_spec(module) is None]
    if missing:
        raise UsageError(f"mapweave live needs {' and '.join(missing)}: pip install 'mapweave[live]'")


@contextmanager
def _until_interrupted() -> Iterator[Event]:
    """An event that the first Ctrl-C (or SIGTERM) sets; a second one interrupts as everywhere."""
    stop = Event()
    if current_thread() is not main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, frame: object) -> None:  # noqa: ARG001
        stop.set()
        for n, handler in before.items():
            signal.signal(n, handler)

    for number in before:
        signal.signal(number, ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
