"""What the documentation tells people to type is what the command line takes."""

import json
import re
import shlex
from pathlib import Path

import pytest

from mapweave.cli import _run, make_app

TOP = Path(__file__).parent.parent
PAGES = sorted([*TOP.glob("docs/**/*.md"), TOP / "README.md"])
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def commands(page):
    """Every line of a page's code blocks that calls mapweave, joined where it goes on."""
    out = []
    for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language not in {"", "sh", "bash", "console"}:
            continue
        for line in block.replace("\\\n", " ").splitlines():
            words = line.split("#")[0].strip()
            if words.startswith("mapweave ") and "COMMAND" not in words:
                out.append(words)
    return out


EVERY = [(page, line) for page in PAGES for line in commands(page)]


@pytest.mark.parametrize(("page", "line"), EVERY, ids=[f"{p.stem}: {w}" for p, w in EVERY])
def test_the_command_line_takes_what_a_page_tells(page, line):
    words = shlex.split(line.replace("[", "").replace("]", "").replace("...", "").replace("|", " "))[1:]
    words = [word for word in words if word.strip(".")]
    if len(words) == 2 and words[1].isupper():
        return  # `mapweave simulate WORLD` and such stand for several
    make_app().parse_args(words, print_error=False, exit_on_error=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_command_within_a_sentence_can_be_typed_as_it_stands(page):
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for code in re.findall(r"`(mapweave [^`]*)`", text.replace("\n", " ")):
        words = [word for word in shlex.split(code.replace("[", "").replace("]", ""))[1:] if word.strip(".")]
        if "|" in code or len(words) < 2 or words[0].isupper() or (len(words) == 2 and words[1].isupper()):
            continue  # a verb alone, or one that stands for several
        make_app().parse_args(words, print_error=False, exit_on_error=False)


def test_the_first_example_of_swarms_locates_every_robot_as_printed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulate, locate = (shlex.split(line)[1:] for line in commands(TOP / "docs" / "locate.md")[:2])
    assert _run(simulate) == _run(locate) == 0
    told = json.loads((tmp_path / locate[locate.index("--out") + 1] / "metrics.json").read_text())
    assert told["reliable"]
    assert told["rmse"] < 0.3
    assert 0.5 < told["nees_per_dof"] < 2.0


def test_there_are_commands_to_try():
    assert len(EVERY) > 30


def test_the_readme_tells_the_two_commands_that_do_all():
    told = [
        line.split("#")[0].strip()
        for _, block in BLOCK.findall((TOP / "README.md").read_text())
        for line in block.splitlines()
    ]
    assert [line for line in told if line.startswith("python3 bootstrap.py")] == [
        "python3 bootstrap.py demo",
        "python3 bootstrap.py test",
    ]
