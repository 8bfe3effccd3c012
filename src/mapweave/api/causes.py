"""Why a map is bent: the likeliest cause, its evidence, and what mends it, from findings and figures of a result.

Causes bring about each other's signs: ranges in millimetres make wheels that disagree, a mirrored scanner tears the
trajectory. So they are looked for in one order, what lies deepest first, and the first that shows is the likeliest.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core import se2
from ..core.errors import DataError, UsageError
from ..core.findings import KINDS, Finding, Verdict
from ..core.names import robot_key, robot_name
from ..core.records import Track
from ..core.version import __version__
from ..io.directory import MARKERS, write_json
from ..laser.laser_map import LaserMap
from ..laser.robot_graph import RobotGraph
from ..mapping.merge import Merge
from ..report.result import ResultBase, Rows
from ..report.small_pages import draw_checks, write_small_page
from ..report.style import Target
from .read import Log
from .result import MapResult, load

UNIT = 10.0  # times as far as the wheels tell scans move, or as little: another unit
SCALE = 0.08  # by which the scale of ways is off where it counts as a cause
LAG = 0.2  # [s] between the clocks of scans and wheels
YAW = 0.05  # [rad] by which the scanner is turned
FEW, NEAR = 60, 1.5  # returns of a scan on the median and [m] that nearly all lie within: less is too little
PAUSE, AWAY = 5.0, 1.0  # times the usual time from scan to scan, in which the robot drove so far [m]: a gap
STRETCH, APART, SLIPS = 1.0, 0.2, 0.2  # [m] by the wheels, share by which ways differ, share of stretches that do
PEOPLE = 0.03  # of all returns, that were left out as of things that move
ALONG = 0.012  # of what walls tell, along the direction that they tell least of, on the median keyframe: a corridor

MENDS = {  # cause: what it is in words, and what mends it
    "units": (
        "ranges or odometry are in another unit, or of another sign",
        "convert them to metres, radians and seconds",
    ),
    "mirrored": ("the scanner's beams run the wrong way round", "map again with --mirrored"),
    "clock": ("stamps are not those of the measurements", "record with the driver's own stamps, clocks set together"),
    "lag": (
        "scans and odometry are of different moments",
        "correct the scans' stamps by the lag, or set the scanner's clock",
    ),
    "mounting": ("the sensor is mounted turned, and the log does not say so", "give its place with --sensor-pose"),
    "few-returns": (
        "scans hold too few returns to tell how the robot moved",
        "check the scanner's range limits and its view; record slower, or more scans",
    ),
    "mixed": (
        "the file holds several drives, or odometry of another, or the robot was carried",
        "cut the log at that time and give the parts as logs of their own",
    ),
    "gaps": (
        "scans are missing while the robot drove",
        "record without loss; else say what is one place with `mapweave edit`",
    ),
    "labels": (
        "landmarks bear each other's names, or were misread",
        "correct the labels, or leave those landmarks out",
    ),
    "slip": ("the wheels slip or stall", "mend or slow them, or give another odometry (--odom-topic)"),
    "scale": (
        "wheels and ranges have different scales",
        "calibrate the wheels, and compare the map with a length that you know",
    ),
    "people": ("much of what was seen moves", "map at a quiet time, or drive through twice"),
    "glass": ("walls of glass are seen at some angles and seen through at others", "cover the panes or mask them"),
    "symmetry": (
        "places that look alike are taken for one another",
        "say which are apart with `mapweave edit` or --decisions, or where robots start with --start",
    ),
    "corridor": (
        "walls tell little along long corridors that look alike",
        "keep the wheels calibrated, use the light of returns, or add landmarks or fixes",
    ),
}
TOLD = {  # code of a finding: the cause that it is a sign of by itself
    "wheels-fast": "units",
    "scans-blind": "units",
    "rows-impossible": "units",
    "turns-unlike": "units",
    "speeds-unlike": "units",
    "fixes-mirrored": "units",
    "beams-mirrored": "mirrored",
    "map-mirrored": "mirrored",
    "stamps-equal": "clock",
    "stamps-rounded": "clock",
    "stamps-back": "clock",
    "stamps-mixed": "clock",
    "wheels-untimed": "clock",
    "clock-apart": "clock",
    "clock-drift": "clock",
    "robot-clock": "clock",
    "robot-clock-maybe": "clock",
    "stamp-lag": "lag",
    "camera-clock": "lag",
    "scanner-turned": "mounting",
    "camera-turned": "mounting",
    "few-scans": "few-returns",
    "log-parted": "mixed",
    "wheels-leap": "mixed",
    "wheels-set": "mixed",
    "scene-jump": "mixed",
    "scene-change": "mixed",
    "logs-alike": "mixed",
    "put-down": "mixed",
    "scan-gap": "gaps",
    "gap-disputed": "gaps",
    "labels-exchanged": "labels",
    "landmarks-renamed": "labels",
    "tag-twice": "labels",
    "landmark-torn": "labels",
    "sightings-doubted": "labels",
    "wheels-stand": "slip",
    "wheels-scale": "scale",
    "wheels-unlike": "scale",  # or another unit, where it is far off
    "place-unclear": "symmetry",
    "cut-disputed": "symmetry",
    "glass-seen": "glass",
}
WEAK = {  # where nothing else shows
    "wheels-disagree": "slip",
    "way-bent": "symmetry",
    "way-slid": "corridor",
    "walls-seen-through": "symmetry",
    "walls-twice": "symmetry",
}


class Cause(NamedTuple):
    """name: of `MENDS`; robot: its key, None where it is of several; evidence: what was found, in words."""

    name: str
    robot: str | None
    evidence: str

    @property
    def text(self) -> str:
        """One sentence: what it is, by which evidence, and what mends it."""
        what, mend = MENDS[self.name]
        whose = "" if self.robot is None else f"{robot_name(self.robot)}: "
        return f"{whose}{what} ({self.evidence}); {mend}"


@dataclass(frozen=True, slots=True, repr=False)
class Causes(ResultBase):
    """What `doctor` says of a map: the causes that show, the likeliest first. verdict: the map's, None of no map.

    doubts: what else makes the map doubtful, which is a sign of no cause.
    """

    source: str
    verdict: Verdict | None
    causes: tuple[Cause, ...]
    doubts: tuple[Finding, ...] = ()

    @property
    def metrics(self) -> dict[str, Any]:
        rows = [{**cause._asdict(), "text": cause.text} for cause in self.causes]
        doubts = [found.row() for found in self.doubts]
        return {
            "version": __version__,
            "source": self.source,
            "verdict": self.verdict,
            "causes": rows,
            "doubts": doubts,
        }

    def lines(self) -> list[str]:
        asked = "nothing doubts this map; where it is bent all the same, the " if self.verdict == "good" else ""
        heads = [f"{asked}likeliest cause", *["also"] * len(self.causes)]
        told = [f"{head}: {cause.text}" for head, cause in zip(heads, self.causes, strict=False)]
        told += [f"{self.verdict}: {f.told}. {KINDS[f.code].means} {KINDS[f.code].do}" for f in self.doubts]
        return told or ["nothing that was looked for bends this map"]

    def headline(self) -> Rows:
        rows = [(c.name, c.robot or "", c.evidence) for c in self.causes]
        return ("cause", "robot", "evidence"), rows or [("none", "", "")]

    def draw(self, target: Target) -> None:
        """Every cause that was looked for, and whether it shows."""
        shown = {cause.name: cause.evidence[:110] for cause in reversed(self.causes)}
        draw_checks(target, [(name, shown.get(name, "no sign"), name not in shown) for name in MENDS], ())

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html and its picture."""
        png = folder / "figures" / "causes.png"
        self.draw(png)
        write_small_page(folder, "Why is this map bent?", self.lines(), self.headline(), png)
        write_json(folder / "metrics.json", self.metrics)


