"""What `--help` tells of every command: an example that can be typed, and of each option something of its own."""

import shlex

import pytest
from cyclopts import App, CycloptsError

from mapweave.cli import from_verb, make_app
from mapweave.cli.commands import COMMANDS
from mapweave.core.signatures import COMMON


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


def test_an_option_has_the_type_the_default_and_the_meaning_of_the_argument_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(from_verb, "PACKAGE", tmp_path)
    source = '''
def weigh(thing: Path | str | None, out: Path | str | None = None, *, times: int = 3, near: float | None = None,
          often: bool = False, on_progress: object = None) -> None:
    """Weigh a thing.

    Parameters
    ----------
    thing
        What is weighed.
    times
        How often (3), unless `often`.
    near
        As `configuration("map")` has it [m].

    Raises
    ------
    UsageError
        Never.
    """
'''
    (tmp_path / "scales.py").write_text(source)
    app = App()
    app.command(from_verb.make("weigh", from_verb.Command(verb="scales:weigh", words=("thing",))), name="weigh")
    found = {o.name: o for o in app["weigh"].assemble_argument_collection(parse_docstring=True) if o.show}
    assert {name: (o.required, o.parameter.help) for name, o in found.items()} == {
        "THING": (True, "What is weighed."),
        "--out": (True, COMMON["out"]),
        "--times": (False, "How often, unless --often."),
        "--near": (False, "As mapweave config map has it [m]."),
        "--often": (False, ""),
    }
    assert found["--times"].hint is int
    with pytest.raises(CycloptsError, match="times"):
        app(["weigh", "x", "--out", "y", "--times", "two"], exit_on_error=False, print_error=False)
