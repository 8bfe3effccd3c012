"""Help on the verbs: every option is told, and the examples run as printed."""

import doctest
import inspect
import pydoc
import re
import subprocess
import sys

import pytest

import mapweave

MAIN = ("configuration", "doctor", "evaluate", "explore", "fuse", "localize", "locate", "map", "solve_pose_graph")


@pytest.mark.parametrize("name", MAIN)
def test_the_help_of_a_verb_tells_every_option_its_errors_and_an_example(name):
    verb = getattr(mapweave, name)
    text = inspect.getdoc(verb)
    lines = text.splitlines()
    for option in inspect.signature(verb).parameters:
        assert option in lines, option
        assert lines[lines.index(option) + 1].startswith("    ")
    assert "Examples" in lines
    if inspect.signature(verb).parameters:
        assert "Raises" in lines
        assert "UsageError" in text


@pytest.mark.parametrize("name", MAIN)
def test_the_examples_of_a_verb_run_as_printed(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    verb = getattr(mapweave, name)
    names = {word: getattr(mapweave, word) for word in mapweave.__all__}
    (example,) = doctest.DocTestFinder(recurse=False).find(verb, name, globs=names)
    assert example.examples
    said = []
    doctest.DocTestRunner(verbose=False).run(example, out=said.append)
    assert not said, "".join(said)


def test_every_public_name_says_in_its_first_line_what_it_is():
    bare = []
    for name in sorted(set(mapweave.__all__) - {"__version__"}):
        first, *_ = (inspect.getdoc(getattr(mapweave, name)) or "").splitlines() or [""]
        if not first.endswith((".", ":")) or first.startswith(f"{name}("):
            bare.append(f"{name}: {first}")
    assert not bare, "\n".join(bare)


def test_every_option_of_a_public_function_is_told():
    untold = []
    for name in mapweave.__all__:
        verb = getattr(mapweave, name)
        if not inspect.isfunction(verb):
            continue
        text = inspect.getdoc(verb)
        untold += [f"{name}: {p}" for p in inspect.signature(verb).parameters if not re.search(rf"\b{p}\b", text)]
    assert not untold, "\n".join(untold)


def public(kind):
    """Public names and what they stand for, of those that `kind` says yes to."""
    named = ((name, getattr(mapweave, name)) for name in mapweave.__all__)
    return [(name, thing) for name, thing in named if kind(thing)]


def help_of(thing):
    return pydoc.plain(pydoc.render_doc(thing, renderer=pydoc.plaintext)).splitlines()


def test_no_line_of_the_help_of_a_public_function_or_class_is_over_120_columns():
    wide = [f"{name}: {line}" for name, thing in public(callable) for line in help_of(thing) if len(line) > 120]
    assert not wide, "\n".join(wide)


def test_signatures_in_help_name_types_and_defaults_without_their_modules_and_addresses():
    for name, verb in public(inspect.isfunction):
        head = "\n".join(help_of(verb)[2:]).partition("\n    " + inspect.getdoc(verb).splitlines()[0])[0]
        assert head.startswith(f"{name}(")
        assert not re.search(r"[^\W\d]\w*\.\w|0x|<", head), head


def test_a_readable_signature_holds_the_parameters_and_types_that_python_finds():
    for _, verb in public(inspect.isfunction):
        told, plain = inspect.signature(verb), inspect.unwrap(verb)
        assert list(told.parameters) == list(plain.__code__.co_varnames[: len(told.parameters)])
        assert {p.name: p.annotation for p in told.parameters.values()} | {"return": told.return_annotation} == dict(
            plain.__annotations__
        )
        named = [p for p in told.parameters.values() if p.kind is p.KEYWORD_ONLY and p.default is not p.empty]
        assert {p.name: p.default for p in named} == (plain.__kwdefaults__ or {})


def test_every_type_that_a_public_function_gives_is_public():
    given = {name: inspect.signature(verb).return_annotation for name, verb in public(inspect.isfunction)}
    hidden = []
    for name, kinds in given.items():
        for kind in getattr(kinds, "__args__", (kinds,)):
            own = isinstance(kind, type) and kind.__module__.startswith("mapweave.")
            hidden += [f"{name}: {kind.__name__}"] if own and kind.__name__ not in mapweave.__all__ else []
    assert not hidden, "\n".join(hidden)


def test_the_help_of_the_package_begins_with_what_it_does_and_names_every_verb():
    first, *_ = lines = inspect.getdoc(mapweave).splitlines()
    assert first == "One map, with honest uncertainty, from the logs of many robots."
    assert not [name for name, _ in public(inspect.isfunction) if not re.search(rf"\b{name}\b", "\n".join(lines[6:]))]


@pytest.mark.slow
def test_help_on_what_a_result_is_and_holds_is_readable_without_its_name_having_been_asked_for():
    code = (
        "import pydoc\n"
        "from mapweave.api.team import TeamResult\n"
        "from mapweave.api.laser_result import LaserResult\n"
        "from mapweave.mapping.woven_map import WovenMap\n"
        "from mapweave.team.team_map import TeamMap\n"
        "for kind in (TeamResult, LaserResult, WovenMap, TeamMap):\n"
        "    print(pydoc.plain(pydoc.render_doc(kind, renderer=pydoc.plaintext)))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    wide = [line for line in done.stdout.splitlines() if len(line) > 120]
    assert done.stdout.count("  __init__(") == 4
    assert not wide, "\n".join(wide)
