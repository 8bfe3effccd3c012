"""One name, one meaning: a class is called by a name that no other class of the house has."""

import ast
from collections import defaultdict
from pathlib import Path

import mapweave

HOUSE = Path(mapweave.__file__).parent


def classes(source):
    """Names of the classes at the top level of `source` that other modules may use."""
    return [n.name for n in ast.parse(source).body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]


def shared(sources):
    """Name -> the modules (`sources`: module -> its text) that define a class of this name, where there are several."""
    homes = defaultdict(list)
    for module, text in sources.items():
        for name in classes(text):
            homes[name].append(module)
    return {name: modules for name, modules in homes.items() if len(modules) > 1}


def test_no_two_classes_of_the_house_have_the_same_name():
    sources = {str(p.relative_to(HOUSE)): p.read_text() for p in sorted(HOUSE.rglob("*.py"))}
    assert shared(sources) == {}


def test_a_name_that_is_taken_is_found():
    sources = {"a": "class Gate: ...\n", "b": "class _Gate: ...\nclass Gate(int): ...\n", "c": "class _Gate: ...\n"}
    assert shared(sources) == {"Gate": ["a", "b"]}
