"""The demo's processes: where the map process listens, and what it says."""

import subprocess
import sys

import pytest

from mapweave.api.live_demo import _passed_on
from mapweave.core.errors import EstimateError


def saying(*lines):
    return subprocess.Popen([sys.executable, "-c", f"print({chr(10).join(lines)!r})"], stdout=subprocess.PIPE)  # noqa: S603


def test_where_the_map_process_listens_is_heard_of_it_and_the_rest_is_said_on():
    heard = []
    with saying("first", "map: listening at tcp/127.0.0.1:4321", "map: heard", "r1: joined") as process:
        at, hearing = _passed_on(process, heard.append)
        hearing.join()
    assert at == "tcp/127.0.0.1:4321"
    assert heard == ["first", "map: heard", "r1: joined"]


def test_a_map_process_that_never_listens_is_told():
    heard = []
    with (
        saying("out: exists and is not a directory") as process,
        pytest.raises(EstimateError, match="ended before it listened"),
    ):
        _passed_on(process, heard.append)
    assert heard == ["out: exists and is not a directory"]
