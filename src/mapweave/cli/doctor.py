"""`mapweave doctor`."""

from typing import Annotated

from cyclopts import Parameter


def doctor(*, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """Say what mapweave runs on: versions, extras, cores, compiled kernels; exit 1 when something is wrong.

    Parameters
    ----------
    json
        Print JSON.
    """
    from ..api.doctor import doctor as examine
    from .terminal import say

    diagnosis = examine()
    if json:
        from json import dumps

        say(dumps(diagnosis.metrics, indent=1))
    else:
        say(diagnosis.summary())
    if not diagnosis.healthy:
        raise SystemExit(1)
