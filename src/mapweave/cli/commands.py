"""Every command: the verb it calls, an example, and what the command line spells otherwise than Python."""

import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from ..core.errors import DataError, UsageError
from .arguments import (
    DIM,
    LASER,
    LINK,
    OF_ONE_LOG,
    RADIOS,
    ROS,
    SAME_BYTES,
    SAME_SEED,
    STARTS,
    TRUTH,
    DriveOptions,
    Words,
    motion_of,
    names_of,
    numbers_of,
)
from .from_verb import ABSENT, Command, Group, Option, make
from .terminal import say, say_table, warn

Asked = dict[str, Any]


def _check_map(given: Asked) -> None:
    """What cannot be is told before the imports, which take a second."""
    from ..api.map_options import MapOptions, expect_there

    ours = {name: value for name, value in given.items() if name in MapOptions.__slots__}
    starts = {robot: tuple(pose[:3]) for robot, pose in given["start"].items()}
    sds = {robot: pose[3] for robot, pose in given["start"].items() if len(pose) > 3}
    MapOptions(**ours | {"start": starts, "start_sd": sds}).check()
    expect_there(given["logs"])


def _own_planner(given: Asked) -> None:
    del given
    sys.path.append(str(Path.cwd()))  # where one's own planner may stand


def _evaluate(score: Callable[..., Any], asked: Asked) -> Any:
    evaluation = score(asked["directory"], asked["truth"])
    try:
        evaluation.add_to(asked["directory"], asked["truth"])
    except OSError as error:
        warn(f"{error.filename}: {error.strerror}: the report is left as it is")
    return evaluation


def _score(evaluation: Any, asked: Asked) -> None:
    if not asked["json"]:
        return say(evaluation.summary())
    from json import dumps

    from ..io.directory import plain

    return say(dumps(plain(evaluation.as_json()), indent=1, ensure_ascii=False))


def _lines(lines: list[str], asked: Asked) -> None:
    del asked
    for line in lines:
        say(line)


def _solve(solve: Callable[..., Any], asked: Asked) -> Any:
    from ..io.pyfg import is_pyfg

    if is_pyfg(asked["file"]):
        from ..api.ranges import solve_ranges

        return solve_ranges(asked["file"], asked["out"], force=asked["force"])
    return solve(**asked)


def _diagnosis(diagnosis: Any, asked: Asked) -> None:
    from json import dumps

    say(dumps(diagnosis.metrics, indent=1) if asked["json"] else diagnosis.summary())
    if not getattr(diagnosis, "healthy", True):
        raise SystemExit(1)


def _demo(given: Asked) -> None:
    del given
    say("Four simulated robots drive for five minutes among 24 landmarks, none knowing where the others began.")


def _demo_done(result: Any, asked: Asked) -> None:
    say(result.summary())
    say(f"Look at {asked['out'] / 'report.html'}")


def _simulated(recording: Any, asked: Asked) -> None:
    say(f"{asked['out']}: {recording.summary()}")


def _drive_done(recording: Any, asked: Asked) -> None:
    _simulated(recording, asked)
    say(f"truth: {asked['out'].with_suffix('.truth.tum')}")


def _swarm(simulate: Callable[..., Any], asked: Asked) -> Any:
    if asked["mutual"] and asked["single"]:
        raise UsageError("--mutual and --single exclude each other")
    seen = "mutual" if asked["mutual"] else "single" if asked["single"] else "directed"
    return simulate(asked["out"], replace(asked["scene"], visibility=seen), seed=asked["seed"])


def _swarm_done(swarm: Any, asked: Asked) -> None:
    _simulated(swarm, asked)
    places = swarm.position[0].tolist()
    anchors = [f"--anchor {swarm.table.ids[c]}=" + ",".join(f"{v:.9f}" for v in places[c]) for c in swarm.corners]
    say("robots at the corners, as anchors: " + " ".join(anchors))


def _world(of: str, end_error: tuple[float, float], does: str, example: str, *fields: str) -> Command:
    """The command of a laser world. end_error: of its odometry at the end unless told otherwise [m]."""
    drive = Option(kind=DriveOptions | None, parse=lambda given: (given or DriveOptions()).config(end_error))
    return Command(
        verb="api.simulate:simulate_laser",
        does=does,
        example=f"simulate {example}",
        options={"world": Group(of=of, only=(*fields, "drive"), options={"drive": drive}), "seed": SAME_BYTES},
        said=_drive_done,
    )