def causes_of(subject: Any) -> Causes:
    """What may bend the map of a result, its folder, a log, or what `read` gave of logs, which are mapped first."""
    if isinstance(subject, str | Path):
        source, result = str(subject), None
        if any((Path(subject) / name).is_file() for name in MARKERS):
            held = load(subject)
            result = held if isinstance(held, MapResult) else None
            kind = type(held).__name__
            if result is None and not kind.startswith("Simulated"):  # which are logs, too
                raise UsageError(f"{subject}: expected a map or logs, found a result of another kind ({kind})")
    else:
        source, result = "in memory", subject if isinstance(subject, MapResult) else None
        if result is None and not isinstance(subject, Log):
            raise UsageError(f"subject: expected a path, a map or a log, found {type(subject).__name__}")
    if result is None:
        from .map import map as mapped  # noqa: PLC0415  (what a check of the installation can do without)

        try:
            result = mapped(subject)
        except DataError as error:
            return refused(source, error)
    known = {*TOLD, *WEAK, "wheels-other"}
    doubts = (f for f in result.findings if KINDS[f.code].severity != "note" and f.code not in known)
    return Causes(source, result.verdict, tuple(_ordered(result)), tuple(doubts))


def refused(source: str, error: DataError) -> Causes:
    """What is said of a log that is no map, where the reason is a cause; raises the error where it is none."""
    if "expected metres" not in str(error):
        raise error
    return Causes(source, None, (Cause("units", None, str(error)),))


