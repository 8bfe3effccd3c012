"""What every planner is given, how one is found by name, and how it is asked for commands that robots can follow."""

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.errors import EstimateError, MapweaveError, UsageError
from ..core.plugins import Planner, is_ours, load, plugged

SLACK = 1e-9  # a command may be beyond the limit by so much: rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamBelief:
    """What a team knows at one step, whatever its sensors; arrays are the run's own: read, never write.

    alive: (M,); stalled: (M,) steps since a robot last saw new ground; memory: a planner's scratch pad, kept between
    the calls of one run.
    """

    step: int
    robots: tuple[str, ...]
    alive: Bool[np.ndarray, " r"]
    stalled: Int[np.ndarray, " r"]
    memory: dict[str, Any]


def planners(sensor: str) -> tuple[str, ...]:
    """Names of the planners that are plugged in for robots with landmark cameras (`landmarks`) or `laser`s."""
    return tuple(name.removeprefix(f"{sensor}.") for name in plugged("planners") if name.startswith(f"{sensor}."))


def is_built_in(name: str, sensor: str) -> bool:
    """Whether a planner is this package's own."""
    found = plugged("planners").get(f"{sensor}.{name}")
    return found is not None and is_ours(found)


def find_planner(name: str, sensor: str) -> Planner:
    """The planner that is plugged in by `name`, or a user's own by dotted name `package.module:function`.

    Raises UsageError when it is neither.
    """
    found = plugged("planners").get(f"{sensor}.{name}")
    module, _, attribute = name.partition(":")
    if not attribute:
        module, _, attribute = name.rpartition(".")
    try:
        planner = getattr(import_module(module), attribute) if found is None else load(found)
    except UsageError:
        raise
    except Exception as error:  # whatever a module does when it is imported
        raise UsageError(
            f"planner {name!r}: not one of {', '.join(planners(sensor))} and not an importable module:function "
            f"({type(error).__name__}: {error})"
        ) from error
    if not callable(planner):
        raise UsageError(f"planner {name!r} is not a function choose(maps, poses, cfg)")
    return planner  # type: ignore[no-any-return]


def query_planner(
    planner: Callable[..., Any],
    belief: TeamBelief,
    poses: Float[np.ndarray, "r 3"],
    cfg: Any,
    limits: tuple[float, float],
) -> Float[np.ndarray, "r 2"]:
    """The planner's commands (M, 2) for `belief`, a copy. limits: the highest speed [m/s] and turn rate [rad/s].

    Raises EstimateError that names step and robot when they are no commands, and step and line when the planner fails.
    """
    try:
        answer = planner(belief, poses, cfg)
    except MapweaveError:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}:{at.lineno}"
        what = f"{type(error).__name__}: {str(error).strip() or 'no message'}".splitlines()[0]
        raise EstimateError(f"step {belief.step}: the planner failed at {where}: {what}") from error
    wanted = (len(belief.robots), 2)
    try:
        u = np.array(answer, dtype=float)
    except (TypeError, ValueError):
        kind = type(answer).__name__
        raise EstimateError(f"step {belief.step}: the planner returned {kind}, expected numbers {wanted}") from None
    if u.shape != wanted:
        raise EstimateError(f"step {belief.step}: the planner returned shape {u.shape}, expected {wanted}")
    live = np.flatnonzero(belief.alive)
    bad = [belief.robots[j] for j in live if not np.isfinite(u[j]).all()]
    if bad:
        raise EstimateError(f"step {belief.step}: the planner's command for {', '.join(bad)} is not a finite number")
    top, turn = limits
    wild = [belief.robots[j] for j in live if abs(u[j, 0]) > top + SLACK or abs(u[j, 1]) > turn + SLACK]
    if wild:
        raise EstimateError(
            f"step {belief.step}: command for {', '.join(wild)} is beyond {top:g} m/s or {turn:.3g} rad/s"
        )
    return u
