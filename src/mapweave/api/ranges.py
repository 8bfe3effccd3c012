"""Robots and beacons placed by ranges: from a graph of anybody's, and `map` of recordings of ranging radios."""

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import DataError, EstimateError, UsageError
from ..core.findings import Finding, Unused, Verdict, shortly, verdict, verdict_line
from ..core.names import in_order, robot_key
from ..core.paths import checked_arguments
from ..core.version import __version__
from ..core.workers import one_blas_thread
from ..io.directory import check_target, write_json
from ..io.fixes import read_points, write_georeferenced
from ..io.pyfg import read_pyfg, write_pyfg
from ..io.range_bags import is_range_bag, read_range_bag
from ..io.rawlog import is_rawlog_of_ranges, read_rawlog_ranges
from ..io.table import write_table
from ..io.team_map import write_landmarks, write_tracks
from ..landmarks.landmark_map import LandmarkMap
from ..mapping.woven_map import Georeference
from ..ranges.estimate import PlacedPart, RangeEstimate, estimate
from ..ranges.network import RangeLog, RangeNetwork, StampShift, network_of, silences
from ..report.html import told_list
from ..report.result import ResultBase, Rows, written
from ..report.small_pages import RangeStory, range_scene, write_range_report
from ..report.style import Target
from ..report.team_figures import headline_scores
from ..team.georeference import laid_ranges
from ..team.team_map import TeamMap, in_first_frame, way_loose
from .evaluate import Evaluation, judged
from .map_laser import grown
from .map_options import MapOptions
from .team import Watch

SURVEYED = 0.02  # [m] sd of a beacon whose survey does not say it
BIASES_APART = 1.0  # [m] by which pairs of radios differ (rms about their median) in how much too long they read
WINDOWS = 10  # into which the ranges of a pair are cut in order of time
OFF = 0.3  # [m] by which the median of such a window is off: twice what ranging radios scatter by
KEPT, LOST = 0.1, 2  # of the ranges of such a window at least, or it is lost; so many in a row may be
OFF_SHARE = 0.02  # of all windows, from which it is told: one may be off by chance
LEAST = 3  # ranges of a window
WORSE = 2.0  # times what ranges say of their noise, from which it is told
MOSTLY = 0.5  # share of ranges rejected from which nothing is believed
LATE, LATE_ROUNDS = 0.25, 3  # [s] by which stamps are moved at once, at most, and how often
TOLD_LATE, TOLD_GROWTH, TOLD_SLIP = 0.05, 0.1, 3.0  # [s], [m], times from which it is told, where it is sure
TOLD_SURE = 4.0  # sd
CARRIED = 2  # times that ranges deny a robot's odometry, beyond which it is no odometry of that robot
TOLD_SHARE = 0.02  # of all ranges rejected, from which it is told