def _ordered(result: MapResult) -> list[Cause]:
    """The first sign of each cause, in the order of `MENDS`; weak signs where there is no other."""
    maps = [m for m in (*result.maps, *getattr(result, "lasers", ())) if isinstance(m, LaserMap)]
    signs = [*_told(result.findings, TOLD), *_merged(getattr(result, "merges", ()))]
    for local_map in maps:
        signs += [Cause(name, robot_key(local_map.robot), said) for name, said in _measured(local_map, result.findings)]
    first: dict[str, Cause] = {}
    for cause in signs or _told(result.findings, WEAK):
        first.setdefault(cause.name, cause)
    return [first[name] for name in MENDS if name in first]


def _told(findings: Sequence[Finding], table: dict[str, str]) -> list[Cause]:
    found = sorted(findings, key=lambda f: KINDS[f.code].severity == "note")
    return [Cause(_meant(f, table), f.robot, f.text) for f in found if f.code in table]


def _meant(f: Finding, table: dict[str, str]) -> str:
    """The cause that a finding is a sign of."""
    unlike = f.code == "wheels-unlike" and isinstance(f.value, float) and not 1 / UNIT < f.value < UNIT
    return "units" if unlike else table[f.code]


def _merged(merges: Sequence[Merge]) -> Iterator[Cause]:
    for m in merges:
        if not m.merged and "fit equally well" in m.reason:
            yield Cause("symmetry", None, m.reason)


def _measured(m: LaserMap, findings: Sequence[Finding]) -> Iterator[tuple[str, str]]:
    """Causes that figures of one robot's map tell, each with the figure."""
    yield from _calibrated(m)
    for f in findings:
        if f.code == "wheels-other" and f.robot == robot_key(m.robot) and isinstance(f.value, dict):
            ways, turns = float(f.value["ways"]), float(f.value["turns"])
            aside = np.radians(float(f.value.get("aside", 90.0)))  # results of 0.3 and before do not hold it
            of_ways = "mounting" if abs(aside) >= YAW else "slip"
            yield "lag" if turns > 2 * ways else of_ways if ways > 2 * turns else "mixed", f.text
    beams = m.scans.beams
    reach = 0.0 if m.graph is None or not len(m.graph.points) else _reach(m.graph)
    if np.median(beams) < FEW or 0.0 < reach < NEAR:
        yield "few-returns", f"{np.median(beams):.0f} returns in a scan on the median, 95 % within {reach:.1f} m"
    if m.dead_reckoning is not None and len(m.dead_reckoning.t) == len(m.track.t) > 1:
        yield from _driven(m, m.dead_reckoning)
    moving = m.dropped.get("return of something that moves", 0) / max(1, int(beams.sum()))
    if moving >= PEOPLE:
        yield "people", f"{100 * moving:.0f} % of the returns moved"
    if m.graph is not None and len(m.graph.points) and (along := _along(m.graph)) < ALONG:
        yield "corridor", f"of what walls tell, {100 * along:.1f} % is along the way"


