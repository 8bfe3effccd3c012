"""The command line: arguments in, one verb called, results written, one clear line on a mistake."""

import sys
from typing import TYPE_CHECKING

from ..core.version import __version__

if TYPE_CHECKING:
    from cyclopts import App

COMMANDS: dict[str, str] = {
    # verb: where its command lives; imported only when that command is asked for
    "demo": "mapweave.cli.demo:demo",
    "simulate": "mapweave.cli.simulate:app",
    "map": "mapweave.cli.map:map_logs",
    "fuse": "mapweave.cli.fuse:fuse",
    "locate": "mapweave.cli.locate:locate",
    "evaluate": "mapweave.cli.evaluate:evaluate",
    "localize": "mapweave.cli.localize:localize",
    "reproduce": "mapweave.cli.reproduce:app",
    "view": "mapweave.cli.view:view",
    "explore": "mapweave.cli.explore:explore",
    "config": "mapweave.cli.config:config",
    "doctor": "mapweave.cli.doctor:doctor",
}


def make_app() -> "App":
    from cyclopts import App

    app = App(
        suppress_keyboard_interrupt=False,  # said in one line below
        name="mapweave",
        help="One map, with honest uncertainty, from the logs of many robots.",
        version=f"mapweave {__version__}",
        version_flags=["--version"],
        help_format="plaintext",  # Markdown costs a tenth of a second to import
    )
    for name, where in COMMANDS.items():
        app.command(where, name=name)
    return app


def main(tokens: list[str] | None = None) -> None:
    """Exit 0 done, 1 the data or the estimate is bad, 2 bad usage, 130 interrupted."""
    sys.exit(_run(sys.argv[1:] if tokens is None else tokens))


def _run(tokens: list[str]) -> int:
    from cyclopts import CycloptsError

    from ..core.errors import MapweaveError

    try:
        app = make_app()
        app(tokens, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        print(f"mapweave: {error}", file=sys.stderr)  # noqa: T201
        return 2
    except MapweaveError as error:
        print(f"mapweave: {error}", file=sys.stderr)  # noqa: T201
        return error.exit_code
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        print("mapweave: interrupted", file=sys.stderr)  # noqa: T201
        return 130
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else 0
    return 0