@dataclass(frozen=True, slots=True, repr=False)
class RangeResult(ResultBase):
    """Robots and beacons placed by ranges: `maps` as of landmark logs, beacons as landmarks, the largest first.

    georeference: where fixes lay one of them; online: what the maps on the way held.
    """

    maps: tuple[TeamMap, ...]
    network: RangeNetwork
    estimate: RangeEstimate
    findings: tuple[Finding, ...]
    source: str
    unused: tuple[Unused, ...]
    timing: dict[str, float] = field(compare=False)
    evaluation: Evaluation | None = None
    georeference: Georeference | None = None
    online: tuple[dict[str, Any], ...] = ()

    @property
    def verdict(self) -> Verdict:
        """What the findings make of the result."""
        return verdict(self.findings)

    @property
    def metrics(self) -> dict[str, Any]:
        net, e = self.network, self.estimate
        ranges = dict.fromkeys(net.robots, 0)
        for radio in e.radios:
            for name in {radio.a, radio.b} & set(ranges):
                ranges[name] += radio.n
        out = {
            "version": __version__,
            "source": self.source,
            "seed": 0,
            "verdict": self.verdict,
            "findings": [found.row() for found in self.findings],
            "warnings": [found.told for found in self.findings],
            "unused": [left.row() for left in self.unused],
            "robots": {
                robot_key(name): {
                    "source": self.source,
                    "odometry": "poses",
                    "ranges": ranges[name],
                    "verdict": verdict([f for f in self.findings if f.robot == robot_key(name)]),
                    "warnings": [f.text for f in self.findings if f.robot == robot_key(name)],
                }
                for name in net.robots
            },
            "components": [[robot_key(r) for r in team.robots] for team in self.maps],
            "beacons": list(net.beacons),
            "dropped": dict(net.dropped),
            "radios": [
                {"a": robot_key(r.a), "b": robot_key(r.b), "ranges": r.n, "bias": r.bias, "bias_sd": r.bias_sd,
                 "sd": r.sd, "lasting": r.lasting, "rejected": r.far}
                for r in e.radios
            ],
            "converged": all(part.converged for part in e.parts),
            "timing": self.timing,
        }  # fmt: skip
        if self.georeference is not None:
            out["georeference"] = [None if placed is None else placed.row() for placed in self._placed]
        if self.online:
            out["online"] = list(self.online)
        return out if self.evaluation is None else {**out, "evaluation": self.evaluation.as_json()}

    @property
    def _placed(self) -> list[Georeference | None]:
        """Of each map where it lies in the world."""
        return [self.georeference if part.frame_cov is not None else None for part in self.estimate.parts]

    def size(self) -> dict[str, Any]:
        """How many robots and beacons the largest map holds, how many maps there are, and the verdict."""
        first = self.maps[0]
        size = {"robots": len(first.robots), "maps": len(self.maps), "beacons": len(first.landmarks)}
        return {**size, "verdict": self.verdict}

    def headline(self) -> Rows:
        rows = [(robot_key(r.a), robot_key(r.b), r.n, r.bias, r.sd, r.far) for r in self.estimate.radios]
        return ("a", "b", "ranges", "bias [m]", "sd [m]", "rejected"), rows

    def lines(self) -> list[str]:
        net, team = self.network, self.maps[0]
        where = "one map" if len(self.maps) == 1 else f"the first of {len(self.maps)} maps"
        far = int(self.estimate.far.sum())
        placed = (
            f"{len(team.robots)} of {len(net.robots)} robots and {len(team.landmarks)} of {len(net.beacons)} beacons"
        )
        out = [f"{placed} in {where}: {len(net.ranges)} ranges, {far} rejected"]
        out += [f"warning: {text}" for text in shortly(self.findings, named=True)]
        if self.evaluation is not None:
            out += self.evaluation.lines()
        return [*out, verdict_line(self.findings)]

    def draw(self, target: Target) -> None:
        """Trajectories and beacons of the largest component."""
        range_scene(self._story, self._story.maps[0]).draw(target)

    @property
    def _story(self) -> RangeStory:
        scores = () if self.evaluation is None else tuple(headline_scores(self.evaluation.as_json()))
        told = () if self.evaluation is None else tuple(self.evaluation.lines())
        return RangeStory(
            self.source,
            self.maps,
            self.network,
            self.estimate,
            self.findings,
            scores,
            self._placed,
            told,
            self.online,
        )

    def write_into(self, folder: Path) -> None:
        """Trajectories, beacons and ranges with their residuals, the solved graph, report and, last, `metrics.json`."""
        self._write_files(folder)
        write_range_report(folder, self._story)
        write_json(folder / "metrics.json", self.metrics)

    def write_data(self, folder: Path) -> None:
        self._write_files(folder)
        write_json(folder / "metrics.json", self.metrics)

    def _write_files(self, folder: Path) -> None:
        net, e = self.network, self.estimate
        for k, (team, placed) in enumerate(zip(self.maps, self._placed, strict=True), 1):
            home = folder if k == 1 else folder / "components" / str(k)
            home.mkdir(parents=True, exist_ok=True)
            write_landmarks(home, team)
            write_tracks(home, team)
            if placed is not None:
                write_georeferenced(home, placed, team.tracks, landmarks=team.landmarks)
        who, r = [robot_key(name) for name in net.everybody], net.ranges
        rows = zip(
            r.t.tolist(), [who[k] for k in net.owner[r.a]], [who[k] for k in net.owner[r.b]], r.z.tolist(),
            e.residual.tolist(), (~e.far & np.isfinite(e.residual)).astype(int).tolist(), strict=True,
        )  # fmt: skip
        write_table(folder / "ranges.csv", ["t", "a", "b", "range", "residual", "used"], rows)
        write_pyfg(folder / "graph.pyfg", *self._solved_graph())

    def _solved_graph(self) -> tuple[RangeNetwork, np.ndarray]:
        """The network with poses found, ranges that were used carried to them and their biases off, sd as counted."""
        net, e, r = self.network, self.estimate, self.network.ranges
        pose = np.zeros((len(net.owner), 3))
        for part in e.parts:
            pose[part.nodes] = part.pose
        counted = {frozenset((radio.a, radio.b)): radio.sd * np.sqrt(radio.lasting) for radio in e.radios}
        used = np.flatnonzero(~e.far & np.isfinite(e.residual))
        ends = zip(net.owner[r.a[used]].tolist(), net.owner[r.b[used]].tolist(), strict=True)
        sd = np.array([counted[frozenset((net.everybody[a], net.everybody[b]))] for a, b in ends])
        z = np.hypot(*(pose[r.a[used]] - pose[r.b[used]])[:, :2].T) + e.residual[used]
        straight = replace(r.select(used), z=z, sd=sd)
        return replace(net, ranges=straight.select(np.flatnonzero(z > 0))), pose


