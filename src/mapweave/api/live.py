"""A team that drives now: robots, the map and its page until they are done or told to stop; its certificates."""

import datetime as dt
import math
import time
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

from ..core.config import load
from ..core.errors import ConfigError, DataError, UsageError
from ..core.findings import Finding, verdict
from ..core.landmark_log import LandmarkLog
from ..core.laser_log import LaserLog
from ..core.names import in_order, robot_key
from ..core.paths import AnyConfig, checked_arguments
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.directory import check_target, write_json
from ..live.credentials import expect_heard, make_team
from ..live.driven import LaserRobot
from ..live.inbox import Inbox
from ..live.isolation import without_culprits
from ..live.landmark_stream import LandmarkRobot
from ..live.map_process import MapProcess
from ..live.messages import Header, Topics, check_name
from ..live.range_stream import RangeRobot, of_team
from ..live.robot import Driving, Listeners, Pace, RobotProcess
from ..live.sources import BagFeed, LiveLog, messages, open_recording, open_source
from ..live.store import Store, begun
from ..live.told import follow
from ..live.transport import LISTENING, Network, is_open, session, told_on
from ..live.view import Board, served
from ..mapping.config import LaserConfig
from ..ranges.network import RangeLog
from ..report.result import ResultBase
from ..report.small_pages import draw_messages, write_small_page
from ..report.style import Target
from .laser_result import LaserResult, starts_among
from .live_ros2 import RosOptions, drive_ros2
from .map_landmarks import LandmarkMapConfig, map_landmark_logs
from .map_laser import LaserMapConfig
from .map_laser import map_logs as map_lasers
from .map_mixed import MixedMapConfig, MixedResult, join_apart, map_mixed_logs
from .map_options import MapOptions
from .ranges import RangeResult, map_range_log
from .team import TeamResult


