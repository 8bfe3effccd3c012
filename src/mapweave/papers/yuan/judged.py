"""The figures of `reproduce yuan` that stand beside the paper's claims, and the numbers that these are judged by."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..verdicts import Numbers
from .experiments import PRINTED, Outcome, robots_told

if TYPE_CHECKING:
    from .reproduce import YuanReproduction

NEIGHBOURS = ("two robots, calibrated noise, nn", "two robots, calibrated noise, nn as printed")


def measured(r: "YuanReproduction") -> Mapping[str, str]:
    """By the names of the claims, in words."""
    two, one = (r.get("table1", f"{robots_told(k)}, calibrated noise") for k in (2, 1))
    printed = r.get("table1", "two robots, printed noise")
    near, plain_nn = (r.get("table1", name) for name in NEIGHBOURS)
    dead = r.get("ablation", "one of two dead after 100 steps")
    apart, whole = r.get("ablation", "no distance to others"), r.get("ablation", "whole objective")
    careless = r.get("ablation", "no accuracy")

    def steps(o: Outcome) -> str:
        return str(o.row()[3])

    def accuracy(o: Outcome) -> str:
        return f"{o.mean('map_error'):.3f} m, {o.mean('c_per_n'):.3f} m²"

    return {
        "runs": str(len(two.runs)),
        "few": str(len(dead.runs)),
        "all": f"{two.finished} and {one.finished} of {len(two.runs)}",
        "steps_two": steps(two),
        "accuracy_two": accuracy(two),
        "printed_noise": f"{printed.mean('map_error'):.1f} m",
        "steps_one": steps(one),
        "accuracy_one": accuracy(one),
        "efficiency": f"{_ratio(one, two, 'steps'):.2f} times the steps",
        "accuracy": f"error {_ratio(one, two, 'map_error'):.2f} times, C/N {_ratio(one, two, 'c_per_n'):.2f} times",
        "neighbour": f"as printed {accuracy(plain_nn)}, NEES/dof {plain_nn.mean('nees_per_dof'):.1f}, "
        f"{plain_nn.count('misassociations')} wrong matches; only sure matches {accuracy(near)}, "
        f"{near.mean('nees_per_dof'):.2f}, {near.count('misassociations')}",
        "area": "; ".join(f"{row[0]}: {row[3]} times" for row in r.like_for_like()[1][:2]),
        "escape": f"{r.get('ablation', 'whole objective, no escape').finished} of {len(dead.runs)} finish without it",
        "careful": f"{accuracy(whole)} with it, {accuracy(careless)} without",
        "independent": f"to the bit (test); the map's NEES/dof {whole.mean('nees_per_dof'):.2f}",
        "apart": f"{_ratio(apart, whole, 'steps'):.2f} times the steps without it",
        "dead": f"{dead.finished} of {len(dead.runs)} finish, NEES/dof {dead.mean('nees_per_dof'):.2f}",
        "drawn": "drawn",
    }


def numbers(r: "YuanReproduction") -> Numbers:
    """By the names of the rules: ratios, shares of runs, NEES per degree of freedom."""
    two, one = (r.get("table1", f"{robots_told(k)}, calibrated noise") for k in (2, 1))
    noisy = r.get("table1", "two robots, printed noise")
    near = [r.get("table1", name) for name in NEIGHBOURS]
    whole, dead = r.get("ablation", "whole objective"), r.get("ablation", "one of two dead after 100 steps")
    plain, printed = "whole objective", "whole objective, escape as printed"
    blind = [r.get("ablation", name) for name in ("no area", "no area, escape as printed")]
    return {
        "finished": [_finished(o) for o in (two, one)],
        "steps_two": _steps(two),
        "steps_one": _steps(one),
        "accuracy_two": _accuracy(two),
        "accuracy_one": _accuracy(one),
        "printed_noise": _accuracy(noisy),
        "efficiency": [_ratio(one, two, "steps")],
        "accuracy": [_ratio(one, two, what) for what in ("map_error", "c_per_n")],
        "neighbour_nees": [o.mean("nees_per_dof") for o in near],
        "neighbour_error": [_ratio(o, whole, "map_error") for o in near],
        "area_steps": [
            _ratio(o, r.get("ablation", name), "steps") for o, name in zip(blind, (plain, printed), strict=True)
        ],
        "area_stuck": [1.0 - _finished(o) for o in blind],
        "escape": [1.0 - _finished(r.get("ablation", "whole objective, no escape"))],
        "apart": [_ratio(r.get("ablation", "no distance to others"), whole, "steps")],
        "careful": [_ratio(r.get("ablation", "no accuracy"), whole, what) for what in ("map_error", "c_per_n")],
        "dead_finished": [_finished(dead)],
        "dead_nees": [dead.mean("nees_per_dof")],
    }


def _ratio(a: Outcome, b: Outcome, what: str) -> float:
    return a.mean(what) / b.mean(what)


def _finished(o: Outcome) -> float:
    return o.finished / len(o.runs)


def _steps(o: Outcome) -> list[float]:
    """Least, most and mean steps over the printed ones."""
    steps = [r.steps for r in o.runs]
    got = (min(steps), max(steps), o.mean("steps"))
    return [a / b for a, b in zip(got, PRINTED[o.case.robots][:3], strict=True)]


def _accuracy(o: Outcome) -> list[float]:
    """Map error and C/N over the printed ones."""
    return [o.mean(what) / p for what, p in zip(("map_error", "c_per_n"), PRINTED[o.case.robots][3:], strict=True)]