@checked_arguments
@one_blas_thread()
def solve_ranges(file: Path | str, out: Path | str | None = None, *, force: bool = False) -> RangeResult:
    """Place the robots and beacons of a graph of ranges, anybody's, from no guess.

    Written to `out` if given. Where the file's vertices stand is not read: it may be the truth, and `evaluate` takes it
    as such. The frame is that of the file's priors, else the first pose of the first robot.

    Parameters
    ----------
    file
        A planar graph in the text format of PyFactorGraph (.pyfg, plain or packed): VERTEX_SE2, VERTEX_XY, EDGE_SE2,
        EDGE_RANGE and priors.

    Raises
    ------
    ReaderError
        For a file that is missing or damaged, with its line.
    DataError
        For a graph without ranges.
    EstimateError
        For a solve that failed.
    UsageError
        For an `out` that holds something other than a result. Nothing is written then.
    """
    check_target(out, force=force, reads=(file,))
    watch = Watch()
    held = read_pyfg(Path(file))
    watch.lap("read")
    if not len(held.network.ranges):
        raise DataError(f"{file}: expected ranges, found none: `solve_pose_graph` solves poses alone")
    notes = tuple(Finding("topics-chosen", value=warning) for warning in held.warnings)
    result = _result(held.network, str(file), notes, (), watch)
    return written(result, out, force=force)


def applies(log: Path) -> bool:
    """Recordings and rawlogs of ranges and odometry without scans."""
    return is_range_bag(log) or is_rawlog_of_ranges(log)


def map_logs(logs: Sequence[Path], options: MapOptions) -> RangeResult:
    """The map of one recording of ranging radios."""
    if len(logs) > 1:
        raise UsageError(f"expected one recording of ranges, found {len(logs)}: record all robots together")
    plain = MapOptions()
    for name in ("robots", "method", "weights", "share", "start", "refine", "online", "calibration"):
        if (asked := getattr(options, name)) != getattr(plain, name):
            option = f"{'no-' * (asked is False)}{name.replace('_', '-')}"
            raise UsageError(f"--{option}: not for recordings of ranges, found {logs[0]}")
    watch = Watch()
    bag = is_range_bag(logs[0])
    log = read_range_bag(logs[0], options.radios, options.laser.fixes) if bag else read_rawlog_ranges(logs[0])
    if options.survey is not None:
        points = read_points(options.survey)
        known = {name: (x, y, sd or SURVEYED) for name, (x, y, sd) in points.items() if name in log.names}
        if not known:
            raise DataError(f"{options.survey}: none of its points is a beacon ranged to ({', '.join(log.names)})")
        log = replace(log, known=known)
    watch.lap("read")
    result = _of_log(log, watch)
    if options.fuse_every is not None:

        def look(until: list[float]) -> dict[str, Any]:
            return _of_log(log.until(until[0]), Watch()).size()

        rows = grown([log.span], options.fuse_every, look, result.size(), options.on_progress)
        result = replace(result, online=tuple(rows))
    return _scored(result, options)


def map_range_log(log: RangeLog) -> RangeResult:
    """The map of a log that was read."""
    return _of_log(log, Watch())


def _of_log(log: RangeLog, watch: Watch) -> RangeResult:
    net = network_of(log)
    if not len(net.ranges):
        why = ", ".join(f"{n} {reason}" for reason, n in net.dropped.items()) or "there are none"
        raise DataError(f"{log.source}: no range can be used: {why}")
    return _result(net, log.source, log.findings, log.unused, watch, log)


