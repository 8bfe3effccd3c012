"""The command line: arguments in, one verb called, results written, one clear line on a mistake."""

import gc
import os
import sys
from contextlib import nullcontext, suppress
from io import TextIOWrapper
from itertools import pairwise
from typing import TYPE_CHECKING

from ..core.version import __version__
from ..kernels.compiling import nothing_collected
from .terminal import FlowingHelp, Interruption, warn

if TYPE_CHECKING:
    from cyclopts import App

    from .from_verb import Command

HELP = {"--help", "-h"}


def make_app() -> "App":
    from cyclopts import App

    from .commands import COMMANDS, GROUPS
    from .from_verb import Command

    app = App(
        suppress_keyboard_interrupt=False,  # said in one line below
        name="mapweave",
        help="One map, with honest uncertainty, from the logs of many robots.",
        version=f"mapweave {__version__}",
        version_flags=["--version"],
        help_formatter=FlowingHelp(),
        help_format="plaintext",  # Markdown costs a tenth of a second to import
        help_epilogue="`mapweave demo` is a first look; `mapweave COMMAND --help` tells the options of a command.",
    )
    for place, (name, entry) in enumerate(COMMANDS.items()):
        if isinstance(entry, Command):
            _add(app, name, name, entry, place)
            continue
        group = App(name=name, help=GROUPS[name], help_epilogue="", sort_key=place)
        for word, command in entry.items():
            _add(group, word, f"{name} {word}", command)
        app.command(group)
    return app


def _add(app: "App", word: str, words: str, command: "Command", place: int | None = None) -> None:
    """One command, whose function is made when it is asked for."""
    shown = {"help_epilogue": f"Example: mapweave {command.example}" if command.example else ""}
    app.command(f"{__name__}.commands:{words}", name=word, help=command.does, sort_key=place, **shown)


def main(tokens: list[str] | None = None) -> None:
    """Exit 0 done, 1 the data or the estimate is bad, 2 bad usage, 130 interrupted."""
    _open_what_is_closed()
    _say_whatever_the_terminal_can_show()
    code = 130
    with Interruption() as interruption:
        try:
            code = _run(sys.argv[1:] if tokens is None else tokens, interruption)
            sys.stdout.flush()
        except BrokenPipeError:
            code = _stop_writing()
        except KeyboardInterrupt:
            warn("interrupted")
        except OSError as error:
            _stop_writing()
            warn(f"stdout: {error.strerror}")
            code = 1
        except Exception as error:
            if not interruption.asked:
                raise
            code = _failed(error, asked=True)  # what was raised came of it
    if tokens is None:
        gc.freeze()  # all that was imported goes with the process: Python looks through it once more else
    sys.exit(code)


def _open_what_is_closed() -> None:
    """A stdin, stdout or stderr that the caller closed is the null device: no file opened later takes its number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            lowest_free = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, open(lowest_free, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def _say_whatever_the_terminal_can_show() -> None:
    """A letter that the terminal's encoding lacks becomes `?`, bytes that are no letters go out as they are."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            utf8 = (stream.encoding or "").lower().replace("-", "") == "utf8"
            stream.reconfigure(errors="surrogateescape" if utf8 else "replace")


def _stop_writing() -> int:
    """Nobody reads on: what is left in the buffer goes nowhere, so that Python's own exit is silent too."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
    return 0


def _run(tokens: list[str], interruption: Interruption | None = None) -> int:
    from cyclopts import CycloptsError

    from ..core.errors import MapweaveError

    try:
        with nothing_collected() if HELP & {*tokens} or not tokens else nullcontext():
            app = make_app()
            app(tokens, exit_on_error=False, print_error=False)
    except (CycloptsError, MapweaveError, MemoryError, KeyboardInterrupt) as error:
        return _failed(error, tokens, asked=interruption is not None and interruption.asked)
    except BrokenPipeError:
        return _stop_writing()
    except OSError as error:
        if error.filename is None:
            raise
        return _failed(error)
    except SystemExit as done:
        if isinstance(done.__context__, BrokenPipeError):  # the help's reader stopped
            return _stop_writing()
        return done.code if isinstance(done.code, int) else 0
    return 0


def _missing(error: BaseException, tokens: list[str] | tuple[str, ...]) -> str:
    """What a command was not given, or given so that it reads as an option; "" where that is not what is wrong."""
    from cyclopts import MissingArgumentError

    if not isinstance(error, MissingArgumentError) or error.argument is None:
        return ""
    command, name = " ".join(error.command_chain or ()), error.argument.name
    for before, word in pairwise(tokens):
        if before == name and word.startswith("-") and word != "--":
            return f"{name}: {word} reads as an option; a value that begins with - is written {name}={word}"
    return f"{command}: {name} is missing; mapweave {command} --help tells what it is"


def _failed(error: BaseException, tokens: list[str] | tuple[str, ...] = (), *, asked: bool = False) -> int:
    """The exit status, the reason told in one line, and what the error's notes add; asked: Ctrl-C was pressed."""
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    if asked or isinstance(error, KeyboardInterrupt):
        warn(f"interrupted{notes}")
        return 130
    if isinstance(error, MemoryError):
        warn(f"not enough memory for this{notes}")
        return 1
    if isinstance(error, OSError):
        warn(f"{error.filename}: {error.strerror}{notes}")
        return 1
    warn(f"{_missing(error, tokens) or error}{notes}")
    return int(getattr(error, "exit_code", 2))  # what cannot be parsed is bad usage
