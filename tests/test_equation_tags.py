"""Every equation named where it is computed is named by the test that checks it."""

import re
from pathlib import Path

import mapweave

TAG = re.compile(r"\[(Kojima12|Hamatani|Hara07|Yuan09)\]\s+eqs?\.\s*([0-9]+)(?:-([0-9]+))?")
MARK = re.compile(r"pytest\.mark\.eq\(([^)]*)\)", re.DOTALL)


def test_every_equation_tag_in_the_code_has_a_test():
    computed = {}
    for path in Path(mapweave.__file__).parent.rglob("*.py"):
        for paper, first, last in TAG.findall(path.read_text(encoding="utf-8")):
            for number in range(int(first), int(last or first) + 1):
                computed.setdefault(f"{paper}:{number}", path.name)
    checked = set()
    for path in Path(__file__).parent.rglob("test_*.py"):
        for tags in MARK.findall(path.read_text(encoding="utf-8")):
            checked |= set(re.findall(r"\"([A-Za-z0-9]+:[0-9]+)\"", tags))
    missing = {tag: name for tag, name in computed.items() if tag not in checked}
    assert not missing, f"computed but not named by a test: {missing}"
