"""Real processes of a team on this machine, and what they leave behind."""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ..forked import Forked

COMMAND = (sys.executable, "-m", "mapweave", "live")  # for those that another command starts

PORTS = range(20_000, 30_000)  # below those that a system gives to who asks for any
HELD: list[int] = []  # locks


def free_endpoint() -> str:
    """An endpoint that nobody listens at, and that no other test on this machine is told while this process lives.

    It may be closed and opened again meanwhile: connections that go out never take a port of these.
    """
    folder = Path(tempfile.gettempdir(), f"mapweave-test-ports-{os.getuid()}")
    folder.mkdir(exist_ok=True)
    first = os.getpid() * 37 % len(PORTS)
    for port in (*PORTS[first:], *PORTS[:first]):
        lock = os.open(folder / str(port), os.O_CREAT | os.O_RDWR)
        with socket.socket() as s:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                s.bind(("127.0.0.1", port))
            except OSError:
                os.close(lock)
                continue
        HELD.append(lock)
        return f"tcp/127.0.0.1:{port}"
    raise RuntimeError("no port is free")


class Fleet:
    """Processes of one team in `folder`; a map process listens and the others connect to it."""

    def __init__(self, folder: Path, source: Path, prefix: dict[str, list[str]] | None = None) -> None:
        self.folder, self.source, self.at = folder, source, free_endpoint()
        self.prefix = prefix or {}
        self.running: dict[str, subprocess.Popen | Forked] = {}
        self.more: list[str] = []

    def start(self, name: str, *words: str) -> subprocess.Popen | Forked:
        log, words = self.folder / f"{name}.log", (*words, *self.more)
        if name in self.prefix:
            command, env = [*self.prefix[name], *COMMAND, *words], {**os.environ, "PYTHONUNBUFFERED": "1"}
            with log.open("a") as said:
                process = subprocess.Popen(command, cwd=self.folder, stdout=said, stderr=subprocess.STDOUT, env=env)  # noqa: S603
        else:
            process = Forked(["live", *words], self.folder, log)
        self.running[name] = process
        return process

    def map(self, *words: str, robots="r1,r2", name="map"):
        return self.start(
            name, "map", "--out", f"out-{name}", "--name", name, "--robots", robots, "--listen", self.at, *words
        )

    def robot(self, name: str, *words: str, rate="20", linger="60"):
        where = [] if "--connect" in words else ["--connect", self.at]
        return self.start(
            name,
            "robot",
            "--name",
            name,
            "--source",
            str(self.source),
            "--rate",
            rate,
            "--linger",
            linger,
            *where,
            *words,
        )

    def kill(self, name: str) -> None:
        self.running[name].send_signal(signal.SIGKILL)
        self.running[name].wait()

    def interrupt(self, name: str) -> None:
        self.running[name].send_signal(signal.SIGINT)

    def wait(self, name: str, timeout=240) -> int:
        try:
            return self.running[name].wait(timeout)
        except subprocess.TimeoutExpired:
            told = "\n".join(f"{n}: {self.said(n)}" for n in self.running)
            raise AssertionError(f"{name} does not end\n{told}") from None

    def said(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def hears(self, name: str, words: str, timeout=240) -> None:
        """Wait until the process has said so."""
        end = time.monotonic() + timeout
        while words not in self.said(name):
            assert time.monotonic() < end, f"{name} never said {words!r}: {self.said(name)}"
            assert self.running[name].poll() is None, f"{name} ended: {self.said(name)}"
            time.sleep(0.05)

    def end(self) -> None:
        for process in self.running.values():
            if process.poll() is None:
                process.kill()
                process.wait()


def same_result(a: Path, b: Path, *, but: tuple[str, ...] = ()) -> None:
    """Both folders hold the same files, to the byte; how long each stage took is left out, and what `but` names."""
    names = sorted(p.relative_to(a) for p in a.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(b) for p in b.rglob("*") if p.is_file())
    for name in (name for name in names if str(name) not in but):
        first, second = (without_timing(folder / name) for folder in (a, b))
        assert first == second, name


def without_timing(path: Path) -> bytes:
    data = path.read_bytes()
    return data.split(b'"timing"')[0] if path.name == "metrics.json" else data
