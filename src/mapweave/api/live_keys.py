"""Certificates for a team that drives now."""

import datetime as dt
import math
from collections.abc import Sequence
from pathlib import Path

from ..core.errors import UsageError
from ..core.paths import path_arguments
from ..live.credentials import make_team
from ..live.messages import check_name

LONGEST = 3650.0  # [days] what the authority itself serves


@path_arguments
def live_keys(
    out: Path | str,
    *,
    robots: Sequence[str],
    maps: Sequence[str] = ("map", "view"),
    team: str = "team",
    days: float = 365.0,
) -> list[Path]:
    """Make a certificate authority for a live team, and a certificate for each of its processes; returns their folders.

    The authority stands in `out`, beside a folder a process with its certificate and the list of who may speak.
    Called again, it keeps what is there and adds to it: copy every folder to its process anew then, since everybody's
    list of names has grown.

    Parameters
    ----------
    out
        The folder of the authority.
    robots
        Names that may speak under themselves alone.
    maps
        Names of map processes and views, which may pass on what others say.
    team
        The team's name (team).
    days
        How long the certificates serve (365).
    """
    check_name(team, "--team")
    if not (math.isfinite(days) and 0 < days <= LONGEST):
        raise UsageError(f"--days: expected above 0 and at most {LONGEST:g}, found {days}")
    return make_team(Path(out), team, list(robots), list(maps), days, dt.datetime.now(dt.UTC))
