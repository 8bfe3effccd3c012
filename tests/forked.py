"""Processes of the command line that begin with everything imported: importing takes longer than most of them work."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

from mapweave.report import style

FORKS = get_context("forkserver")
FORKS.set_forkserver_preload(["mapweave.cli.commands", "mapweave.api.live"])


class Forked:
    """`python -m mapweave WORDS` in `folder`, which says everything into the file `log`; like a `subprocess.Popen`.

    Where this test saves a dot for each figure, so does the process.
    """

    def __init__(self, words: list[str], folder: Path, log: Path) -> None:
        log.touch()
        self._process = FORKS.Process(
            target=_command, args=(words, folder, log, dict(os.environ), style.save), daemon=True
        )
        self._process.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired("mapweave", timeout)
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _command(words: list[str], folder: Path, log: Path, environ: dict[str, str], save: Callable) -> None:
    from mapweave.cli import main

    style.save = save
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environ)
    said = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number, stream in enumerate((sys.stdout, sys.stderr), 1):
        os.dup2(said, number)
        stream.reconfigure(line_buffering=True)
    main(words)
