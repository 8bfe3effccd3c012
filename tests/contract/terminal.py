"""The command line as a program would call it."""

import io
from contextlib import redirect_stderr, redirect_stdout

import pytest

from mapweave.cli import main


def run(*words):
    """Exit status, stdout and stderr of the command line, in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as end:
        main([str(w) for w in words])
    return end.value.code, out.getvalue(), err.getvalue()
