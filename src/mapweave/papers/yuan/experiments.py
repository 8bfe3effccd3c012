"""What `reproduce yuan` runs: the paper's experiment, its objective taken apart, and the planners that go beyond it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import ellipe

from ...exploration.landmarks.config import ExploreConfig, HandoverConfig, MissionConfig, ObjectiveConfig, find_scenario
from ...exploration.landmarks.experiment import CALIBRATED, PRINTED_SD, LandmarkMission, LandmarkRunScore, explore_once
from ...fusion.handover import PairingConfig
from ...report.result import Rows

# The paper's Table 1: steps min, max, mean, map error [m], uncertainty [m^2].
PRINTED = {2: (208, 371, 296, 0.282, 0.327), 1: (310, 705, 503, 0.361, 0.490)}
HEAD = (
    "", "seeds", "finished", "steps min / max / mean", "map error [m]", "C/N [m²]", "NEES/dof", "NEES/dof, worst",
    "wrong matches", "kept twice",
)  # fmt: skip
# settings under which nothing lets a robot out of where it gains nothing
NO_ESCAPE: dict[str, Any] = {"escape_uncertainty": -1.0, "stall_steps": 10**9}
THIRD = 1 / 3  # of the paper's 30 runs: enough to tell what is large
RUNS = 30  # of every case, as printed; some have a share of these
FEW = 5  # runs of what is told from chance by few, where fewer are asked for
UNSEEN = 100  # the first of the seeds that nothing was chosen on
# Noise of position [m] and of turning [rad] a step: 0.035 of the printed; a fifth of it with little turning, with none.
NOISES = ((0.0105, 0.00175), (0.06, 0.001), (0.06, 0.0))


@dataclass(frozen=True, slots=True)
class Case:
    """One row: what is run, with seeds from where, and what share of the paper's 30 runs."""

    group: str
    name: str
    mission: LandmarkMission
    first_seed: int = 0
    share: float = 1.0

    @property
    def robots(self) -> int:
        return self.mission.robots or 2


@dataclass(frozen=True, slots=True)
class YuanScore(LandmarkRunScore):
    """The score of a run, with what its map expects to err by.

    expected_error: the mean distance [m] of landmarks to the truth by the map's own covariance. It has none of the luck
    of one run's noise: over few runs it tells maps apart that measured errors do not.
    """

    expected_error: float | None = None


def score_seed(mission: LandmarkMission, seed: int, run: int) -> YuanScore:
    """How the run of `seed` ended."""
    score, record = explore_once(mission, seed, run)
    return YuanScore(**asdict(score), expected_error=expected_error(record.map.landmarks.cov))


def expected_error(cov: Float[np.ndarray, "n n"]) -> float | None:
    """Mean distance [m] of landmarks to the truth that their covariance expects; None of none."""
    n = len(cov) // 2
    if n == 0:
        return None
    values = [np.linalg.eigvalsh(cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]) for i in range(n)]
    least, most = np.maximum(np.array(values), 0.0).T
    flat = 1.0 - np.divide(least, most, out=np.ones(n), where=most > 0.0)
    return float(np.mean(np.sqrt(2.0 / np.pi * most) * ellipe(flat)))


