"""What `reproduce kojima` measured, and its tables; how often pairs are found where nobody names landmarks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ...core import se2
from ...core.workers import Progress, no_progress
from ...fusion.alignment import joint_fit, log_correspondences, log_evidence, spread_area
from ...fusion.identities import IDENTITY_CHANCE, IdentityConfig, match_maps
from ...fusion.relative_information import Weights
from ...landmarks.landmark_map import LandmarkMap
from ...report.result import Rows
from ...report.style import MUTED, TRUTH, Target, as_map, colour, draw_ellipse, figure, marker
from ..reproduction import Numbers
from .experiments import SEEN, KojimaConfig, LocalMaps, Rule, Run, Settling, Unequal, Worlds

if TYPE_CHECKING:
    from ...report.style import Axes

POINTS, SIZE, SIGMA = 20, 3.0, 0.01  # landmarks a map, side of the square [m], deviation [m]
RIGHT = 0.15  # [m] every landmark must lie within, for an alignment to be right
IN_COMMON = (0, 2, 4, 6, 8, 14)
EXACT = IdentityConfig(noise=0.0, scale_sigma=1e-3, gate=3.5)  # maps that err as their covariances say, and no more


@dataclass(frozen=True, slots=True)
class IdentityTrials:
    """Of `trials` pairs of maps with `common` landmarks in both.

    aligned: the alignment was right, believed or not; right, wrong: believed and so; refused: not believed, mostly for
    `reason`. exact: whether matching knew that covariances and scales are right, or took both for those of real maps.
    """

    exact: bool
    common: int
    trials: int
    aligned: int
    right: int
    wrong: int
    refused: int
    reason: str
    evidence_right: tuple[float, ...] = ()
    evidence_wrong: tuple[float, ...] = ()
    evidence_true: tuple[float, ...] = ()  # of the true links, of all trials with more than two in common


@dataclass(frozen=True, slots=True)
class Price:
    """What believing a share of the right alignments costs: the odds needed, and wrong ones believed of how many."""

    odds: float
    wrong: int
    of: int


def price(rows: tuple[IdentityTrials, ...], common: int, share: float) -> Price | None:
    """The price of believing `share` of the trials with `common` in common; None where no odds reach it.

    Wrong ones are counted over all of `rows`, which are of one kind of matching.
    """
    asked = next(t for t in rows if t.common == common)
    needed = int(np.ceil(share * asked.trials))
    if len(asked.evidence_right) < needed:
        return None
    least = sorted(asked.evidence_right, reverse=True)[needed - 1]
    wrong = sum(e >= least for t in rows for e in t.evidence_wrong)
    return Price(float(np.exp(least)), wrong, sum(t.trials for t in rows))


def most_without_wrong(rows: tuple[IdentityTrials, ...], common: int) -> tuple[float, int]:
    """Odds of the strongest wrong match of all `rows`, and how many right ones with `common` in common are stronger."""
    strongest = max((e for t in rows for e in t.evidence_wrong), default=-np.inf)
    asked = next(t for t in rows if t.common == common)
    return float(np.exp(strongest)), sum(e > strongest for e in asked.evidence_right)


def oracle(rows: tuple[IdentityTrials, ...], common: int, odds: float = IDENTITY_CHANCE) -> int:
    """In how many trials even the true links, all of them and no other, have odds against chance of `odds` or more.

    No test that believes at these odds believes more of them: more evidence than the true links is evidence for others.
    """
    asked = next(t for t in rows if t.common == common)
    return sum(bool(e >= np.log(odds)) for e in asked.evidence_true)


def true_evidence(
    source: LandmarkMap, target: LandmarkMap, T: np.ndarray, links: set[tuple[int, int]], cfg: IdentityConfig
) -> float:
    """Logarithm of the odds for the true links against chance, T the true alignment."""
    true = np.array(sorted(links), dtype=np.intp)
    fit = joint_fit(source, target, true, T, cfg.noise, cfg.scale_sigma)
    area = min(spread_area(source), spread_area(target))
    known = log_evidence(source, target, true, fit, area, cfg.noise, cfg.scale_sigma)
    return known - log_correspondences(len(true), len(source), len(target))


def price_text(rows: tuple[IdentityTrials, ...]) -> str:
    """What believing 98 of 100 with six in common costs, and the most at no cost, in words that end a sentence."""
    asked = next(t for t in rows if t.common == 6)
    odds, most = most_without_wrong(rows, 6)
    where = f"beyond odds of {odds:.2g}" if odds > 0 else "at any odds"
    bound = f"{where} none of these pairs is matched wrongly, and {most} of {asked.trials} rightly"
    cost = price(rows, 6, 0.98)
    if cost is None:
        none = asked.trials - len(asked.evidence_right)
        why = f"is beyond any odds: in {none} of {asked.trials} trials fewer than six fit, or others as well"
    else:
        why = f"odds of {cost.odds:.2g} would have to do, at which {cost.wrong} of {cost.of} pairs are believed wrongly"
    return f"{why}; {bound}"


def identities_text(rows: tuple[IdentityTrials, ...]) -> str:
    """How many are believed of 98 of 100 asked for, with six in common; what else is so, and what more would cost."""
    six = next(t for t in rows if t.common == 6)
    share = "reached" if six.right >= 0.98 * six.trials else "missed"
    return (
        f"98 of 100 {share}: {six.right} of {six.trials} believed and right with six in common, where the true links "
        f"have such odds in {oracle(rows, 6)}; the alignment is right in {six.aligned}, refused ones counted; of all "
        f"rows {sum(t.wrong for t in rows)} wrongly believed; for it to believe 98 {price_text(rows)}"
    )


def draw_pair(
    common: int, rng: np.random.Generator
) -> tuple[LandmarkMap, LandmarkMap, np.ndarray, set[tuple[int, int]]]:
    """Two maps with `common` landmarks in both, `T_target_source`, and the true links (source, target)."""
    points = rng.uniform(0, SIZE, (2 * POINTS - common, 2))
    order = rng.permutation(POINTS)
    T = np.append(rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi))
    first = points[:POINTS] + rng.normal(0, SIGMA, (POINTS, 2))
    second = se2.act(T, points[POINTS - common :][order]) + rng.normal(0, SIGMA, (POINTS, 2))
    names = tuple(str(i) for i in range(POINTS))
    P = SIGMA**2 * np.eye(2 * POINTS)
    place = np.argsort(order)
    links = {(POINTS - common + i, int(place[i])) for i in range(common)}
    return LandmarkMap(names, first, P), LandmarkMap(names, second, P), T, links


def identity_trials(
    trials: int,
    seed: int,
    commons: tuple[int, ...] = IN_COMMON,
    *,
    exact: bool = True,
    on_progress: Progress = no_progress,
) -> tuple[IdentityTrials, ...]:
    """`trials` pairs for every number in common, every pair with a generator of its own."""
    out = []
    cfg = EXACT if exact else IdentityConfig()
    for at, common in enumerate(commons):
        on_progress("identities", at, len(commons))
        aligned = right = wrong = 0
        reasons: dict[str, int] = {}
        evidence: dict[bool, list[float]] = {True: [], False: []}
        true: list[float] = []
        for trial in range(trials):
            source, target, T, links = draw_pair(common, np.random.default_rng([seed, common, trial]))
            match = match_maps(source, target, cfg)
            off = se2.act(match.T_target_source, source.mean) - se2.act(T, source.mean)
            ok = bool(np.hypot(off[:, 0], off[:, 1]).max() < RIGHT)
            aligned += ok
            true += [true_evidence(source, target, T, links, EXACT)] if common > 2 else []
            right += match.accepted and ok
            wrong += match.accepted and not ok
            kind = "" if match.accepted else _kind(match.reason)
            if kind in {"", "chance"}:
                evidence[ok].append(match.evidence)
            if kind:
                reasons[kind] = reasons.get(kind, 0) + 1
        most = max(reasons, key=lambda kind: reasons[kind]) if reasons else ""
        refused = trials - right - wrong
        scores = tuple(evidence[True]), tuple(evidence[False]), tuple(true)
        out.append(IdentityTrials(exact, common, trials, aligned, right, wrong, refused, most, *scores))
    return tuple(out)


def _kind(reason: str) -> str:
    """The reason without its numbers."""
    for kind in ("another alignment", "chi-square", "chance", "needed"):
        if kind in reason:
            return {"needed": "too few agree"}.get(kind, kind)
    return reason


@dataclass(frozen=True, slots=True)
class Curve:
    """Trace of the covariance after each update: mean and 5 to 95 % band over the worlds, and its limit."""

    reading: str
    name: str
    mean: Float[np.ndarray, " k"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]
    limit: float


@dataclass(frozen=True, slots=True)
class FigureData:
    """What the figures show.

    errors: by reading, (RLS, proposed) landmark errors of each world [m]; bars: landmark error [m] by (baseline,
    weights); the rest is one world: truth, start poses, either robot's map in its own frame with the truth there,
    and by weighting the merged landmarks and the frame of robot 2.
    """

    first_step: int
    curves: Sequence[Curve]
    errors: Mapping[str, tuple[Float[np.ndarray, " s"], Float[np.ndarray, " s"]]]
    printed: tuple[float, float]
    bars: Mapping[tuple[str, str], float]
    truth: Float[np.ndarray, "n 2"]
    start: Float[np.ndarray, "2 3"]
    radius: float
    local_mean: Float[np.ndarray, "2 5 2"]
    local_cov: Float[np.ndarray, "2 10 10"]
    local_truth: Float[np.ndarray, "2 5 2"]
    merged: Mapping[str, tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "3"]]]


ENLARGED = 10.0  # how much larger than life the regions of local maps are drawn
_TRUE: dict[str, Any] = {
    "linestyle": "none",
    "marker": "s",
    "markersize": 9,
    "markerfacecolor": "none",
    "color": TRUTH,
}


def draw_trace(path: Target, p: FigureData) -> None:
    readings = list(dict.fromkeys(c.reading for c in p.curves))
    titles = {"prior": "map 1 is the prior", "measurement": "map 1 is a measurement"}
    with figure(path, 8.0, 3.8, ncols=len(readings)) as (_, axes):
        for ax, reading in zip(axes, readings, strict=True):
            for k, curve in enumerate(c for c in p.curves if c.reading == reading):
                step = p.first_step + np.arange(len(curve.mean))
                ax.fill_between(step[1:], curve.low[1:], curve.high[1:], color=colour(k), alpha=0.2, linewidth=0)
                ax.plot(step[1:], curve.mean[1:], color=colour(k), linestyle=("-", "--")[k % 2], label=curve.name)
            if curve.limit > 0:
                ax.axhline(curve.limit, color=TRUTH, linestyle=":", label="limit, Theorem 2 corrected")
            ax.set_yscale("log")
            ax.set_xlabel("step [0.1 s]")
            ax.set_title(titles[reading])
            ax.legend()
        axes[0].set_ylabel("trace of the covariance [m² + rad²]")


def draw_errors(path: Target, p: FigureData) -> None:
    with figure(path, 5.2, 4.6) as (_, ax):
        every = np.concatenate([*(e for pair in p.errors.values() for e in pair), p.printed])
        ends = [100 * float(every.min()) / 1.3, 100 * float(every.max()) * 1.3]
        ax.plot(ends, ends, color=MUTED, linewidth=0.8, label="equal")
        for k, (reading, (plain, proposed)) in enumerate(p.errors.items()):
            ax.plot(
                100 * plain,
                100 * proposed,
                linestyle="none",
                marker=marker(k),
                markersize=5 - 2 * k,
                color=colour(k),
                alpha=0.7,
                label=f"ours, map 1 as {reading}",
            )
        ax.plot(100 * p.printed[0], 100 * p.printed[1], "*", color=TRUTH, markersize=11, label="the paper's Table 2")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlim(*ends)
        ax.set_ylim(*ends)
        ax.set_aspect("equal")
        ax.set_xlabel("landmark error with RLS [cm]")
        ax.set_ylabel("landmark error with the proposed weights [cm]")
        ax.legend(loc="upper left")


def draw_bars(path: Target, p: FigureData) -> None:
    rules, names = (list(dict.fromkeys(key[k] for key in p.bars)) for k in (0, 1))
    with figure(path, 6.0, 3.4) as (_, ax):
        width = 0.8 / len(names)
        for k, name in enumerate(names):
            x = np.arange(len(rules)) + (k - (len(names) - 1) / 2) * width
            drawn = ax.bar(x, [100 * p.bars[rule, name] for rule in rules], 0.92 * width, color=colour(k), label=name)
            ax.bar_label(drawn, fmt="%.2f", fontsize=8, padding=2)
        ax.set_xticks(np.arange(len(rules)), [f"{rule} baseline" for rule in rules])
        ax.set_ylabel("landmark RMSE [cm]")
        ax.margins(y=0.22)
        ax.grid(visible=False, axis="x")
        ax.legend(ncols=len(names), loc="upper left")


def draw_local_map(path: Target, p: FigureData, k: int) -> None:
    """Robot k's map in its own frame: its trajectory, the landmarks it found, their 95 % regions ten times as large."""
    with figure(path, 5.2, 4.6) as (_, ax):
        mean, cov = p.local_mean[k], p.local_cov[k]
        _circle(ax, np.zeros(3), (1.0, -1.0)[k] * p.radius, colour(k), f"path of robot {k + 1}")
        _arrow(ax, np.zeros(3), TRUTH)
        ax.plot(*p.local_truth[k].T, **_TRUE, label="true")
        ax.plot(*mean.T, linestyle="none", marker="x", color=colour(k), label="EKF-SLAM")
        for at, (point, name) in enumerate(zip(mean, SEEN[k], strict=True)):
            draw_ellipse(ax, point, cov[2 * at : 2 * at + 2, 2 * at : 2 * at + 2], colour(k), ENLARGED)
            ax.annotate(str(name + 1), point, textcoords="offset points", xytext=(7, 7), color=TRUTH, fontsize=8)
        as_map(ax, f"local map {k + 1}, ellipses x {ENLARGED:g}")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_global_map(path: Target, p: FigureData) -> None:
    """The merged map with either weighting, on the truth."""
    with figure(path, 6.0, 5.4) as (_, ax):
        for k, side in enumerate((1.0, -1.0)):
            _circle(ax, p.start[k], side * p.radius, MUTED, f"path of robot {k + 1}")
            _arrow(ax, p.start[k], TRUTH)
        ax.plot(*p.truth.T, **_TRUE, label="true")
        for at, (name, (points, frame)) in enumerate(p.merged.items()):
            ax.plot(*points.T, linestyle="none", marker=("+", "x")[at], color=colour(at), markersize=8, label=name)
            _arrow(ax, frame, colour(at))
        ax.plot(
            *p.truth[:2].T, linestyle="none", marker="o", markersize=16, markerfacecolor="none", color=MUTED,
            label="in common",
        )  # fmt: skip
        as_map(ax)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _circle(ax: "Axes", start: Float[np.ndarray, "3"], radius: float, color: str, name: str) -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    centre = se2.act(start, np.array([0.0, radius]))
    ring = centre + abs(radius) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    ax.plot(*ring.T, color=color, linewidth=0.9, label=name)


