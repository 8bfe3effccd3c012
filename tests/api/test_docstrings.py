"""Help on the verbs: every option is told, and the examples run as printed."""

import doctest
import inspect

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
