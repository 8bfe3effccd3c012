"""Damaged, absurd and hostile inputs for every reader: each must give a result or one clear MapweaveError.

`python benchmarks/fuzz.py [--seconds N | --inputs N] [--seed S] [--format NAME]... [--keep DIR]`

Every format runs in a process of its own that may take 1 GB beyond what it starts with; an input that takes over 20 s,
more memory, warns, leaves numbers that are not finite in a result, or raises anything but a MapweaveError is shrunk and
kept. Prints the number of inputs, how many a second of processor time, and every finding; exit status 1 when there is
one.
"""

import argparse
import multiprocessing
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # some inputs are made as the tests make them

import fuzz_formats
from fuzz_mutations import mutate, smaller

from mapweave.core.errors import MapweaveError

MEMORY, TIME = 1 << 30, 20.0  # [bytes], [s]
TOLD_EVERY = 100  # inputs
Files = dict[str, bytes]


class TooLongError(Exception):
    """The reader took longer than TIME."""


def put(folder: Path, files: Files, before: Files | None = None) -> None:
    """`files` and nothing else lie in `folder`, which holds `before` or, where that is not told, anything."""
    if before is None or before.keys() != files.keys():
        shutil.rmtree(folder, ignore_errors=True)
        before = {}
    for name, data in files.items():
        if before.get(name) != data:
            path = folder / name
            if name not in before:
                path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)


def stop(*_: object) -> None:
    raise TooLongError


def verdict(read: Callable[[Path], object], folder: Path, files: Files, before: Files | None = None) -> str:
    """Empty when all is well, else what went wrong and where."""
    put(folder, files, before)
    signal.signal(signal.SIGALRM, stop)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + MEMORY, resource.RLIM_INFINITY))
    signal.setitimer(signal.ITIMER_REAL, TIME)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            made = read(folder)
        wild = fuzz_formats.not_finite(made)
    except MapweaveError as error:
        return "an error of several lines" if "\n" in str(error).strip() else ""
    except (MemoryError, TooLongError) as error:
        return type(error).__name__
    except Exception as error:  # noqa: BLE001  (whatever it is, it is a finding)
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "/mapweave/" in f.filename]
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        return f"{type(error).__name__} at {where}: {str(error)[:100]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return f"not finite: {wild}" if wild else ""


def shrunk(read: Callable[[Path], object], folder: Path, files: Files, told: str) -> Files:
    """The smallest input found that still goes wrong in the same way."""
    same = told.split(":", maxsplit=1)[0]
    end = time.monotonic() + 10
    changed = True
    while changed and time.monotonic() < end:
        changed = False
        for fewer in smaller(files):
            if time.monotonic() > end:
                break
            if verdict(read, folder, fewer).split(":")[0] == same:
                files, changed = fewer, True
                break
    return files


def worked(name: str, seed: int, inputs: int, seconds: float, keep: Path, work: Path, pipe: object) -> None:
    """Sends ("input", how many) now and then and ("found", what, where); ends with ("done", how many, seconds)."""
    read, seeds = fuzz_formats.FORMATS[name]
    held = seeds(work / "seeds")
    for files in held:
        if told := verdict(read, work / "in", files):
            pipe.send(("found", f"as it is: {told}", ""))
    rng = np.random.default_rng([seed, *name.encode()])
    start, seen, k, used, before = time.monotonic(), set(), 0, time.process_time(), None
    while k < inputs and time.monotonic() - start < seconds:
        files = mutate(held[int(rng.integers(len(held)))], rng)
        k += 1
        told = verdict(read, work / "in", files, before)
        before = files
        place = told.split(": ")[0]
        if told and place not in seen:
            seen.add(place)
            files = shrunk(read, work / "in", files, told)
            where, before = keep / f"{name}-{len(seen)}", None
            put(where, files)
            pipe.send(("found", told, str(where)))
        if k % TOLD_EVERY == 0:
            pipe.send(("input", k, ""))
    pipe.send(("done", k, f"{time.process_time() - used:.3f}"))


def address_space() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


@dataclass(frozen=True)
class Outcome:
    """Of one format: how many inputs, in how many seconds of processor time, and what was found with where it lies."""

    done: int
    seconds: float
    found: list[tuple[str, str]]


def run(name: str, seed: int, inputs: int, seconds: float, keep: Path) -> Outcome:
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    memory = Path("/dev/shm")  # noqa: S108  (a folder of our own is made there)
    work = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-", dir=memory if memory.is_dir() else None))
    child = context.Process(target=worked, args=(name, seed, inputs, seconds, keep, work, theirs))
    child.start()
    theirs.close()
    done, used, found = 0, 0.0, []
    try:
        for kind, what, where in received(ours):
            if kind == "found":
                found.append((what, where))
            else:
                done = int(what)
                if kind == "done":
                    used = float(where)
                    break
        else:
            shutil.copytree(work / "in", keep / f"{name}-fatal", dirs_exist_ok=True)
            found.append((f"the process died after {done} inputs", str(keep / f"{name}-fatal")))
    finally:
        child.join()
        shutil.rmtree(work, ignore_errors=True)
    return Outcome(done, used, found)


def received(pipe: object) -> Iterator[tuple[str, object, str]]:
    try:
        while True:
            yield pipe.recv()
    except EOFError:
        return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=None, help="in all, shared by the formats")
    parser.add_argument("--inputs", type=int, default=None, help="for each format")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--format", action="append", choices=sorted(fuzz_formats.FORMATS))
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "mapweave-fuzz")
    given = parser.parse_args()
    fuzz_formats.compile_messages_once()
    names = given.format or sorted(fuzz_formats.FORMATS)
    seconds = np.inf if given.seconds is None else given.seconds / len(names)
    inputs = given.inputs or (10**12 if given.seconds else 200)
    total, used, wrong = 0, 0.0, 0
    for name in names:
        made = run(name, given.seed, inputs, seconds, given.keep)
        total, used, wrong = total + made.done, used + made.seconds, wrong + len(made.found)
        rate = f"{made.done / max(made.seconds, 1e-3):.0f} a second"
        print(f"{name}: {made.done} inputs, {rate}, {len(made.found)} findings", flush=True)
        for what, where in made.found:
            print(f"  {what}  {where}", flush=True)
    print(f"{total} inputs over {len(names)} formats in {used:.0f} s of processor time, {wrong} findings")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