def _arrow(ax: "Axes", pose: Float[np.ndarray, "3"], color: str) -> None:
    tip = se2.act(pose, np.array([0.12, 0.0]))
    ax.annotate("", xy=(tip[0], tip[1]), xytext=(pose[0], pose[1]), arrowprops={"arrowstyle": "->", "color": color})


PRINTED = {"constant": (0.0117, 0.0295), "paper": (0.00945, 0.0260)}  # the paper's Table 2: robot, landmark [m]
NAMES = {"constant": "RLS", "paper": "Proposed", "diagonal": "diagonal", "full": "full"}
CASES: tuple[tuple[Rule, Weights], ...] = (
    ("certain", "constant"),
    ("certain", "paper"),
    ("certain", "diagonal"),
    ("certain", "full"),
    ("widest", "constant"),
    ("widest", "paper"),
    ("widest", "diagonal"),
    ("widest", "full"),
)
SHOWN = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 700)  # updates of the trace curve that are printed


@dataclass(frozen=True, slots=True)
class Measured:
    """Everything measured. seeds: worlds behind Table 2; unequal_seeds: behind the table of unequal maps; maps: local
    maps when the robots come to rest.
    """

    seed: int
    quick: bool
    seeds: int
    unequal_seeds: int
    cfg: KojimaConfig
    worlds: Worlds
    maps: LocalMaps
    runs: tuple[Run, ...]
    nees: dict[tuple[Weights, int], float]
    unequal: tuple[Unequal, ...]
    settled: tuple[Settling, ...]
    identities: tuple[IdentityTrials, ...]
    timing: dict[str, float]

    def run(self, reading: str, weights: str) -> Run:
        return next(r for r in self.runs if (r.reading, r.weights) == (reading, weights))

    def relative_difference(self, reading: str) -> tuple[float, float]:
        """How much lower the proposed weights' errors are than plain RLS's (robot, landmark), as a share of 1."""
        plain, proposed = self.run(reading, "constant"), self.run(reading, "paper")
        return 1 - proposed.robot_rmse / plain.robot_rmse, 1 - proposed.landmark_rmse / plain.landmark_rmse

    def numbers(self) -> Numbers:
        """What claims are judged by: root mean square errors [m], shares and ratios; traces [m² + rad²]."""
        plain, proposed = self.run("prior", "constant"), self.run("prior", "paper")
        robot, landmark = self.relative_difference("prior")
        (robot_0, landmark_0), (robot_1, landmark_1) = PRINTED["constant"], PRINTED["paper"]
        constant_weights = {u.rule: u.landmark_rmse for u in self.unequal if u.weights == "constant"}
        named = [t for t in self.identities if t.exact]
        enough = [t for t in named if t.common >= 6]
        own = next(t for t in self.settled if (t.maps, t.delta) == ("the experiment's", self.cfg.delta))
        return {
            "local": [float(np.sqrt(np.mean(np.sum((self.maps.mean - self.local_truth()) ** 2, axis=-1))))],
            "merged": [plain.landmark_rmse, proposed.landmark_rmse],
            "robot": [robot],
            "robot_half": [robot / (1 - robot_1 / robot_0)],
            "landmark": [landmark],
            "landmark_half": [landmark / (1 - landmark_1 / landmark_0)],
            "unequal": [
                u.landmark_rmse / constant_weights[u.rule] for u in self.unequal if u.weights in {"paper", "full"}
            ],
            "falls": [float(np.mean(np.diff(r.trace) < 0)) for r in self.runs],
            "settles": [r.limit for r in self.runs],
            "closed": [float(np.median(own.printed))],
            "speed": [float(t.early.max()) for t in self.settled],
            "alignments": [t.aligned / t.trials for t in enough],
            "believed": [min(t.right / t.trials for t in enough)],
            "wrong": [float(sum(t.wrong for t in named))],
        }

    def table2(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Head and rows: errors in cm, the root mean square over all worlds and the spread between worlds."""
        head = ("weights", "reference", "robot [cm]", "spread", "paper", "landmark [cm]", "spread", "paper")
        rows: list[tuple[object, ...]] = []
        for r in self.runs:
            robot, landmark = (f"{100 * v:.3g}" for v in PRINTED[r.weights])
            ours = [f"{100 * v:.3f}" for v in (r.robot_rmse, r.robot.std(), r.landmark_rmse, r.landmark.std())]
            rows.append((NAMES[r.weights], r.reading, ours[0], ours[1], robot, ours[2], ours[3], landmark))
        return head, rows

    def trace_table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Head and rows of the trace of the global covariance after some updates; the paper only draws it."""
        head = ("step", "updates", *(f"{NAMES[r.weights]}, {r.reading}" for r in self.runs), "paper")
        rows: list[tuple[object, ...]] = [
            (self.cfg.drive_steps + k, k, *(f"{r.trace[k]:.3e}" for r in self.runs), "drawn") for k in SHOWN
        ]
        falls = ("yes" if (np.diff(r.trace) < 0).all() else "no" for r in self.runs)
        rows.append(("limit", "∞", *(f"{r.limit:.3e}" for r in self.runs), "drawn"))
        rows.append(("falls at every update", "", *falls, "yes"))
        rows.append(("settles above zero", "", *("yes" if r.limit > 0 else "no" for r in self.runs), "yes"))
        return head, rows

    def unequal_table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Head and rows for maps of unequal quality, each counted once: errors in cm and as a share of plain RLS's."""
        head = ("weights", "baseline", "landmark [cm]", "of RLS", "robot frame [cm]", "of RLS")
        plain = {u.rule: u for u in self.unequal if u.weights == "constant"}
        rows: list[tuple[object, ...]] = [
            (
                "eq. 14" if u.weights == "paper" else NAMES[u.weights],
                u.rule,
                f"{100 * u.landmark_rmse:.2f}",
                f"{u.landmark_rmse / plain[u.rule].landmark_rmse:.3f}",
                f"{100 * u.frame_rmse:.2f}",
                f"{u.frame_rmse / plain[u.rule].frame_rmse:.3f}",
            )
            for u in self.unequal
        ]
        return head, rows

    def honesty_table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        head = ("weights", "used", "NEES per degree of freedom", "which is")
        words = {("full", 1): "honest", ("paper", 1): "too cautious", ("full", 700): "overconfident"}
        rows: list[tuple[object, ...]] = [
            ("eq. 14" if w == "paper" else NAMES[w], f"{k} x", f"{v:.3f}", words[w, k])
            for (w, k), v in self.nees.items()
        ]
        return head, rows

    def local_table(self) -> Rows:
        """Head and rows: errors of the local maps in their own frames when the robots come to rest, in cm."""
        head = ("map", "landmarks [cm]", "worst world", "the filter's own deviation [cm]", "paper")
        e = np.linalg.norm(self.maps.mean - self.local_truth(), axis=-1)
        own = np.sqrt(np.trace(self.maps.cov, axis1=-2, axis2=-1) / 5)
        rows: list[tuple[object, ...]] = [
            (
                f"robot {k + 1} (Fig. {4 + k})",
                f"{100 * np.sqrt(np.mean(e[:, k] ** 2)):.3f}",
                f"{100 * np.sqrt(np.mean(e[:, k] ** 2, axis=-1)).max():.3f}",
                f"{100 * np.sqrt(np.mean(own[:, k] ** 2)):.3f}",
                "drawn",
            )
            for k in (0, 1)
        ]
        return head, rows

    def global_table(self) -> Rows:
        """Head and rows, map 1 the prior: each merged landmark's error in cm, and how far the weightings lie apart."""
        head = ("landmark", "seen by robot", "RLS [cm]", "proposed [cm]", "apart [cm]", "paper")
        plain, proposed = (self.run("prior", w).final.x[:, 3:].reshape(-1, 8, 2) for w in ("constant", "paper"))
        truth = self.worlds.landmarks
        columns = [100 * _rms(a - b) for a, b in ((plain, truth), (proposed, truth), (plain, proposed))]
        rows: list[tuple[object, ...]] = [
            (str(i + 1), " and ".join(str(k + 1) for k in (0, 1) if i in SEEN[k]), f"{a:.3f}", f"{b:.3f}", f"{c:.4f}",
             "drawn")
            for i, (a, b, c) in enumerate(zip(*columns, strict=True))
        ]  # fmt: skip
        return head, rows

    def settling_table(self) -> Rows:
        """Head and rows: how nearly k times the error of P_k is constant, under the paper's own prior."""
        head = (
            "maps",
            "δ",
            "k = 100 .. 10,000",
            "worst",
            "k = 1,000 .. 100,000",
            "worst",
            "left at k = 700",
            "worst",
        )
        rows: list[tuple[object, ...]] = [
            (
                t.maps,
                f"{t.delta:g}",
                *(f"{100 * f(v):.2g} %" for v in (t.early, t.late, t.left) for f in (np.median, np.max)),
            )
            for t in self.settled
        ]
        return head, rows

    def identities_table(self) -> Rows:
        """Head and rows: what came of trials without names."""
        head = ("in common", "told", "alignment right", "believed, right", "believed, wrong", "refused", "mostly for")
        rows: list[tuple[object, ...]] = [
            (t.common, "exact maps" if t.exact else "nothing", t.aligned, t.right, t.wrong, t.refused, t.reason or "-")
            for t in self.identities
        ]
        return head, rows

    def local_truth(self) -> Float[np.ndarray, "s 2 5 2"]:
        """The landmarks of either robot in its own frame."""
        start, points = self.worlds.start, self.worlds.landmarks
        own = se2.act(se2.inverse(start[:, 1])[:, None], points[:, SEEN[1]])
        return np.stack([points[:, SEEN[0]], own], axis=1)


def _rms(e: Float[np.ndarray, "s n 2"]) -> Float[np.ndarray, " n"]:
    """Root mean square length over the worlds, of each of n points."""
    return np.asarray(np.sqrt(np.mean(np.sum(e**2, axis=-1), axis=0)))