@dataclass(frozen=True, slots=True, repr=False)
class LiveRobot(ResultBase):
    """How a robot's live run ended. messages: sent, all on its disk; heard_by: map processes that have all.

    history: the file that keeps them; sizes: of each message [bytes]; unused: map process -> why it uses nothing, or
    nothing more, of them.
    """

    name: str
    messages: int
    heard_by: int
    history: Path
    sizes: tuple[int, ...]
    unused: Mapping[str, str] = field(default_factory=dict)

    @property
    def metrics(self) -> dict[str, Any]:
        return {
            "version": __version__,
            "name": self.name,
            "messages": self.messages,
            "bytes": sum(self.sizes),
            "heard_by": self.heard_by,
            "unused": dict(self.unused),
            "history": str(self.history),
        }

    def lines(self) -> list[str]:
        heard = f"{self.heard_by} map process{' has' if self.heard_by == 1 else 'es have'} all of them"
        sent = f"{self.name}: {self.messages} messages, {sum(self.sizes) / 1e3:.1f} kB, kept in {self.history}"
        unused = [f"not used by map process {name}: {why}" for name, why in self.unused.items()]
        return [sent, heard if self.heard_by else "no map process has all of them yet", *unused]

    def draw(self, target: Target) -> None:
        """How much it told, message by message."""
        draw_messages(target, self.sizes, self.heard_by)

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html and its picture; the messages themselves stay in the history."""
        png = folder / "figures" / "messages.png"
        self.draw(png)
        write_small_page(folder, "What a robot told its team", self.lines(), self.headline(), png)
        write_json(folder / "metrics.json", self.metrics)


ROS2 = "ros2"
LiveResult = TeamResult | LaserResult | MixedResult | RangeResult
INSECURE = Finding("network-open").text

Say = Callable[[str], None]


@checked_arguments
@one_blas_thread()
def live_robot(
    name: str,
    source: Path | str,
    *,
    robot: str | None = None,
    radios: Mapping[str, str] | None = None,
    fixes: str | None = None,
    follow: bool = False,
    rate: float = 1.0,
    period: float = 1.0,
    history: Path | str | None = None,
    fresh: bool = False,
    linger: float = 30.0,
    seed: int = 0,
    config: AnyConfig | None = None,
    ros: RosOptions | None = None,
    network: Network | None = None,
    stop: Event | None = None,
    say: Say = print,
    wall: Callable[[], float] = time.time,
) -> LiveRobot:
    """Run one robot of a live team: drive through a log, estimate as `map` does, publish to the team.

    It needs nobody: what it tells is in `history` first, and whoever comes later asks for it there. Started again, it
    goes on after the last message of its history.

    Parameters
    ----------
    name
        What the team calls it.
    source
        An MRCLAM data set, a folder with odometry.csv and sightings.csv, a laser log, a recording of ranging radios,
        sim:landmarks or sim:office; or
        ros2: a robot that drives now, whose ROS 2 runs rmw_zenoh or has zenoh-bridge-ros2dds beside it, until `stop`.
    robot
        Which robot of the log it is, by key (the one whose number `name` ends with, or the only one).
    radios
        Radio -> the robot it is on, where their names do not say it (by name, else by number). Recordings of ranges
        alone, the same for all robots of one.
    fixes
        Topics of a recording or of ros2 that tell where robots are, as for `map`: satellite fixes, or poses by others,
        which then are input and no truth (satellite fixes alone); none: no fixes.
    follow
        The source is a recording that is still written (.mcap, .db3, .bag or a folder), or is not there yet: its scans
        or ranges, and its fixes, are told as they come, until it is closed or `stop`.
    rate
        Seconds of the log in one second of the clock (1); inf is as fast as it goes.
    period
        Seconds of the log in one message (1).
    history
        The file that keeps what it told (`mapweave-live/TEAM-NAME.sqlite`).
    fresh
        Forget an earlier history.
    linger
        How long it stays at most after the log's end for those who lack something [s] (30).
    seed
        Of a simulated world (0).
    config
        Settings, as for `map`.
    ros
        Which robot of which ROS graph, where the source is ros2 (the one of that name, or the only one, of domain 0).
    network
        How to reach the others (those on this network find each other); a ROS graph's router among them, which stands
        at tcp/localhost:7447 unless `connect` names another.
    wall
        The robot's clock [s].
    """
    check_name(name)
    _check_pace(rate, period, linger)
    network = network or Network()
    check_name(network.team, "--team")
    options = ros or RosOptions()
    if str(source) == ROS2:
        if robot is not None or rate != 1.0 or follow:
            raise UsageError(f"--source {ROS2}: a robot that drives now has neither --robot nor --rate nor --follow")
        options.check(network)
    if network.tls is not None:
        expect_heard(network.tls, name, network.team, "robot")
    path = Path("mapweave-live", f"{network.team}-{name}.sqlite") if history is None else Path(history)
    stop, ros2 = stop or Event(), str(source) == ROS2
    _check_origin(ros2=ros2, follow=follow, paced=rate != 1.0, graph=ros is not None, radios=bool(radios))
    log = None if ros2 or follow else open_source(str(source), name, robot, seed, radios=radios, fixes=fixes)
    with Store(path, f"robot {name} of team {network.team}") as store, ExitStack() as opened:
        if fresh:
            store.clear()
        run = begun(store, (store.about("sensor") if follow else None) or _sensor(log), period)
        if ros2:
            sent, ears = drive_ros2(name, options, fixes, store, run, period, linger, config, network, stop, say, wall)
            return _ended(name, sent, ears, store)
        if log is not None:
            header = next(messages(log, name, run, period))[1]
            assert isinstance(header, Header)  # noqa: S101  (the first of every log)
            driving = _driving(header, config)
        team = opened.enter_context(session(network, lambda at: say(f"{name}: {LISTENING}{at}")))
        process = RobotProcess(name, team, Topics(network.team), store, say, wall)
        process.join()
        told = f"follows {source}" if log is None else f"{_robot_of(log)} of {source}"
        say(f"{name}: {told}, team {network.team}, history in {path}")
        if log is None:
            opener = partial(open_recording, name=name, robot=robot, fixes=fixes, radios=radios)
            feed = BagFeed(Path(source), opener, name, run, period, stop, say)

            def begin(header: Header) -> Driving:
                store.set_about("sensor", header.sensor)
                return _driving(header, config)

            sent = process.follow(feed, begin, Pace(linger=linger), feed.ended, lambda _: None)
        else:
            expected = bool(network.connect or network.listen)
            sent = process.run(messages(log, name, run, period), driving, Pace(rate, linger, expected), stop)
        return _ended(name, sent, process.listeners, store)


def _ended(name: str, sent: int, listeners: Listeners, store: Store) -> LiveRobot:
    heard_by = sum(have >= sent for have in listeners.have.values())
    return LiveRobot(name, sent, heard_by, store.path, store.sizes(name), dict(listeners.unused))


def _check_origin(*, ros2: bool, follow: bool, paced: bool, graph: bool, radios: bool) -> None:
    """Raises UsageError for options that a source of this kind has not."""
    if follow and (graph or paced):
        raise UsageError("--follow: a recording that is still written has neither --rate nor options of ROS graphs")
    if graph and not ros2:
        words = "--domain, --pattern, --graph, --sensor-pose, --all-scanners, --team-map, --goals"
        raise UsageError(f"{words}: of --source {ROS2} alone")
    if radios and ros2:
        raise UsageError(f"--radios: only for recordings of ranges, found --source {ROS2}")


def _check_pace(rate: float, period: float, linger: float) -> None:
    if not rate > 0:
        raise UsageError(f"--rate: expected a number above 0, found {rate}")
    if not (0 < period < math.inf):
        raise UsageError(f"--period: expected seconds above 0, found {period}")
    if not linger >= 0:
        raise UsageError(f"--linger: expected seconds, found {linger}")


def _robot_of(log: LiveLog) -> str:
    return next(iter(log.odometry)) if isinstance(log, RangeLog) else log.robot


def _sensor(log: LiveLog | None) -> str:
    if isinstance(log, RangeLog):
        return "ranges"
    return "landmarks" if isinstance(log, LandmarkLog) else "laser"


def _driving(header: Header, settings: AnyConfig | None) -> LandmarkRobot | LaserRobot | RangeRobot:
    """The estimator that `map` would run; of a robot that ranges, its odometry."""
    if header.sensor == "ranges":
        return RangeRobot(header)
    if header.sensor == "landmarks":
        return LandmarkRobot(header, load(LandmarkMapConfig, settings).ekf)
    cfg = load(LaserMapConfig, settings, {"laser": {"method": "graph"}}).laser
    cfg.check()
    return LaserRobot(header, cfg)


@checked_arguments
@one_blas_thread()
def live_map(
    out: Path | str,
    *,
    robots: Sequence[str] | None = None,
    start: Mapping[str, Sequence[float]] | None = None,
    name: str = "map",
    store: Path | str | None = None,
    fresh: bool = False,
    every: float = 2.0,
    config: AnyConfig | None = None,
    seed: int = 0,
    force: bool = False,
    network: Network | None = None,
    stop: Event | None = None,
    say: Say = print,
    wall: Callable[[], float] = time.time,
    at_the_door: Mapping[str, int] | None = None,
) -> LiveResult:
    """Run the map process of a live team: collect what robots publish and keep one shared map, written to `out`.

    It ends when `stop` is set, or when all of `robots` have published their logs to the end.

    The map is the one that `map` makes of the same logs, to the byte: what arrives is put in order of robot and number
    before it is used, each message once, and what is missing is asked for. A process that was killed goes on from
    `store`.

    Parameters
    ----------
    out
        The folder of the result; an earlier one there is replaced whole.
    robots
        The names that are heard, all others are refused (all, until `stop`).
    start
        Where robots start in the map if that is known: name -> x, y, theta[, sigma], as for `map`.
    name
        What this map process is called, where a team has several (map).
    store
        The file that keeps what was heard (`OUT.sqlite` beside the folder).
    fresh
        Forget what an earlier run has heard.
    every
        Seconds between two shared maps of laser robots while they drive; a quarter of it, of landmark robots (2).
    config
        Settings, as for `map`.
    seed
        As for `map` (0).
    network
        How to reach the others (those on this network find each other).
    stop
        Ends the hearing as soon as it is set.
    wall
        This process's clock [s].
    at_the_door
        Counts of what the transport refused, to be told beside ours (none).
    """
    out = Path(out)
    network = network or Network()
    check_name(network.team, "--team")
    check_name(name)
    for robot in robots or ():
        check_name(robot, "--robots")
    if robots is not None and (missing := [robot for robot in start or () if robot not in robots]):
        raise UsageError(f"--start: {missing[0]} is not one of --robots {','.join(robots)}")
    if not (0 < every < math.inf):
        raise UsageError(f"--every: expected seconds above 0, found {every}")
    check_target(out, force=force)
    if is_open(network) and not network.insecure:
        raise UsageError(
            "anyone who reaches this network could write the map: --tls FOLDER (mapweave live keys makes it), "
            "--listen tcp/127.0.0.1:7447 for this machine alone, or --insecure"
        )
    if network.tls is not None:
        expect_heard(network.tls, name, network.team, "map")
    options = MapOptions(config=config, seed=seed)
    known = start or {}
    landmarks, weaving = _landmark_config(options.config), _laser_config(options.config)
    path = out.with_name(f"{out.name}.sqlite") if store is None else Path(store)
    with Store(path, f"a map of team {network.team}") as kept:
        if fresh:
            kept.clear()
        inbox = Inbox(kept, robots)
        with session(told_on(network), lambda at: say(f"{name}: {LISTENING}{at}")) as opened:
            process = MapProcess(name, opened, Topics(network.team), kept, inbox, say, wall, at_the_door)
            process.shared.cfg, process.ekf = landmarks.fuse, landmarks.ekf
            process.laser = weaving
            process.joins = partial(join_apart, cfg=_mixed_config(options.config), seed=seed)
            process.starts = lambda names: starts_among(
                names, {k: v for k, v in known.items() if k in names}, weaving.merge
            )
            process.join()
            say(f"{name}: team {network.team}, heard so far kept in {path}")
            if is_open(network):
                process.finding(INSECURE)
            if kept.damage:
                process.finding(f"{kept.damage}; what is missing is asked for again")
            process.run(stop or Event(), every, lambda inbox: _all_told(inbox, robots))
            process.tell_state()
        for line in process.summary():
            say(line)
        result = _final(inbox, _with_starts(options, known, inbox, say), process.finding)
    result = _with_findings(result, (*process.findings, *inbox.not_used(), *inbox.wheelless()))
    result.write(out, force=force)
    return result


def _landmark_config(settings: AnyConfig | None) -> LandmarkMapConfig:
    """How landmark robots are mapped and fused; the settings may also be of lasers or of a mixed team.

    Raises ConfigError when they are of none.
    """
    try:
        return load(LandmarkMapConfig, settings)
    except ConfigError:
        mixed = load(MixedMapConfig, settings)
        mixed.laser.check()
        return LandmarkMapConfig(ekf=mixed.ekf, fuse=mixed.fuse)


def _mixed_config(settings: AnyConfig | None) -> MixedMapConfig:
    """How parts of a mixed team are laid beside each other; the settings may also be of one kind of robots."""
    try:
        return load(MixedMapConfig, settings)
    except ConfigError:
        return MixedMapConfig()


def _with_starts(options: MapOptions, known: Mapping[str, Sequence[float]], inbox: Inbox, say: Say) -> MapOptions:
    """The options with where robots start, by the names of their logs; one that was never heard of is told."""
    called = {name: x.record.header.log_robot for name, x in inbox.ledgers.items() if x.record is not None}
    for name in known:
        if name not in called:
            say(f"--start: {name} was never heard of; there are {', '.join(called) or 'none'}")
    poses = {robot_key(called[name]): tuple(numbers) for name, numbers in known.items() if name in called}
    return replace(
        options,
        start={key: (x, y, theta) for key, (x, y, theta, *_) in poses.items()},
        start_sd={key: numbers[3] for key, numbers in poses.items() if len(numbers) > 3},
    )


def _laser_config(settings: AnyConfig | None) -> LaserConfig:
    """How laser robots are followed and woven; the settings may also be those of landmark robots or a mixed team."""
    try:
        return load(LaserMapConfig, settings).laser
    except ConfigError:
        with suppress(ConfigError):
            return load(MixedMapConfig, settings).laser
        return LaserConfig()


def _all_told(inbox: Inbox, robots: Sequence[str] | None) -> bool:
    ledgers = inbox.ledgers
    return robots is not None and all(name in ledgers and ledgers[name].complete for name in robots)


def _with_findings(result: LiveResult, texts: Sequence[str]) -> LiveResult:
    """The result, which tells what went wrong while it was heard."""
    found = [Finding("network-open") if text == INSECURE else Finding("network-told", value=text) for text in texts]
    if not found:
        return result
    every = (*result.findings, *found)
    if isinstance(result, TeamResult | RangeResult):
        return replace(result, findings=every)
    rows = [*result.metrics["findings"], *(one.row() for one in found)]
    metrics = {**result.metrics, "verdict": verdict(every), "findings": rows}
    if isinstance(result, LaserResult):
        return replace(result, whole=(*result.whole, *found), metrics=metrics)
    return replace(result, story=replace(result.story, findings=every), metrics=metrics)


def _final(inbox: Inbox, options: MapOptions, finding: Say) -> LiveResult:
    """The map of all that was heard up to each robot's first gap or doubt, without robots that it fails for."""
    for name, x in sorted(inbox.ledgers.items()):
        if not x.complete and (x.missing > 0 or x.held):
            lost = max(x.missing, 0)
            finding(f"{name}: of {x.last + 1} messages {lost} are missing: what it told is used up to the first gap")
    called = {x.record.header.log_robot: name for name, x in inbox.ledgers.items() if x.record is not None}
    heard = [log for log in map(inbox.log, inbox.ledgers) if log is not None]
    radios = {_robot_of(log): log for log in heard if isinstance(log, RangeLog)}
    logs = {log.robot: log for log in heard if not isinstance(log, RangeLog)}
    if not logs and radios:
        return map_range_log(of_team(list(radios.values())))
    for name in sorted(radios, key=in_order):
        finding(f"{called.get(name, name)}: left out of the map: it ranges, and others see: these are mapped apart")
    names = sorted(logs, key=in_order)
    result, _, failed = without_culprits(names, lambda some: _mapped([logs[name] for name in some], options))
    if result is None:
        return _mapped([logs[name] for name in names], options)  # its error is the answer
    for name, why in failed.items():
        finding(f"{called.get(name, name)}: left out of the map: {why}")
    return result


