"""A simulated team that drives now, mapped and shown: every part a process of its own."""

import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread
from typing import Literal

from ..core.errors import EstimateError, UsageError
from ..core.names import in_order
from ..io.directory import check_target
from ..live.laser_team import compile_kernels
from ..live.transport import LISTENING
from .simulate import simulate_landmarks

Say = Callable[[str], None]
MINUTES = 4.0  # [min] of driving among landmarks that are simulated
OFFICE_SECONDS = 190.0  # that a round through the office takes
PATIENCE = 15.0  # [s] for processes that were asked to end


def live_demo(
    out: Path | str = "live-demo",
    *,
    robots: int = 3,
    world: Literal["landmarks", "office"] = "landmarks",
    seconds: float = 45.0,
    port: int = 8642,
    seed: int = 0,
    force: bool = False,
    stop: Event | None = None,
    say: Say = print,
) -> None:
    """Simulate a team, let each robot drive in a process, map it in another and show it in a browser; `out` is written.

    Parameters
    ----------
    out
        The folder of the result.
    robots
        How many drive (3).
    world
        Among landmarks with cameras, or through an office with lasers.
    seconds
        How long they drive, by the clock (45).
    port
        Where the page stands (8642).
    seed
        Of the simulated world (0).
    force
        Write into `out` even when something other than a result stands there.
    stop
        Ends it early, with a whole result.
    say
        Called with a line where something happens.
    """
    if not 1 <= robots <= 20:
        raise UsageError(f"--robots: expected 1 to 20, found {robots}")
    if not 5 <= seconds <= 3600:
        raise UsageError(f"--seconds: expected 5 to 3600, found {seconds}")
    out = Path(out)
    check_target(out, force=force)
    stop = stop or Event()
    with tempfile.TemporaryDirectory(prefix="mapweave-live-") as home, ExitStack() as ending:
        folder = Path(home)
        if world == "office":
            say("kernels are compiled first, for a minute or more where that was never done on this machine")
            compile_kernels(folder / "compiled.sqlite")
        source, rate = "sim:office", OFFICE_SECONDS / seconds
        names = [f"r{k}" for k in range(1, robots + 1)]
        docked = [f"--start={name}=0,0,0" for name in names] if world == "office" else []
        mapping = _start(
            "map", *docked, "--out", str(out.absolute()), "--robots", ",".join(names), "--listen", "tcp/127.0.0.1:0",
            "--team", "demo", "--store", str(folder / "map.sqlite"), *(["--force"] if force else []), heard=True,
        )  # fmt: skip
        ending.enter_context(mapping)
        ending.callback(_end, mapping)
        if world == "landmarks":
            simulate_landmarks(folder / "team", robots=robots, minutes=MINUTES, seed=seed)
            source, rate = str(folder / "team"), 60 * MINUTES / seconds
        at, hearing = _passed_on(mapping, say)
        where = ["--connect", at, "--team", "demo"]
        others = {"view": _start("view", "--port", str(port), *where)}
        for name in names:
            words = ["--name", name, "--source", source, "--history", str(folder / f"{name}.sqlite")]
            others[name] = _start("robot", *words, "--rate", f"{rate:g}", "--seed", str(seed), *where)
        for process in others.values():
            ending.callback(_end, process)
        say(f"watch it at http://127.0.0.1:{port}/ ({seconds:g} s)")
        _wait(mapping, others, stop)
        hearing.join()
        if mapping.returncode:
            raise EstimateError("the map process ended without a result")


def _wait(mapping: subprocess.Popen[bytes], others: dict[str, subprocess.Popen[bytes]], stop: Event) -> None:
    """Until the map is written; raises UsageError when a process that should be there failed."""
    asked = False
    while mapping.poll() is None:
        if stop.wait(0.2) and not asked:
            asked = True
            mapping.send_signal(signal.SIGINT)
        for name in sorted(others, key=in_order):
            if others[name].poll() not in {None, 0} and not stop.is_set():
                raise UsageError(f"{name} could not go on: see above")


def _start(*words: str, heard: bool = False) -> subprocess.Popen[bytes]:
    """A process of the team; it does not see the terminal's Ctrl-C, which the demo passes on in order.

    heard: what it says comes through a pipe.
    """
    said = subprocess.PIPE if heard else None
    command = [sys.executable, "-m", "mapweave", "live", *words]
    return subprocess.Popen(command, start_new_session=True, stdout=said)  # noqa: S603


def _passed_on(mapping: subprocess.Popen[bytes], say: Say) -> tuple[str, Thread]:
    """Where the map process listens, as soon as it says so; a thread says on whatever else it says, to its end."""
    assert mapping.stdout is not None  # noqa: S101  (a pipe)
    lines = (line.decode(errors="replace").rstrip("\n") for line in mapping.stdout)
    for line in lines:
        _, listening, at = line.partition(LISTENING)
        if listening:
            hearing = Thread(target=_say_on, args=(lines, say), name="said", daemon=True)
            hearing.start()
            return at, hearing
        say(line)
    raise EstimateError("the map process ended before it listened")


def _say_on(lines: Iterable[str], say: Say) -> None:
    for line in lines:
        say(line)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Asked to end, and ended when it does not."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
