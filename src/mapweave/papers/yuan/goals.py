"""How far the planners beyond the paper get on seeds that nothing was chosen on, and what hangs on a constant."""

from collections.abc import Sequence
from dataclasses import replace

from ...report.result import Rows
from .experiments import Outcome

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
        o = _unseen(outcomes, name)
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
    o = _unseen(outcomes, planner)
    return Outcome(replace(o.case, name=name), o.runs[:runs])


def _unseen(outcomes: Sequence[Outcome], name: str) -> Outcome:
    return next(o for o in outcomes if (o.case.group, o.case.name) == ("unseen", name))


def _changed(outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.case.group == "stability"]


def _planner(o: Outcome) -> str:
    """Whose constant a case changes: it is named `planner.constant x factor`."""
    return o.case.name.partition(".")[0]