def _reproduction(result: Any, asked: Asked) -> None:
    """Tables, differences and claims, and where the page is."""
    say(f"{result.title}: {result.lead}\n")
    if result.warning:
        say(f"{result.warning}\n")
    for section in result.sections():
        if not (section.head or section.text):
            continue
        say(section.title)
        if section.text:
            say(section.text)
        if section.head:
            say_table(section.head, section.rows)
        say()
    say("What differs, and why")
    for sentence in result.differences():
        say(f"- {sentence}")
    say("\nClaim by claim")
    _, rows = result.claims_table()
    for claim, code, test, printed, here, verdict, judged, over, command in rows:
        say(
            f"- {claim}: {verdict}: printed {printed}; here {here}, over {over}; judged by: {judged} "
            f"({command}; {code}, {test})"
        )
    if asked["out"] is not None:
        say(f"\nreport: {asked['out'] / 'report.html'}")


def _paper(name: str, does: str) -> Command:
    return Command(
        verb=f"papers.{name}.reproduce:reproduce_{name}",
        does=does,
        options={"out": Option(kind=Path | None, default=ABSENT)},
        leave=("loop",),
        said=_reproduction,
    )


NEEDS = {"zenoh": "eclipse-zenoh", "msgspec": "msgspec", "cryptography": "cryptography"}


def _expect_extra(given: Asked) -> None:
    del given
    missing = [name for module, name in NEEDS.items() if find_spec(module) is None]
    if missing:
        raise UsageError(f"mapweave live needs {' and '.join(missing)}: install mapweave with the extra [live]")


def _live_robot(drive: Callable[..., Any], asked: Asked) -> list[Any]:
    """The robot, or the robots of one ROS graph, driven until they are done."""
    from ..api.live import ROS2, live_robots
    from ..api.live_ros2 import RosOptions

    ros = None if asked["ros"] == RosOptions() else asked["ros"]
    name, pattern = asked["name"], asked["ros"].pattern
    if "," not in name or asked["source"] != ROS2:
        return [drive(**asked | {"ros": ros})]
    if not (asked["robot"] is None and asked["history"] is None and asked["rate"] == 1.0 and not asked["radios"]):
        raise UsageError("--robot, --history, --rate, --radios: of a single robot")
    shared = ("fixes", "period", "fresh", "linger", "config", "network", "stop", "say")
    names, patterns = names_of("--name")(name), names_of("--pattern")(pattern)
    return live_robots(names or [], patterns, ros=ros, **{key: asked[key] for key in shared})


def _driven(robots: list[Any], asked: Asked) -> None:
    del asked
    for done in robots:
        say(f"{done.name}: {done.messages} messages, {done.heard_by} map processes have all of them")
    unused = [f"{done.name}: not used by map process {at}: {why}" for done in robots for at, why in done.unused.items()]
    if unused:
        raise DataError("; ".join(unused))


def _live_map(collect: Callable[..., Any], asked: Asked) -> Any:
    """The map process; with certificates, what Zenoh refuses before our code sees it is counted."""
    from .terminal import LOG_LEVELS, watched

    with ExitStack() as door:
        if asked["network"].tls is not None:
            network = replace(asked["network"], log_levels=LOG_LEVELS)
            asked = asked | {"network": network, "at_the_door": door.enter_context(watched())}
        return collect(**asked)


def _keys_made(folders: list[Path], asked: Asked) -> None:
    for folder in folders:
        say(f"--tls {folder}")
    say(f"{asked['out'] / 'authority-key.pem'} signs certificates: keep it off the robots")


def _nothing(result: object, asked: Asked) -> None:
    del result, asked


