"""What is typed, and the arguments that become of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from ..core.errors import UsageError
from .from_verb import ABSENT, Group, Option
from .terminal import numbers

if TYPE_CHECKING:
    from ..sim.laser import DriveConfig
    from ..swarm.moving.result import TrackConfig

Words = list[str] | None


def numbers_of(option: str, count: int) -> Callable[[str | None], Any]:
    return lambda text: None if text is None else numbers(text, count, option)


def names_of(option: str) -> Callable[[str | None], list[str] | None]:
    def parse(words: str | None) -> list[str] | None:
        names = None if words is None else [word.strip() for word in words.split(",") if word.strip()]
        if names == []:
            raise UsageError(f"{option}: expected names as r1,r2, found {words!r}")
        return names

    return parse


def _beams(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    first, step = numbers(text, 2, "--beams")
    return radians(first), radians(step)


def _height(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    low, high = numbers(text, 2, "--height")
    return low, high


def motion_of(acceleration: float | None) -> "TrackConfig | None":
    from ..swarm.moving.result import TrackConfig

    return None if acceleration is None else TrackConfig(acceleration=acceleration)


def _not(asked: object) -> bool:
    return not asked


def paths_of(paths: list[Path] | None) -> tuple[Path, ...]:
    return tuple(paths or ())


POSE = Option(kind=str | None, parse=numbers_of("--sensor-pose", 3), signed=True)
DIM = Option(kind=Literal[2, 3] | None)
SAME_SEED = Option(help="The same seed gives the same result.")
SAME_BYTES = Option(help="The same seed gives the same bytes.")
TRUTH = Option(kind=list[Path] | None, parse=paths_of, help="Score the result against this; no estimator ever sees it.")
RADIOS = Option(
    kind=str | None,
    parse="api.map_options:parse_radios",
    help="Which robot each radio is on, as n_7=turtle01,n_3=turtle03, where names do not say it (recordings of "
    "ranges).",
)
STARTS = Option(
    kind=Words,
    parse="api.map_options:parse_starts",
    help="Where a robot starts in the map if that is known, as robot2=x,y,theta in metres and radians; of laser logs "
    "and mixed teams also robot2=x,y,theta,sigma with its standard deviation in metres.",
)
LASER = Group(
    of="api.map_options:LaserOptions",
    title="Laser logs",
    options={
        "feature": Option(kind=Literal["normalised", "raw", "none"] | None),
        "likelihood": Option(kind=Literal["matched", "paper"] | None),
        "sensor_pose": replace(POSE, help="The pose of the scanner on the robot, as x,y,theta, if the log lacks it."),
        "no_loops": Option(
            default=True,
            parse=_not,
            name="--loops",
            help="Close loops (--method graph); --no-loops leaves them open.",
        ),
        "no_merge": Option(
            default=True,
            parse=_not,
            name="--merge",
            help="Make one map of all robots that can be merged (--method graph); --no-merge keeps one map per robot.",
        ),
        "height": Option(
            kind=str | None,
            parse=_height,
            signed=True,
            help="What of point clouds is a scan: from LOW to HIGH, as LOW,HIGH in metres above the floor (0.2 above "
            "the floor to 0.5 above the scanner).",
        ),
        "beams": Option(
            kind=str | None,
            parse=_beams,
            signed=True,
            help="The angle of the first beam and from beam to beam, as FIRST,STEP in degrees counter-clockwise from "
            "ahead.",
        ),
    },
)
OF_ONE_LOG = (
    *("particles", "feature", "scan_topic", "odom_topic", "sensor_pose", "mirrored", "height"),
    *("columns", "beams"),
)


def _endpoints(option: str) -> Callable[[Words], tuple[str, ...]]:
    def parse(words: Words) -> tuple[str, ...]:
        from ..live.transport import endpoints

        return endpoints(words, option)

    return parse


def _graph(word: str | None) -> str | None:
    return None if word is None else _endpoints("--graph")([word])[0]


LINK = Group(
    of="live.transport:Network",
    only=("team", "connect", "listen", "tls", "lease"),
    options={
        "team": Option(help="The team's name; teams with different names ignore each other."),
        "connect": Option(
            kind=Words,
            parse=_endpoints("--connect"),
            default=ABSENT,
            help="Where others listen, as tcp/host:port; by default processes on one network find each other (--source "
            "ros2: tcp/localhost:7447).",
        ),
        "listen": Option(
            kind=Words,
            parse=_endpoints("--listen"),
            default=ABSENT,
            help="Where to listen, as tcp/host:port; messages are passed on between those that connect. Port 0 takes a "
            "free one and prints it.",
        ),
        "tls": Option(help="The folder of this process's certificate, as mapweave live keys makes them."),
        "lease": Option(
            help="Seconds without a sign of life after which another process counts as gone; longer than a round trip."
        ),
        "insecure": Option(
            help="Hear other machines without --tls: anyone who reaches the network can write the map, which is told."
        ),
    },
)
ROS = Group(
    of="api.live_ros2:RosOptions",
    options={
        "domain": Option(help="Of ros2: the graph's ROS_DOMAIN_ID."),
        "pattern": Option(
            help="Of ros2: the robot's namespace, which may hold * and ? (the one called --name, or the only one); of "
            "several robots one each, as tb1,tb2.",
        ),
        "graph": Option(
            parse=_graph,
            help="Of ros2: where the graph's router is, when --connect is the team's and another; needed with --tls.",
        ),
        "sensor_pose": replace(
            POSE,
            help="Of ros2: where the scanner stands on the robot, as x,y,theta [m, m, rad], when tf does not have it.",
        ),
        "all_scanners": Option(help="Of ros2: use every scanner of the robot, not only the first."),
        "team_map": Option(help="Of ros2: publish the team's map and its other robots' poses in the robot's graph."),
        "goals": Option(help="Of ros2: publish where live explore sends the robot as goal_pose: Nav2 drives there."),
    },
)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """How a world is driven and seen.

    Parameters
    ----------
    scan_every
        Metres between scans.
    speed
        Metres a second.
    people
        How many people walk about.
    sweep
        Seconds that a scan takes from its first beam to its last, while the robot drives on; 0 for one moment.
    beams
        Beams of the scanner, over 240 degrees.
    range_
        Metres the scanner reaches.
    sensor_pose
        Where the scanner stands on the robot, as x,y,theta in metres and radians.
    law
        How light falls off: spec (as the scanner's maker measured), second (another one, with a specular part),
        lds01 or neato (as in logs of these scanners).
    falloff
        Metres at which the light has halved, instead of the law's.
    exponent
        How light falls with the cosine of incidence, instead of the law's.
    specular
        Share of light that comes back from surfaces hit squarely, instead of the law's.
    end_error
        Metres the odometry is off at the end, as a pair low,high; 0,0 for no heading bias.
    """

    scan_every: float = 0.25
    speed: float = 0.5
    people: int = 0
    sweep: float = 0.0
    beams: int = 342
    range_: Annotated[float, Parameter(name="--range")] = 5.6
    sensor_pose: Annotated[str, Parameter(allow_leading_hyphen=True)] = "0,0,0"
    law: Literal["spec", "second", "lds01", "neato"] = "spec"
    falloff: float | None = None
    exponent: float | None = None
    specular: float | None = None
    end_error: str | None = None

    def config(self, end_error: tuple[float, float]) -> "DriveConfig":
        from ..sim.laser import LAWS, DriftConfig, DriveConfig, Scanner

        law = LAWS[self.law]
        low, high = numbers(self.end_error, 2, "--end-error") if self.end_error else end_error
        x, y, theta = numbers(self.sensor_pose, 3, "--sensor-pose")
        return DriveConfig(
            scan_every=self.scan_every,
            odometry_every=min(0.05, self.scan_every),
            speed=self.speed,
            people=self.people,
            sweep=self.sweep,
            sensor_pose=(x, y, theta),
            scanner=Scanner(beams=self.beams, far=self.range_),
            law=replace(
                law,
                falloff=law.falloff if self.falloff is None else self.falloff,
                exponent=law.exponent if self.exponent is None else self.exponent,
                specular=law.specular if self.specular is None else self.specular,
            ),
            drift=DriftConfig(end_error=(low, high) if high > 0 else None),
        )