def _calibrated(m: LaserMap) -> Iterator[tuple[str, str]]:
    """What the log tells of its wheels and of its scanner's mounting."""
    rows = {} if m.odometry_calibration is None else m.odometry_calibration.row()
    by = float(rows["speed_scale"]["value"]) if rows and rows["speed_scale"]["observed"] else 1.0
    if not 1 / UNIT < by < UNIT:
        yield "units", f"scans move {by:.3g} times as far as the wheels tell"
    elif abs(by - 1.0) >= SCALE:
        yield "scale", f"scans move {by:.3f} times as far as the wheels tell"
    used = {name: float(row["value"]) for name, row in rows.items() if row.get("applied")}
    if abs(late := used.get("lag", 0.0)) >= LAG:
        yield "lag", f"scans are stamped {abs(late):.2f} s {'late' if late > 0 else 'early'}"
    if abs(yaw := used.get("sensor_yaw", 0.0)) >= YAW:
        yield "mounting", f"the scanner is turned by {np.degrees(yaw):.0f} degrees"


def _driven(m: LaserMap, dead: Track) -> Iterator[tuple[str, str]]:
    """Where scans are missing, and where wheels tell another way than scans."""
    steps = np.diff(m.scans.t)
    at = np.searchsorted(dead.t, m.scans.t).clip(0, len(dead.t) - 1)
    went = np.hypot(*np.diff(dead.pose[at, :2], axis=0).T)
    lost = (steps > PAUSE * np.median(steps)) & (went > AWAY)
    if lost.any():
        yield "gaps", f"no scans for {steps[lost].max():.0f} s in which the wheels tell {went[lost].max():.1f} m"
    if (share := _slips(dead.pose, m.track.pose)) >= SLIPS:
        yield "slip", f"over {100 * share:.0f} % of the way wheels and scans tell ways that differ by a fifth"


def _slips(dead: Float[np.ndarray, "n 3"], track: Float[np.ndarray, "n 3"]) -> float:
    """The share of stretches whose length by the wheels differs from that by the scans, beyond their usual scale."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dead[:, :2], axis=0).T))])
    cuts = np.unique(np.searchsorted(way, np.arange(0.0, way[-1], STRETCH)))
    wheels, scans = (np.hypot(*se2.between(p[cuts[:-1]], p[cuts[1:]])[:, :2].T) for p in (dead, track))
    straight = wheels > 0.3 * STRETCH  # a turn on the spot has no way
    if not straight.any():
        return 0.0
    ratio = scans[straight] / wheels[straight]
    return float(np.mean(np.abs(ratio / max(float(np.median(ratio)), 1e-9) - 1.0) > APART))


def _reach(g: RobotGraph) -> float:
    """The range [m] that 95 of 100 returns are within."""
    owner = np.repeat(np.arange(len(g)), np.diff(g.start))
    return float(np.quantile(np.hypot(*(g.points - g.sensor[owner]).T), 0.95))


def _along(g: RobotGraph) -> float:
    """The share of what walls tell that is of the direction they tell least of, on the median keyframe."""
    normals = [g.normals[g.rows(k)] for k in range(len(g)) if len(g.points[g.rows(k)]) > 10]
    return float(np.median([np.linalg.eigvalsh(n.T @ n / len(n))[0] for n in normals])) if normals else 1.0
