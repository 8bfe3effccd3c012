"""Help on the verbs: every option is told, and the examples run as printed."""

import doctest
import inspect
import re

import pytest

import mapweave

MAIN = ("configuration", "doctor", "evaluate", "explore", "fuse", "localize", "locate", "map")


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