COMMANDS: dict[str, Command | dict[str, Command]] = {
    "demo": Command(
        verb="api.demo:demo",
        does="Simulate, map and score a small team: a first look.",
        example="demo",
        before=_demo,
        said=_demo_done,
    ),
    "map": Command(
        verb="api.map:map",
        does="Make one map of the logs of a team.",
        example="map robot1.bag robot2.mcap --out result",
        several="logs",
        leave=("scans", "odometry", "sightings"),
        options={
            "logs": Option(
                kind=Path,
                help="An MRCLAM data set (folder or zip), a folder with odometry.csv and sightings.csv, laser logs, or "
                "a recording of ranging radios and odometry.",
            ),
            "robots": Option(
                kind=str | None, parse="api.map_options:parse_robots", help="Use these robots only, as 1,2."
            ),
            "share": Option(
                kind=str | None,
                parse="api.map_options:parse_shares",
                help="Use the first share of a robot's time span only, as 1:1.0,2:0.5.",
            ),
            "start": STARTS,
            "truth": TRUTH,
            "radios": RADIOS,
            "seed": replace(SAME_SEED, help="The same seed gives the same result, to the byte."),
            "strict": Option(help="Exit with status 1 unless the verdict is good; the result is written all the same."),
            "laser": LASER,
        },
        before=_check_map,
    ),
    "view": Command(
        verb="api.view:view",
        does="Open a result's report and map.",
        example="view result",
        words=("directory",),
        options={"directory": Option(help="What a command wrote.")},
        leave=("browser",),
        said=_lines,
    ),
    "edit": Command(
        verb="api.view:edit",
        does="Decide by hand on places and robots of a laser map, in the browser.",
        example="edit result",
        words=("directory",),
        options={"out": Option(kind=Path | None, default=ABSENT)},
        said=_nothing,
    ),
    "compare": Command(
        verb="api.compare:compare",
        does="Tell what changed between two laser maps of one place.",
        example="compare monday tuesday --out changes",
        words=("before", "after"),
        options={
            "start": Option(
                kind=str | None,
                parse=numbers_of("--start", 3),
                signed=True,
                help="Where the frame of the map after lies in that of the map before, about, as x,y,theta in metres "
                "and radians: where rooms look alike it decides; by default it is searched everywhere.",
            ),
        },
    ),
    "evaluate": Command(
        verb="api.evaluate:evaluate",
        does="Score a result against the truth.",
        example="evaluate result --truth MRCLAM_Dataset6.zip",
        words=("directory",),
        options={
            "directory": Option(help="What map, fuse, locate or localize wrote."),
            "truth": Option(
                kind=list[Path],
                help="An MRCLAM data set (folder or zip), a landmark survey id,x,y, TUM trajectories, relations, or "
                "the truth of a simulated swarm; found out from the name and the first lines.",
            ),
        },
        extra={"json": Option(kind=bool, help="Print JSON with the keys documented for metrics.json.")},
        call=_evaluate,
        said=_score,
    ),
    "fuse": Command(
        verb="api.fuse:fuse",
        does="Make one map of several results.",
        example="fuse monday tuesday --out both",
        several="directories",
        options={
            "directories": Option(
                kind=Path, help="Results of map or fuse, of landmark logs or of laser logs; robots become DIR/robotK."
            ),
            "identities": Option(kind=Literal["known", "unknown"] | None),
            "truth": TRUTH,
        },
    ),
    "localize": Command(
        verb="api.localize:localize",
        does="Follow a robot in a finished laser map.",
        example="localize log.mcap --map result --out where",
        words=("log",),
        leave=("odometry",),
        options={
            "log": Option(help="A laser log, as for map."),
            "map": Option(help="A result of map from laser logs."),
            "start": Option(
                kind=str | None,
                parse=numbers_of("--start", 3),
                signed=True,
                help="The robot's first pose in the map, as x,y,theta in metres and radians; by default it is searched "
                "everywhere.",
            ),
            "truth": Option(
                kind=Path | None,
                help="A TUM trajectory in the map's frame, to say whether the start was right; no estimator sees it.",
            ),
            "laser": replace(LASER, only=OF_ONE_LOG, title=""),
        },
    ),
    "locate": Command(
        verb="api.locate:locate",
        does="Find every robot of a swarm from bearings.",
        example="locate sightings.csv --out result --anchor a=0,0 --anchor b=10,0",
        words=("sightings",),
        options={
            "sightings": Option(
                help="A table, CSV or Parquet: observer,target,bearing in radians; in space observer,target,azimuth,"
                "elevation or observer,target,bx,by,bz; optional sigma and t (stamps of moving robots give positions "
                "over time). Or an MRCLAM data set, of which the bearings between robots and the odometry are used."
            ),
            "anchors": Option(
                kind=Words,
                parse="api.locate:parse_anchors",
                name="--anchor",
                help="The known position of a robot, as a=0,0 or a=0,0,0; repeat it for more. With fewer than two only "
                "the shape is found.",
            ),
            "dim": DIM,
            "sigma": Option(
                kind=str | None,
                help="Standard deviation of a bearing with its unit, as 0.5deg or 0.0087rad; overrides the table's own "
                "column. Without either, 1 degree.",
            ),
            "distances": Option(
                kind=Words,
                parse="api.locate:parse_distances",
                default=ABSENT,
                name="--distance",
                help="A known distance as i,j=10 in metres, instead of a second anchor.",
            ),
            "motion": Option(
                kind=float | None,
                parse=motion_of,
                name="--acceleration",
                help="How fast robots without odometry change speed: density of white acceleration noise, in m^2/s^3.",
            ),
        },
    ),
    "explore": Command(
        verb="api.explore:explore",
        does="Let a simulated team decide where to drive.",
        example="explore office --robots 3 --out result",
        words=("scenario",),
        options={
            "scenario": Option(
                kind=str,
                help="yuan (the paper's field), yuan-large (four times as large), office (500 m^2, lasers), "
                "office-AREA, or a TOML file: lower, upper, landmarks, starts, walls; or sensor = "
                '"laser" with office or walls, and starts.',
            ),
            "kill": Option(
                kind=Words,
                parse="api.explore:parse_kills",
                help="A robot that dies, and the step at which it does, as robot2@100.",
            ),
            "kidnap": Option(
                kind=Words,
                parse="api.explore:parse_kidnaps",
                help="A robot that is carried away, and the step at which it is, as robot2@100.",
            ),
        },
        before=_own_planner,
    ),
    "live": {
        "robot": Command(
            verb="api.live:live_robot",
            does="Map one robot as mapweave map does, and publish it to the team. Ctrl-C ends it.",
            example="live robot --name r1 --source sim:office",
            options={
                "name": Option(help="The name of the robot in the team; with ros2 also several, as r1,r2."),
                "source": Option(kind=str),
                "radios": RADIOS,
                "ros": ROS,
                "network": LINK,
            },
            before=_expect_extra,
            call=_live_robot,
            said=_driven,
        ),
        "map": Command(
            verb="api.live:live_map",
            does="Make the shared map of a team that drives; any number of such processes may run, anywhere. "
            "Ends when all of --robots have sent their logs to the end, or with Ctrl-C; both leave a whole result, the "
            "one that mapweave map makes of the same logs.",
            example="live map --out result --listen tcp/127.0.0.1:7447",
            leave=("at_the_door",),
            options={
                "robots": Option(
                    kind=str | None,
                    parse=names_of("--robots"),
                    help="The names of the robots, as r1,r2; all others are refused.",
                ),
                "start": STARTS,
                "network": replace(LINK, only=(*LINK.only, "insecure")),
            },
            before=_expect_extra,
            call=_live_map,
        ),
        "view": Command(
            verb="api.live:live_view",
            does="Show the shared map in a browser: robots, who is there, what was decided. Ctrl-C ends it.",
            example="live view",
            options={"network": LINK},
            before=_expect_extra,
            said=_nothing,
        ),
        "explore": Command(
            verb="api.live_explore:live_explore",
            does="Send the robots of a team that drives where something is left to see. Ends when nothing is, or with "
            "Ctrl-C.",
            example="live explore --connect tcp/HOST:7447",
            options={"network": LINK},
            before=_expect_extra,
            said=_nothing,
        ),
        "demo": Command(
            verb="api.live_demo:live_demo",
            does="Let a simulated team drive, each robot in a process, mapped in another and shown in the browser.",
            example="live demo --world office",
            before=_expect_extra,
            said=_nothing,
        ),
        "keys": Command(
            verb="api.live:live_keys",
            does="Make an authority for a team and a certificate for each of its processes; robots added later get "
            "theirs too.",
            example="live keys --out keys --robots r1,r2",
            options={
                "robots": Option(
                    kind=str,
                    parse=names_of("--robots"),
                    help="Their names, as r1,r2: each may speak under its own name alone.",
                ),
                "maps": Option(kind=str, default="map,view", parse=names_of("--maps")),
            },
            before=_expect_extra,
            said=_keys_made,
        ),
    },
    "simulate": {
        "landmarks": Command(
            verb="api.simulate:simulate_landmarks",
            does="A team with cameras among landmarks, in the MRCLAM layout.",
            example="simulate landmarks --out team --robots 5",
            said=_simulated,
        ),
        "team": Command(
            verb="api.simulate:simulate_team",
            does="A mixed team: laser robots, camera robots, robots that see robots.",
            example="simulate team --out mixed --minutes 3",
            said=_simulated,
        ),
        "swarm": Command(
            verb="api.simulate:simulate_swarm",
            does="A swarm of camera robots that see each other.",
            example="simulate swarm --out swarm.csv --robots 36 --sigma 0.5deg",
            options={
                "scene": Group(
                    of="sim.swarm:SwarmScene",
                    only=(
                        *("robots", "dim", "layout", "k", "range", "sigma", "missing", "outliers", "axis", "blockers"),
                        *("steps", "interval", "drive"),
                    ),
                    options={
                        "dim": Option(kind=Literal[2, 3]),
                        "layout": Option(kind=Literal["grid", "random", "clusters"]),
                        "sigma": Option(
                            kind=str,
                            default="1deg",
                            parse="core.bearings:parse_angle",
                            help="Standard deviation of a bearing, with its unit: 0.5deg or 0.0087rad.",
                        ),
                    },
                ),
            },
            extra={
                "mutual": Option(kind=bool, help="Whoever is seen sees back."),
                "single": Option(kind=bool, help="Of two robots only one sees the other."),
            },
            call=_swarm,
            said=_swarm_done,
        ),
        "corridor": _world(
            "sim.laser_worlds:CorridorConfig",
            (15.0, 20.0),
            "A laser drive round a ring of corridor.",
            "corridor --out drive.mcap",
            *("long_leg", "short_leg", "width", "recess", "distance", "corner", "start"),
        ),
        "office": _world(
            "sim.laser_worlds:OfficeConfig",
            (2.0, 4.0),
            "A laser drive through an office floor.",
            "office --out drive.mcap --seed 3",
            *("rooms", "room_width", "room_depth", "visited", "glazed"),
        ),
        "tunnel": _world(
            "sim.laser_worlds:TunnelConfig",
            (3.0, 6.0),
            "A laser drive down a tunnel and back.",
            "tunnel --out drive.mcap",
            *("length", "width"),
        ),
    },
    "solve": Command(
        verb="api.solve:solve_pose_graph",
        does="Find the poses that agree best with a planar pose graph, or place robots and beacons by their ranges.",
        example="solve FILE.g2o --out result",
        words=("file",),
        options={
            "file": Option(
                help="A g2o file, plain or gzipped: VERTEX_SE2 (may be missing), EDGE_SE2, EDGE_PRIOR_SE2 and FIX "
                "rows. Or a .pyfg file with ranges (EDGE_RANGE), whose vertices only name what is placed."
            ),
            "robust": Option(
                help="Reject the edges that contradict the others, and say which; edges from a vertex to the next are "
                "trusted. Ranges that contradict are always rejected."
            ),
        },
        call=_solve,
    ),
    "reproduce": {
        "kojima": _paper("kojima", "Kojima, Okawa, Namerikawa: merging two maps, Table 2 and Figs. 4 to 7."),
        "hamatani": _paper("hamatani", "Hamatani, Nakamura, Naruse: five robots by bearings, Tables 1 to 3."),
        "hara": _paper(
            "hara", "Hara, Kawata, Ohya, Yuta: a 200 m loop with and without light intensity, Figs. 4 to 7."
        ),
        "yuan": _paper("yuan", "Yuan, Huang, Tao, Xi: active SLAM of two robots, Table 1, Figs. 1 and 2."),
    },
    "config": Command(
        verb="api.configuration:configuration",
        does="Print every setting of a job with default and meaning.",
        example="config map > settings.toml",
        words=("job",),
        options={"job": Option(kind=Literal["map", "fuse", "locate", "localize", "explore"])},
        said=lambda text, _: say(text.rstrip("\n")),
    ),
    "doctor": Command(
        verb="api.doctor:doctor",
        does="Tell why a map is bent: the likeliest cause, its evidence, what mends it. Alone: check the installation.",
        example="doctor result",
        words=("subject",),
        options={
            "subject": Option(
                kind=Path | None,
                default=ABSENT,
                help="The folder of a result of map or fuse, or a log, which is mapped first.",
            )
        },
        extra={"json": Option(kind=bool, help="Print JSON.")},
        said=_diagnosis,
    ),
    "self-test": Command(
        verb="api.demo:self_test",
        does="Check the installation by small jobs of every kind; exit status 1 where one comes out wrong.",
        example="self-test",
        extra={"json": Option(kind=bool, help="Print JSON.")},
        said=_diagnosis,
    ),
    "completion": Command(
        verb="cli.completion:completion",
        does="Print what completes commands in bash, zsh or fish.",
        example="completion bash > mapweave.bash",
        words=("shell",),
        said=_nothing,
    ),
}
GROUPS = {  # what the commands below one of these do
    "live": "Map a team that drives now, over a network.",
    "simulate": "Make logs of simulated robots, and their truth.",
    "reproduce": "Repeat a paper's experiment.",
}


def __getattr__(name: str) -> object:
    """The function of a command, by its words: made when Cyclopts asks for it."""
    words = name.split(" ")
    entry = COMMANDS.get(words[0])
    command = entry.get(words[-1]) if isinstance(entry, dict) else entry
    if command is None:
        raise AttributeError(name)
    return make(name, command)