@dataclass(frozen=True, slots=True)
class Outcome:
    """A case and the score of its every run."""

    case: Case
    runs: tuple[YuanScore, ...]

    def mean(self, what: str) -> float:
        """Mean over the runs that have it; NaN where none has."""
        values = [v for r in self.runs if (v := getattr(r, what)) is not None]
        return float(np.mean(values)) if values else float("nan")

    @property
    def finished(self) -> int:
        return sum(bool(r.finished) for r in self.runs)

    @property
    def worst_nees(self) -> float:
        return max((r.nees_per_dof for r in self.runs if r.nees_per_dof is not None), default=float("nan"))

    def row(self) -> tuple[object, ...]:
        """Under `HEAD`."""
        steps, first = [r.steps for r in self.runs], self.runs[0].seed
        shown = (self.mean("map_error"), self.mean("c_per_n"), self.mean("nees_per_dof"), self.worst_nees)
        return (
            self.case.name,
            f"{first}-{first + len(self.runs) - 1}",
            f"{self.finished}/{len(self.runs)}",
            f"{min(steps)} / {max(steps)} / {np.mean(steps):.0f}",
            *(round(v, 3) if np.isfinite(v) else None for v in shown),
            self.count("misassociations"),
            self.count("duplicates"),
        )

    def interval(self, what: str) -> tuple[float, float]:
        """Between which 95 % of the means lie when the runs are drawn anew from those there are."""
        values = self.values(what)
        draws = np.random.default_rng(0).integers(len(values), size=(4000, len(values)))
        low, high = np.quantile(values[draws].mean(axis=1), (0.025, 0.975))
        return float(low), float(high)

    def values(self, what: str) -> Float[np.ndarray, " runs"]:
        """Of each run, NaN where it has none."""
        told = [getattr(r, what) for r in self.runs]
        return np.array([np.nan if v is None else v for v in told], dtype=float)

    def change(self, before: "Outcome", what: str) -> tuple[float, float]:
        """By how much the mean is more than that of `before` over the same seeds, and the standard error of that."""
        more = self.values(what) - before.values(what)[: len(self.runs)]
        return float(more.mean()), float(more.std(ddof=1) / np.sqrt(len(more)))

    def count(self, what: str) -> int:
        """Sum over the runs."""
        return sum(int(getattr(r, what) or 0) for r in self.runs)


def cases(*, quick: bool = False) -> tuple[Case, ...]:
    """Everything that is run, in the order of the tables; quick: on fewer runs, but for some rows.

    Two of Table 1 are judged by their shortest and longest run, which fewer runs do not tell, and those of nearest
    neighbours by their error beside that of the whole objective, which on five runs comes out on the other side.
    """
    every = (*_table_1(), *_turning(), *_ablation(), *_seen(), *_unseen(), *_stability())
    if not quick:
        return every
    changed = {planner: f"{planner}.{key} x 0.99" for planner, key in STABILITY[::-1]}  # one constant a planner
    return tuple(
        replace(case, share=_fewer(case))
        for case in every
        if case.group != "stability" or case.name in changed.values()
    )


def _fewer(case: Case) -> float:
    """The share of runs that does for the word on a claim, least where none is judged by the case."""
    if case.group == "table1" and (case.share == 1.0 or ", nn" in case.name):
        return case.share
    if case.group == "ablation" and "escape" not in case.name:  # nearest neighbours are judged beside it
        return case.share
    return FEW / RUNS if case.group in {"table1", "ablation", "unseen"} else 2 / RUNS


def _table_1() -> list[Case]:
    near = run(association="nn")
    return [
        Case("table1", name, mission, share=share)
        for name, mission, share in (
            ("two robots, printed noise", run(1.0), THIRD),
            ("two robots, calibrated noise", run(), 1.0),
            ("two robots, calibrated noise, nn", near, THIRD),
            ("two robots, calibrated noise, nn as printed", plain_neighbour(near), THIRD),
            ("one robot, printed noise", run(1.0, robots=1), THIRD),
            ("one robot, calibrated noise", run(robots=1), 1.0),
        )
    ]


def _turning() -> list[Case]:
    """The same experiment with more of the noise in position and less in turning."""
    return [
        Case("turning", noise_told(robots, *sd), moving(run(robots=robots), *sd), share=THIRD)
        for sd in NOISES
        for robots in (2, 1)
    ]


def _ablation() -> list[Case]:
    long = 3000
    printed: dict[str, Any] = {"negligible_gain": 0}
    told = (
        ("whole objective", run()),
        ("no accuracy", run(w_accuracy=0.0)),
        ("no distance to others", run(w_apart=0.0)),
        ("no area", run(w_area=0.0, max_steps=long)),
        ("whole objective, escape as printed", run(**printed, max_steps=long)),
        ("no area, escape as printed", run(w_area=0.0, **printed, max_steps=long)),
        ("whole objective, no escape", run(**NO_ESCAPE)),
        ("no area, no escape", run(w_area=0.0, **NO_ESCAPE)),
        ("printed escape alone, printed noise", run(1.0, handover_by=10**9, literal_escape=True, **printed)),
        ("one of two dead after 100 steps", replace(run(), kills={1: 100})),
    )
    return [Case("ablation", name, mission, share=THIRD) for name, mission in told]


