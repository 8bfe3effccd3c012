"""`mapweave completion`."""

from typing import Literal


def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
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

    say(make_app().generate_completion(shell=shell))