def _mapped(logs: Sequence[LandmarkLog | LaserLog], options: MapOptions) -> LiveResult:
    """The map of these logs."""
    lasers = [log for log in logs if isinstance(log, LaserLog) and len(log.scans)]
    landmarks = [log for log in logs if isinstance(log, LandmarkLog) and len(log)]
    if lasers and landmarks:
        return map_mixed_logs(landmarks, lasers, options)
    if lasers:
        return map_lasers(lasers, options)
    if not any(len(log.sightings) for log in landmarks):
        raise DataError("no robot told what it saw: no map")
    sources = dict.fromkeys(Path(log.source).name for log in landmarks)
    return map_landmark_logs(landmarks, options, f"One map from {', '.join(sources)}")


LOOK = 0.2  # [s] until it is looked again whether to stop


@checked_arguments
def live_robots(
    names: Sequence[str],
    patterns: Sequence[str] | None = None,
    *,
    fixes: str | None = None,
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
    fixes
        Topics that tell where they are, one in the namespace of each, as for `map` (satellite fixes alone).
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
            fixes=fixes,
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


LOOKED = 1.0  # [s] from one look at what had no room to the next


@checked_arguments
def live_view(
    *,
    port: int = 8642,
    host: str = "127.0.0.1",
    browser: bool = False,
    network: Network | None = None,
    stop: Event | None = None,
    say: Say = print,
) -> None:
    """Serve the page of a team's shared map until `stop` is set: map, robots, who is there, decisions.

    Parameters
    ----------
    port
        Where the page stands (8642); 0 is any that is free.
    host
        The address it is served on (this machine alone).
    browser
        Open it in a browser.
    network
        How to reach the team (those on this network find each other).
    stop
        Ends it as soon as it is set.
    say
        Called with a line that names the address.
    """
    network = network or Network()
    check_name(network.team, "--team")
    board = Board()
    with served(board, host, port) as address, session(network, lambda at: say(f"{LISTENING}{at}")) as opened:
        held = follow(opened, Topics(network.team), board)
        say(f"team {network.team}: {address}")
        if browser:
            webbrowser.open(address)
        stop, told = stop or Event(), False
        while not stop.wait(LOOKED):
            if board.let_go and not told:
                told = True
                say("more maps, robots or squares are told than there is room for: the oldest are not shown")
        del held


LONGEST = 3650.0  # [days] what the authority itself serves


@checked_arguments
def live_keys(
    out: Path | str,
    *,
    robots: Sequence[str],
    maps: Sequence[str] = ("map", "view"),
    team: str = "team",
    days: float = 365.0,
) -> list[Path]:
    """Make a certificate authority for a live team, and a certificate for each of its processes; returns their folders.

    The authority stands in `out`, beside a folder a process with its certificate and the list of who may speak.
    Called again, it keeps what is there and adds to it: copy every folder to its process anew then, since everybody's
    list of names has grown.

    Parameters
    ----------
    out
        The folder of the authority.
    robots
        Names that may speak under themselves alone.
    maps
        Names of map processes and views, which may pass on what others say.
    team
        The team's name (team).
    days
        How long the certificates serve (365).
    """
    check_name(team, "--team")
    if not (math.isfinite(days) and 0 < days <= LONGEST):
        raise UsageError(f"--days: expected above 0 and at most {LONGEST:g}, found {days}")
    return make_team(Path(out), team, list(robots), list(maps), days, dt.datetime.now(dt.UTC))
