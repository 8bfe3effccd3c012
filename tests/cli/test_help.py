"""What `--help` tells of every command: an example that can be typed, and of each option something of its own."""

import shlex

import pytest

from mapweave.cli import COMMANDS, make_app


def commands(app, before=()):
    """Every command that does something itself: the words that call it, and its part of the command line."""
    for name in app:
        if not name.startswith("-"):
            below = list(commands(app[name], (*before, name)))
            yield from below or [((*before, name), app[name])]


EVERY = list(commands(make_app()))


@pytest.mark.parametrize(("words", "command"), EVERY, ids=[" ".join(words) for words, _ in EVERY])
def test_the_example_of_a_command_is_one_that_the_command_line_takes(words, command):
    if words[0] == "reproduce":
        assert not command.help_epilogue
        return
    start, _, line = command.help_epilogue.partition(": ")
    typed = shlex.split(line.partition(" > ")[0])
    assert start == "Example"
    assert typed[: len(words) + 1] == ["mapweave", *words]
    make_app().parse_args(typed[1:], print_error=False, exit_on_error=False)


@pytest.mark.parametrize(("words", "command"), EVERY, ids=[" ".join(words) for words, _ in EVERY])
def test_no_two_options_of_a_command_are_explained_with_the_same_words(words, command):
    found = command.assemble_argument_collection(parse_docstring=True)
    told = [option.parameter.help for option in found if option.show]
    assert all(told)
    assert len(set(told)) == len(told)


def test_commands_stand_in_the_order_in_which_they_are_met(capsys):
    with pytest.raises(SystemExit):
        make_app()(["--help"])
    lines = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line[2:].split(" ")[0] in COMMANDS]
    assert lines == list(COMMANDS)
    assert lines[0] == "demo"
