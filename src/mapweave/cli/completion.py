"""`mapweave completion`."""

import re
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclopts import App

# what the generated scripts get wrong, and what they say then: a folder called `team` is no command of `map`, names of
# files may hold blanks, a flag takes no value, and in zsh a script that is sourced must register itself
MENDED = {
    "bash": (
        ('[[ " $all_commands " =~ " $word " ]]', '[[ "|PATHS|" == *"|${cmd_path[*]:+${cmd_path[*]} }$word|"* ]]'),
        (
            'COMPREPLY=( $(compgen -f -- "${cur}") )',
            "compopt -o filenames 2> /dev/null; local IFS=$'\\n'; COMPREPLY=( $(compgen -f -- \"${cur}\") )",
        ),
    ),
    "fish": (
        (
            'string match -q -- "* $word *" " $all_commands "',
            'string match -q -- "*|"(string join " " $subcommands $word)"|*" "|PATHS|"',
        ),
    ),
    "zsh": (),
}
VALUED_FLAG = re.compile(r"'\*(--([\w-]+)\[.*\]):\2'(?= \\\n +'--no-\2\[)")
REGISTERED = """
if [ "$funcstack[1]" = "_mapweave" ]; then
  _cyclopts_mapweave "$@"
else
  (( $+functions[compdef] )) || { autoload -U compinit && compinit; }
  compdef _cyclopts_mapweave mapweave
fi
"""


def completion(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print the script that completes commands and options in a shell.

    For this terminal: `source <(mapweave completion bash)`; for all, that line in the shell's start file (fish:
    `mapweave completion fish > ~/.config/fish/completions/mapweave.fish`).

    Parameters
    ----------
    shell
        bash, zsh or fish.
    """
    from . import make_app
    from .terminal import say

    app = make_app()
    script = app.generate_completion(shell=shell)
    paths = "|".join(_paths(app))
    for generated, mended in MENDED[shell]:
        script = script.replace(generated, mended.replace("PATHS", paths))
    if shell == "zsh":
        script = VALUED_FLAG.sub(r"'\1'", script) + REGISTERED
    say(script.rstrip())


def _paths(app: "App", before: str = "") -> "Iterator[str]":
    """Every command with the words before it, as `simulate team`."""
    for name in app:
        if not name.startswith("-"):
            yield before + name
            yield from _paths(app[name], f"{before}{name} ")
