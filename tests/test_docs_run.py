"""Every command that a page prints does its work, in the order of the page, on small inputs of the names it uses.

What is made smaller stands in SMALLER and OTHER, what is not run in ELSEWHERE with the test that runs it.
"""

import gzip
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import pytest

from mapweave.cli import _run
from mapweave.sim.laser_worlds import OfficeConfig, simulate_office

from .io.made_clouds import cloud_bag
from .io.ros_logs import Recording, usual
from .io.test_carmen import flaser
from .io.test_tags import recorded
from .test_docs_commands import BLOCK, EVERY, PAGES, TOP

SMALLER = {
    "explore yuan": {"--until": "3", "--runs": "1", "--jobs": "1"},
    "explore office": {"--until": "1"},
    "explore world.toml": {"--until": "2"},
    "simulate corridor": {"--distance": "10", "--beams": "40"},
    "simulate landmarks": {"--minutes": "0.5"},
    "simulate office": {"--rooms": "3", "--scan-every": "2", "--beams": "80"},
    "simulate team": {"--minutes": "0.3"},
    "simulate tunnel": {"--length": "20", "--beams": "40"},
}
OTHER = {"office-5000": "office-300"}  # words in their place
ELSEWHERE = {
    "explore yuan --robots 2 --planner joint": "tests/exploration/test_exploration.py",
    "live demo": "tests/live/test_processes.py",
    "live explore": "tests/live/test_told.py",
    "live map": "tests/live/test_processes.py",
    "live robot": "tests/live/test_processes.py",
    "live robot --name r1 --source ros2": "tests/live/test_ros2_processes.py",
    "live view": "tests/live/test_view.py",
    "reproduce yuan": "tests/papers/test_reproduce_yuan.py",
}
PRINTING = [page for page in PAGES if any(page == printed for printed, _ in EVERY)]
GRAPH = "\n".join(
    [*(f"VERTEX_SE2 {k} {min(k, 3)} {max(k - 3, 0)} 0" for k in range(6))]
    + [f"EDGE_SE2 {k} {k + 1} {int(k < 3)} {int(k >= 3)} 0 100 0 0 100 0 100" for k in range(5)]
    + ["EDGE_SE2 0 5 3 2 0 100 0 0 100 0 100", ""]
)


def reduced(line):
    """The words of a printed command without what it shows as optional, made smaller where SMALLER tells how."""
    words = [OTHER.get(word, word) for word in shlex.split(re.sub(r"\[[^\]]*\]", "", line))[1:]]
    for option, value in SMALLER.get(" ".join(words[:2]), {}).items():
        if option in words:
            words[words.index(option) + 1] = value
        else:
            words += [option, value]
    return words


def elsewhere(line):
    return [test for start, test in ELSEWHERE.items() if line.startswith(f"mapweave {start}")]


def quiet(*words):
    assert _run([str(word) for word in words]) == 0


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Logs, results and other files under the names that pages use for one's own."""
    home = tmp_path_factory.mktemp("inputs")
    quiet("simulate", "landmarks", "--out", home / "LOG", "--robots", 3, "--minutes", 0.5, "--seed", 1)
    shutil.make_archive(str(home / "MRCLAM_Dataset6"), "zip", home / "LOG")
    for k, name in enumerate(["robot1.bag", "robot2.mcap", "tuesday.bag", "robot3.mcap"]):
        usual(home / name, 12 + 2 * k).write()
    rows = "\n".join(flaser(k, [2.0 + 0.01 * k, 3.0, 2.5, 2.0], (0.1 * k, 0.0, 0.0)) for k in range(8))
    (home / "intel.clf.gz").write_bytes(gzip.compress(f"{rows}\n".encode()))
    table = "\n".join(f"{k},{0.1 * k},0,0,{2.0 + 0.01 * k},3.0,2.5,2.0" for k in range(8))
    (home / "table.csv").write_text(f"t,x,y,theta,r1,r2,r3,r4\n{table}\n")
    (home / "FILE.g2o").write_text(GRAPH)
    drive = simulate_office(OfficeConfig(rooms=2, visited=1), 1)
    cloud_bag(home / "clouds.bag", drive.log)
    recorded(home / "tags.mcap", Recording.objects).write()
    two = ["--lasers", 2, "--cameras", 0, "--bearings", 0]
    quiet("simulate", "team", "--out", home / "radios", "--ranges", *two, "--beacons", 2, "--minutes", 0.5)
    quiet("map", home / "radios", "--out", home / "ranged")
    shutil.copy(home / "ranged" / "graph.pyfg", home / "FILE.pyfg")
    (home / "world.toml").write_text(
        'sensor = "laser"\nwalls = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]\nstarts = [[1.5, 2, 0]]\n'
    )
    quiet("map", home / "LOG", "--out", home / "of landmarks" / "monday", "--no-refine")
    quiet("map", home / "LOG", "--out", home / "of landmarks" / "tuesday", "--robots", "2,3", "--no-refine")
    quiet("map", home / "robot1.bag", "--out", home / "of lasers" / "monday")
    quiet("map", home / "robot2.mcap", "--out", home / "of lasers" / "tuesday")
    return home


@pytest.mark.slow
@pytest.mark.parametrize("page", PRINTING, ids=lambda page: page.stem)
def test_what_a_page_tells_to_type_does_its_work(page, inputs, tmp_path, monkeypatch, capsys):
    for path in inputs.iterdir():
        if path.is_file():
            shutil.copy(path, tmp_path)
        elif path.name == "LOG":
            shutil.copytree(path, tmp_path / "LOG")
    kind = "of lasers" if page.stem == "laser-teams" else "of landmarks"
    shutil.copytree(inputs / kind, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    for line in dict.fromkeys(line for printed, line in EVERY if printed == page and not elsewhere(line)):
        assert _run(reduced(line)) == 0, f"{line}: {capsys.readouterr().err}"


def test_what_is_not_run_here_is_run_by_a_test_that_is_there():
    assert [test for test in ELSEWHERE.values() if not (TOP / test).exists()] == []
    assert sum(not elsewhere(line) for _, line in EVERY) > 2 * len(EVERY) / 3


BLOCKS = [(page, kind, code) for page in PAGES for kind, code in BLOCK.findall(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", sorted({page for page, kind, _ in BLOCKS if kind == "python"}), ids=lambda p: p.stem)
def test_what_python_blocks_of_a_page_import_and_name_is_there(page):
    import mapweave

    for _, _, code in [block for block in BLOCKS if block[0] == page and block[1] == "python"]:
        compile(code, str(page), "exec")
        for line in re.findall(r"^(?:from|import) .*$", code, re.MULTILINE):
            exec(line, {})  # noqa: S102  (what the page tells people to type)
        for name in re.findall(r"\bmapweave\.(\w+)\(", code):
            assert hasattr(mapweave, name), name


def test_tables_of_settings_that_pages_print_are_toml():
    read = [tomllib.loads(code) for _, kind, code in BLOCKS if kind == "toml"]
    assert all(read)
    assert len(read) > 3


def test_pages_with_commands_are_many():
    assert len(PRINTING) > 7
    assert Path("README.md") in {page.relative_to(TOP) for page in PRINTING}