def _seen() -> list[Case]:
    told = (
        ("coverage", run(planner="coverage"), 1.0),
        ("loop", run(planner="loop"), 1.0),
        ("loop, jcbb", run(planner="loop", association="jcbb"), THIRD),
        ("joint", run(planner="joint"), 1.0),
        ("joint, jcbb", run(planner="joint", association="jcbb"), THIRD),
        ("joint, one robot", run(planner="joint", robots=1), THIRD),
        ("joint, 296 steps", run(planner="joint", until=296), THIRD),
    )
    return [Case("seen", name, mission, share=share) for name, mission, share in told]


def _unseen() -> list[Case]:
    told = (*((p, run(planner=p)) for p in ("coverage", "loop", "joint")), *JUDGED)
    return [Case("unseen", name, mission, UNSEEN, 2.0) for name, mission in told]


def _stability() -> list[Case]:
    """Constants of the planners 1 % lower and higher, on the seeds nothing was chosen on."""
    out = []
    for planner, key in STABILITY:
        for factor in (0.99, 1.01):
            mission = run(planner=planner)
            part = getattr(mission.cfg, planner)
            part = replace(part, **{key: factor * getattr(part, key)})
            changed = replace(mission, cfg=replace(mission.cfg, **{planner: part}))
            out.append(Case("stability", f"{planner}.{key} x {factor:g}", changed, UNSEEN, 0.5))
    return out


STABILITY = (
    ("coverage", "rate"),
    ("coverage", "error_weight"),
    ("coverage", "tour_radius"),
    ("loop", "rate"),
    ("joint", "rate"),
    ("joint", "error_weight"),
)


def run(
    factor: float = CALIBRATED,
    *,
    planner: str = "paper",
    robots: int = 2,
    until: str | int = "landmarks",
    association: str = "known",
    handover_by: int = 60,
    max_steps: int = 1000,
    **objective: Any,
) -> LandmarkMission:
    """The paper's experiment with these settings; factor: on the printed standard deviations of motion."""
    base = ExploreConfig()
    x, y, turn = PRINTED_SD
    cfg = replace(
        base,
        mission=MissionConfig(max_steps=max_steps),
        objective=ObjectiveConfig(**objective),
        handover=HandoverConfig(by=handover_by),
        submap=replace(base.submap, association=association, motion_sd=(factor * x, factor * y, factor * turn)),
    )
    return LandmarkMission(find_scenario("yuan"), robots, planner, until, cfg=cfg)


def moving(mission: LandmarkMission, position: float, turn: float) -> LandmarkMission:
    """`mission` with other motion noise a step: position [m], turn [rad], in the world and in the filter alike."""
    submap = replace(mission.cfg.submap, motion_sd=(position, position, turn))
    return replace(mission, cfg=replace(mission.cfg, submap=submap))


def plain_neighbour(mission: LandmarkMission) -> LandmarkMission:
    """`mission` with every nearest neighbour inside a gate of 0.99 believed, at hand-over what is likelier than not."""
    submap = replace(mission.cfg.submap, gate=9.21, sure=0.0)
    handover = replace(mission.cfg.handover, pairing=PairingConfig(sure=0.5))
    return replace(mission, cfg=replace(mission.cfg, submap=submap, handover=handover))


def robots_told(n: int) -> str:
    return "one robot" if n == 1 else "two robots"


def noise_told(robots: int, position: float, turn: float) -> str:
    """The name of a case of the group `turning`."""
    return f"{robots_told(robots)}, {position:g} m and {turn:g} rad a step"


JUDGED = (  # by the same seeds
    ("the paper's planner", run()),
    ("loop, jcbb", run(planner="loop", association="jcbb")),
)


# [steps], map error [m] and c_per_n that each planner should reach, None where none is asked
GOALS = {"joint": (180.0, 0.282, 0.18), "coverage": (195.0, 0.33, None), "loop": (None, 0.30, None)}
SHARE = 0.01  # of a mean, which a constant 1 % off may move it by and count as stable
CHANGED = ("steps", "map_error", "expected_error")  # what a constant 1 % off is told to change


