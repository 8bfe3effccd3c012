"""A planner is asked for commands, and what it answers is one that robots can follow or an error that says why not."""

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.errors import EstimateError, MapweaveError

SLACK = 1e-9  # a command may be beyond the limit by so much: rounding


def ask(
    planner: Callable[..., Any], view: Any, poses: Float[np.ndarray, "r 3"], cfg: Any, limits: tuple[float, float]
) -> Float[np.ndarray, "r 2"]:
    """The planner's commands (M, 2) for `view`, a copy. limits: the highest speed [m/s] and turn rate [rad/s].

    Raises EstimateError that names step and robot when they are no commands, and step and line when the planner fails.
    """
    try:
        told = planner(view, poses, cfg)
    except MapweaveError:
        raise
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(at.filename).name}:{at.lineno}"
        what = f"{type(error).__name__}: {str(error).strip() or 'no message'}".splitlines()[0]
        raise EstimateError(f"step {view.step}: the planner failed at {where}: {what}") from error
    wanted = (len(view.robots), 2)
    try:
        u = np.array(told, dtype=float)
    except (TypeError, ValueError):
        kind = type(told).__name__
        raise EstimateError(f"step {view.step}: the planner returned {kind}, expected numbers {wanted}") from None
    if u.shape != wanted:
        raise EstimateError(f"step {view.step}: the planner returned shape {u.shape}, expected {wanted}")
    live = np.flatnonzero(view.alive)
    bad = [view.robots[j] for j in live if not np.isfinite(u[j]).all()]
    if bad:
        raise EstimateError(f"step {view.step}: the planner's command for {', '.join(bad)} is not a finite number")
    top, turn = limits
    wild = [view.robots[j] for j in live if abs(u[j, 0]) > top + SLACK or abs(u[j, 1]) > turn + SLACK]
    if wild:
        raise EstimateError(
            f"step {view.step}: command for {', '.join(wild)} is beyond {top:g} m/s or {turn:.3g} rad/s"
        )
    return u