def _result(
    net: RangeNetwork,
    source: str,
    findings: Sequence[Finding],
    unused: Sequence[Unused],
    watch: Watch,
    log: RangeLog | None = None,
) -> RangeResult:
    found, georeference, late = estimate(net), None, dict[str, StampShift]()
    for _ in range(LATE_ROUNDS):
        if log is None or not any(abs(told.lag) + 0.5 * abs(told.drift) > LATE for told, _ in found.clocks.values()):
            break  # stamps moved by more than robots' ways are straight for: where they were then is looked up anew
        late = {name: late.get(name, StampShift()).plus(told) for name, (told, _) in found.clocks.items()}
        net = network_of(log, late)
        found = estimate(net)
    clocks = {name: (late.get(name, StampShift()).plus(told), sd) for name, (told, sd) in found.clocks.items()}
    found = replace(found, clocks=clocks)
    steps = [(int(net.motions.first[k]), int(net.motions.second[k])) for k in found.denied]
    denied = [
        Finding("odometry-denied", net.robots[net.owner[i]], (float(net.t[i]), float(net.t[j]))) for i, j in steps
    ]
    if log is not None:
        gaps = [(robot, gap) for robot, track in log.odometry.items() for gap in silences(track.t)]
        denied += [Finding("odometry-gap", robot, gap, gap[1] - gap[0]) for robot, gap in gaps]
    often = Counter(cut.robot for cut in denied if cut.code == "odometry-denied")
    denied += [Finding("odometry-unlike", robot, value=n) for robot, n in often.items() if n > CARRIED]
    net = net.without(found.denied)
    watch.lap("solve")
    if log is not None and log.fixes:
        laid = laid_ranges(net, found, log.odometry, log.fixes)
        found, georeference, findings = laid.estimate, laid.georeference, (*findings, *laid.findings)
        watch.lap("fixes")
    if not found.parts or not all(np.isfinite(part.pose).all() for part in found.parts):
        raise EstimateError(f"{source}: the solve ended with numbers that are not finite")
    maps = tuple(_team(net, part, found) for part in found.parts)
    told = (*findings, *denied, *_findings(net, found), *(loose for team in maps for loose in way_loose(team)))
    timing = {k: round(v, 4) for k, v in watch.seconds.items()}
    return RangeResult(maps, net, found, told, source, tuple(unused), timing, georeference=georeference)


def _team(net: RangeNetwork, part: PlacedPart, found: RangeEstimate) -> TeamMap:
    n = len(net.owner)
    pose, cov = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    pose[part.nodes], cov[part.nodes] = part.pose, part.cov
    known = bool(np.isfinite(part.cov).all())
    robots = [k for k in np.unique(net.owner[part.nodes]).tolist() if k < len(net.robots)]
    at = part.nodes[net.is_beacon[part.nodes]]
    ids = tuple(net.everybody[k] for k in net.owner[at].tolist())
    joint = part.beacon_cov if known else np.zeros((2 * len(ids), 2 * len(ids)))
    heard = {name: [r for r in found.radios if name in {r.a, r.b}] for name in ids}
    team = TeamMap(
        tuple(net.robots[k] for k in robots),
        LandmarkMap(ids, pose[at, :2], joint),
        {net.robots[k]: net.track(k, pose, cov if known else None) for k in robots},
        {name: tuple(sorted({r.a, r.b}.difference([name]).pop() for r in rs)) for name, rs in heard.items()},
        {name: sum(r.n for r in rs) for name, rs in heard.items()},
    )
    return team if part.first is None else in_first_frame(team)


def _findings(net: RangeNetwork, found: RangeEstimate) -> list[Finding]:
    out = [Finding("range-dropped", value={"n": n, "value": reason}) for reason, n in net.dropped.items()]
    far, n = int(found.far.sum()), int(np.isfinite(found.residual).sum())
    if far > TOLD_SHARE * n:
        most = max(found.radios, key=lambda r: r.far / r.n)
        pair, worst = f"{robot_key(most.a)} and {robot_key(most.b)}", 100 * most.far / most.n
        shares: dict[str, float | str] = {"far": far, "n": n, "share": 100 * far / n, "pair": pair, "worst": worst}
        out.append(Finding("range-outliers", value=shares))
    biases = np.array([r.bias for r in found.radios])
    apart = np.abs(biases - np.median(biases)) if len(biases) else np.zeros(1)
    if (differ := float(np.sqrt(np.square(apart).mean()))) > BIASES_APART:
        worst_of = found.radios[int(np.argmax(apart))]
        pair = f"{robot_key(worst_of.a)} and {robot_key(worst_of.b)}"
        out.append(Finding("range-biases", value={"pair": pair, "bias": worst_of.bias, "value": differ}))
    scatter, stated = float(np.median([r.sd for r in found.radios] or [0.0])), float(np.median(net.ranges.sd))
    if scatter > WORSE * stated:  # where none is stated it is NaN
        out.append(Finding("ranges-worse", value={"value": scatter, "times": scatter / stated}))
    out += [*_drifting(net, found), *_made_up_for(found)]
    if far > MOSTLY * n:
        out.append(Finding("ranges-contradict", value={"far": far, "n": n}))
    for part in found.parts:
        out += [Finding("heading-unobserved", name) for name in part.still]
        for other in part.mirrored:
            off = np.hypot(*(other - part.pose)[:, :2].T)
            who = sorted(
                {net.everybody[k] for k in net.owner[part.nodes[off > 0.5 * off.max()]].tolist()}, key=in_order
            )
            told = f"{told_list([robot_key(w) for w in who])} may lie elsewhere too, up to {off.max():.1f} m away"
            out.append(Finding("range-ambiguous", value=f"{told}: ranges fit both"))
    for name, why in found.loose.items():
        beacon = name in net.beacons
        out.append(
            Finding("range-unplaced", None if beacon else name, value=f"beacon {name}: {why}" if beacon else why)
        )
    if others := [robot for part in found.parts[1:] for robot in _robots(net, part)]:
        out.append(Finding("robots-apart", value=told_list([robot_key(r) for r in others])))
    return out