def goals(outcomes: Sequence[Outcome]) -> Rows:
    """What the planners should reach on seeds that nothing was chosen on, and what they do.

    expected: the error by the maps' own covariance, which has none of the luck of the noise drawn.
    """
    head = (
        "planner, two robots", "seeds", "steps", "goal", "map error [m]", "goal", "C/N [m²]", "goal",
        "steps, 95 % of means", "map error, 95 % of means", "map error expected [m]", "",
    )  # fmt: skip
    rows: list[tuple[object, ...]] = []
    for name, wanted in GOALS.items():
        o = _unseen_outcome(outcomes, name)
        got = (o.mean("steps"), o.mean("map_error"), o.mean("c_per_n"))
        missed = [
            what for what, g, w in zip(("steps", "error", "C/N"), got, wanted, strict=True) if w is not None and g > w
        ]
        cells = [
            cell
            for g, w, digits in zip(got, wanted, (0, 3, 3), strict=True)
            for cell in (f"{g:.{digits}f}", "" if w is None else f"≤ {w:g}")
        ]
        steps, errors = o.interval("steps"), o.interval("map_error")
        spread = (f"{steps[0]:.0f} to {steps[1]:.0f}", f"{errors[0]:.3f} to {errors[1]:.3f}")
        verdict = "missed: " + ", ".join(missed) if missed else "reached"
        rows.append((name, o.row()[1], *cells, *spread, f"{o.mean('expected_error'):.3f}", verdict))
    return head, rows


def changes(outcomes: Sequence[Outcome]) -> Rows:
    """What a constant 1 % off changes, run by run on the same seeds, and what of it is beyond two standard errors."""
    head = ("constant", "runs", "mean steps", "map error [m]", "map error expected [m]", "beyond two standard errors")
    rows: list[tuple[object, ...]] = []
    for o in _changed(outcomes):
        before = as_it_is(outcomes, _planner(o))
        told = [o.change(before, what) for what in CHANGED]
        beyond = [what for (by, error), what in zip(told, head[2:5], strict=True) if abs(by) > 2.0 * error]
        steps, *errors = told
        cells = (f"{steps[0]:+.1f} ± {steps[1]:.1f}", *(f"{by:+.3f} ± {error:.3f}" for by, error in errors))
        rows.append((o.case.name, len(o.runs), *cells, ", ".join(beyond) or "nothing"))
    return head, rows


def moved(outcomes: Sequence[Outcome]) -> tuple[str, str, int]:
    """Of which planners steps or map error move by more than `SHARE` at some constant 1 % off, and of which by less.

    In words, each with its largest mean change; and over how many runs.
    """
    more: list[str] = []
    less: list[str] = []
    changed = _changed(outcomes)
    for planner, (goal, *_) in GOALS.items():
        before = as_it_is(outcomes, planner)
        for what, digits, unit in (("steps", 1, "steps"), ("map_error", 3, "m")):
            tried = [(*o.change(before, what), o) for o in changed if _planner(o) == planner]
            by, error, worst = max(tried, key=lambda told: abs(told[0]))
            mean = before.mean(what)
            asked = f", goal {goal:g}" if what == "steps" and goal is not None else ""
            told = (
                f"{what.replace('_', ' ')} of {planner} ({worst.case.name}: {by:+.{digits}f} ± {error:.{digits}f} of "
                f"{mean:.{digits}f} {unit}{asked})"
            )
            (more if abs(by) > SHARE * mean else less).append(told)
    return ", ".join(more) or "none", ", ".join(less) or "none", len(changed[0].runs)


def as_it_is(outcomes: Sequence[Outcome], planner: str, name: str = "") -> Outcome:
    """What `planner` comes to with no constant changed, on the seeds on which its constants are."""
    runs = next(len(o.runs) for o in _changed(outcomes) if _planner(o) == planner)
    o = _unseen_outcome(outcomes, planner)
    return Outcome(replace(o.case, name=name), o.runs[:runs])


def _unseen_outcome(outcomes: Sequence[Outcome], name: str) -> Outcome:
    return next(o for o in outcomes if (o.case.group, o.case.name) == ("unseen", name))


def _changed(outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.case.group == "stability"]


def _planner(o: Outcome) -> str:
    """Whose constant a case changes: it is named `planner.constant x factor`."""
    return o.case.name.partition(".")[0]