def _made_up_for(found: RangeEstimate) -> list[Finding]:
    """What was found to be off in stamps, biases and odometry, and is reckoned with."""
    out = []
    for robot, (told, sd) in found.clocks.items():
        if abs(told.lag) > max(TOLD_LATE, TOLD_SURE * sd.lag):
            way = "after" if told.lag > 0 else "before"
            out.append(Finding("range-lag", robot, value={"value": abs(told.lag), "way": way}))
        if abs(told.drift) > max(TOLD_LATE, TOLD_SURE * sd.drift):
            out.append(Finding("range-clock", robot, value=told.drift))
    if found.jitter > TOLD_LATE:
        out.append(Finding("range-stamps", value=found.jitter))
    growing = [r for r in found.radios if abs(r.growth) > max(TOLD_GROWTH, TOLD_SURE * r.growth_sd)]
    if growing:
        most = max(growing, key=lambda r: abs(r.growth))
        told_of: dict[str, float | str] = {"value": most.growth, "pair": f"{robot_key(most.a)} and {robot_key(most.b)}"}
        out.append(Finding("range-growth", value=told_of))
    out += [Finding("odometry-slips", s.robot, (s.first, s.last), s.times) for s in found.slips if s.times > TOLD_SLIP]
    return out


def _drifting(net: RangeNetwork, found: RangeEstimate) -> list[Finding]:
    """That ranges do not keep to one place and one bias: the pair whose ranges do so least, if many do not.

    Ranges that were rejected count where they are too short, which no wall makes them, and where nearly all of a pair
    are for long: its beacon may have been moved as well as hidden.
    """
    names, which = net.pairs()
    off, lost = np.zeros((len(names), WINDOWS)), np.zeros((len(names), WINDOWS), bool)
    for k in range(len(names)):
        mine = np.flatnonzero((which == k) & np.isfinite(found.residual))
        mine = mine[np.argsort(net.ranges.t[mine], kind="stable")]
        for w, part in enumerate(np.array_split(mine, WINDOWS) if len(mine) >= LEAST * WINDOWS else ()):
            e, used = found.residual[part], ~found.far[part]
            short, kept = float(np.median(e)), float(np.median(e[used])) if used.sum() >= LEAST else 0.0
            lost[k, w] = used.mean() < KEPT
            off[k, w] = short if short < -OFF or (lost[k, w - LOST : w + 1].sum() > LOST) else kept
    share = float((np.abs(off) > OFF).mean()) if len(names) else 0.0
    if share <= OFF_SHARE:
        return []
    k = int(np.argmax(np.abs(off).max(axis=1)))
    a, b = (robot_key(net.everybody[end]) for end in names[k].tolist())
    told: dict[str, float | str] = {"share": 100 * share, "pair": f"{a} and {b}", "value": float(np.abs(off[k]).max())}
    return [Finding("ranges-drift", value=told)]


def _robots(net: RangeNetwork, part: PlacedPart) -> list[str]:
    return [net.robots[k] for k in np.unique(net.owner[part.nodes]).tolist() if k < len(net.robots)]


def _scored(result: RangeResult, options: MapOptions) -> RangeResult:
    """With its score, where truth was given; truth is read here, when nothing is left to estimate."""
    if not options.truth:
        return result
    with tempfile.TemporaryDirectory() as folder:
        result.write_data(Path(folder))
        score = judged(Path(folder), options.truth)
    left = (Finding("truth-unscored", value=score.unscored),) if score.unscored else ()
    return replace(result, findings=(*result.findings, *left), evaluation=score)
