"""`edit`: what a browser posts is decided, solved, undone and saved, and `map` makes the same of what was saved."""

import json
import shutil
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import mapweave
from mapweave.api.view import Editor
from mapweave.core import se2
from mapweave.core.errors import ReaderError, UsageError

pytestmark = pytest.mark.usefixtures("_remembered")

OFF = [0.5, -0.4, 0.03]  # [m, m, rad] from where the scans have it


@pytest.fixture(scope="module")
def team(office_map, tmp_path_factory):
    """A copy: whoever edits may write into it."""
    return shutil.copytree(office_map[1], tmp_path_factory.mktemp("edited") / "out")


@contextmanager
def served(folder, say=print, **options):
    """The address that the verb says it serves, until the block ends."""
    said, stop, told = [], threading.Event(), threading.Event()

    def hear(line):
        say(line)
        said.append(line.rsplit(" ", 1)[1])
        told.set()

    asked = {"port": 0, "stop": stop, "say": hear, **options}
    thread = threading.Thread(target=mapweave.edit, args=(folder,), kwargs=asked)
    thread.start()
    try:
        assert told.wait(60)
        yield said[0]
    finally:
        stop.set()
        thread.join(30)
    assert not thread.is_alive()


def post(address, path, asked, **headers):
    """What the server answers to the JSON that the page posts; an error's number where it refuses."""
    body, kind = json.dumps(asked).encode(), {"Content-Type": "application/json", **headers}
    request = urllib.request.Request(address + path, body, kind)  # noqa: S310  (our own)
    try:
        with urllib.request.urlopen(request, timeout=120) as answer:  # noqa: S310
            return json.load(answer)
    except urllib.error.HTTPError as error:
        return json.load(error) if error.headers.get_content_type() == "application/json" else error.code


def same_bytes(one, other):
    names = sorted(p.relative_to(one) for p in one.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(other) for p in other.rglob("*") if p.is_file())
    for name in names:
        a, b = ((folder / name).read_bytes() for folder in (one, other))
        if name.name == "metrics.json":
            a, b = ({**json.loads(text), "timing": 0} for text in (a, b))
        if name.name != "report.html":  # it tells how long a scan took
            assert a == b, name


def test_decisions_made_in_the_page_give_the_same_bytes_when_map_takes_them(team, logs, tmp_path):
    file, out = tmp_path / "said.toml", tmp_path / "out"
    with served(team, decisions=file, out=out) as address:
        state = post(address, "state", {})
        assert not state["said"]
        assert state["undo"] == 0
        within = [k for k, p in enumerate(state["places"]) if p["accepted"] and p["names"][0] == p["names"][1]]
        between = [k for k, p in enumerate(state["places"]) if p["accepted"] and p["names"][0] != p["names"][1]]
        for place in (within[0], between[0]):
            state = post(address, "decide", {"place": place, "part": 0, "decision": "apart"})
            assert not state["places"][place]["accepted"]
            assert state["places"][place]["said"] == "apart"
        assert (state["said"], state["undo"], state["saved"]) == (2, 2, False)
        assert post(address, "save", {}) == {"file": str(file), "out": str(out)}
    mapweave.map(logs, tmp_path / "map", decisions=file)
    same_bytes(out, tmp_path / "map")


def test_walls_that_are_erased_and_regions_that_are_forgotten_give_the_same_bytes(team, logs, tmp_path):
    file, out = tmp_path / "said.toml", tmp_path / "out"
    whole = mapweave.load(team).components[0].grid
    x, y = whole.cells()[len(whole.cells()) // 2, :2].round(1) + 0.02  # off the middles of cells
    boxes = {"free": [x - 0.5, y - 0.5, x + 0.5, y + 0.5], "unknown": [x + 0.5, y - 2.0, x + 3.0, y + 2.0]}
    with served(team, decisions=file, out=out) as address:
        for cells, box in boxes.items():
            state = post(address, "decide", {"box": box, "cells": cells, "part": 0})
        assert (state["said"], state["undo"]) == (2, 2)
        assert post(address, "undo", {})["said"] == 1
        post(address, "decide", {"box": boxes["unknown"], "cells": "unknown", "part": 0})
        post(address, "save", {})
    masked = mapweave.map(logs, tmp_path / "map", decisions=file).components[0].grid
    same_bytes(out, tmp_path / "map")
    rows, columns = np.indices(whole.shape)
    centres = whole.origin + whole.resolution * (np.stack([columns, rows], axis=-1) + 0.5)
    inside = {name: ((centres > box[:2]) & (centres < box[2:])).all(axis=-1) for name, box in boxes.items()}
    assert (whole.to_numpy() == 100)[inside["free"]].any()
    assert not (masked.to_numpy() == 100)[inside["free"]].any()
    assert (masked.to_numpy() == -1)[inside["unknown"]].all()
    rest = ~(inside["free"] | inside["unknown"])
    assert (masked.to_numpy() == whole.to_numpy())[rest].all()
    with served(out, decisions=file) as address:
        assert post(address, "state", {})["said"] == 2


def test_robots_said_to_be_apart_and_dragged_onto_each_other_again_are_one_map(team, logs, tmp_path):
    file, out = tmp_path / "said.toml", tmp_path / "out"
    with served(team, decisions=file, out=out) as address:
        before = post(address, "state", {})
        (pair,) = before["pairs"]
        state = post(address, "decide", {"pair": pair["robots"], "decision": "apart"})
        assert len(state["parts"]) == 2
        assert post(address, "undo", {})["scene"] == before["scene"]
        state = post(address, "decide", {"pair": pair["robots"], "decision": "apart"})
        made = mapweave.load(team).components[0]
        lies = se2.compose(
            se2.between(made.tracks["1"].pose[0], made.tracks["2"].pose[0]), np.array([0.5, -0.4, 0.03])
        )  # not where the scans have it
        state = post(address, "decide", {"lay": 1, "part": 0, "pose": np.asarray(lies).tolist()})
        assert len(state["parts"]) == 1
        assert state["pairs"][0]["said"] == "together"
        post(address, "save", {})
    again = mapweave.map(logs, tmp_path / "map", decisions=file)
    same_bytes(out, tmp_path / "map")
    assert again.merges[0].said == "together"
    assert np.hypot(*se2.between(lies, again.merges[0].transform)[:2]) < 0.6
    with served(out) as address:  # goes on from what was said, and leaves it to the scans again
        assert post(address, "state", {})["said"] == 1
        state = post(address, "decide", {"pair": pair["robots"], "decision": "undecided"})
        assert state["scene"] == before["scene"]
        assert state["said"] == 0


def test_what_was_refused_only_beside_another_place_stays_forbidden_when_read_again(team, logs, tmp_path):
    """A row says what is to be even where the log alone had it so: other rows may have changed that."""
    editor = Editor(team, tmp_path / "said.toml", tmp_path / "out")
    refused = next(k for k, c in enumerate(editor.result.components[0].closures) if not c.accepted)
    state = editor.decide({"place": refused, "part": 0, "decision": "apart"})
    assert state["said"] == 1
    editor.save({})
    row = mapweave.map(logs, tmp_path / "map", decisions=tmp_path / "said.toml").said
    assert row is not None
    same_bytes(tmp_path / "out", tmp_path / "map")


def test_a_page_that_shows_what_no_longer_holds_decides_nothing_and_is_shown_what_does(team, tmp_path):
    with served(team, decisions=tmp_path / "said.toml") as address:
        first = post(address, "state", {})
        (pair,) = first["pairs"]
        apart = {"pair": pair["robots"], "decision": "apart", "part": 0, "edition": first["edition"]}
        told = post(address, "decide", apart)
        assert "stale" not in told
        place = {"place": len(first["places"]) - 1, "decision": "apart", "part": 0}  # numbered as in the first page
        for path, asked in {"decide": place, "undo": {"part": 0}}.items():
            late = post(address, path, {**asked, "edition": first["edition"]})
            assert late == {**told, "stale": True}
        assert post(address, "undo", {"part": 1, "edition": told["edition"]})["edition"] == first["edition"]
        assert "error" in post(address, "undo", {"part": "x"})


def test_editing_goes_on_from_the_file_it_saves_to_and_each_decision_in_it_can_be_undone(team, tmp_path):
    file = tmp_path / "said.toml"
    box = {"box": [0.0, 0.0, 1.0, 1.0], "cells": "free", "part": 0}
    with served(team, decisions=file) as address:
        post(address, "decide", {"place": 0, "part": 0, "decision": "apart"})
        saved = post(address, "decide", box)
        post(address, "save", {})
    with served(team, decisions=file) as address:
        again = post(address, "state", {})
        assert (again["said"], again["undo"], again["scene"]) == (2, 2, saved["scene"])
        assert post(address, "undo", {})["said"] == 1
        assert post(address, "undo", {})["said"] == 0
    file.write_text(file.read_text().replace('"1" = "', '"1" = "0'))
    with pytest.raises(ReaderError, match="it is of another result"):
        mapweave.edit(team, decisions=file, port=0)


def test_what_is_not_saved_when_it_ends_is_saved_beside_what_another_session_saved(team, tmp_path):
    file, said = tmp_path / "said.toml", []
    apart = {"place": 0, "part": 0, "decision": "apart"}
    with served(team, decisions=file, say=said.append) as address:
        with served(team, decisions=file) as other:
            post(other, "decide", {"box": [0.0, 0.0, 1.0, 1.0], "cells": "free", "part": 0})
        theirs = file.read_bytes()
        post(address, "decide", apart)
    assert file.read_bytes() == theirs
    kept = Path(said[-1].partition("--decisions ")[2].partition(" goes on")[0])
    assert kept.parent == file.parent
    for begun in (kept, file):  # each goes on, and nothing is told where nothing is lost
        with served(team, decisions=begun, say=said.append) as address:
            again = post(address, "state", {})
            assert (again["said"], again["places"][0]["said"]) == (1, "apart" if begun == kept else "")
    assert [line for line in said if "saved" in line] == said[1:2]


def test_decisions_whose_file_cannot_be_written_at_the_end_are_kept_elsewhere(team, tmp_path):
    said = []
    (tmp_path / "file").write_text("in the way")
    with served(team, decisions=tmp_path / "file" / "said.toml", say=said.append) as address:
        post(address, "decide", {"place": 0, "part": 0, "decision": "apart"})
    kept = Path(said[-1].partition("--decisions ")[2].partition(" goes on")[0])
    with served(team, decisions=kept) as address:
        assert post(address, "state", {})["said"] == 1
    shutil.rmtree(kept.parent)


@pytest.mark.parametrize(
    ("path", "asked", "told"),
    [
        ("decide", {"place": 10**6, "decision": "apart"}, "place: expected a number from 0 to"),
        ("decide", {"place": True, "decision": "apart"}, "place: expected a number"),
        ("decide", {"place": 0, "decision": "maybe"}, "decision: expected one of together, apart, undecided"),
        ("decide", {"place": 0, "part": 5, "decision": "apart"}, "part: expected a number from 0 to 0"),
        ("decide", {"pair": ["1", "9"], "decision": "apart"}, "expected a place or a pair of robots"),
        ("decide", {"lay": 0, "pose": [0, 0, 0]}, "another map than the one it is laid on"),
        ("decide", {"lay": 0, "pose": [0, "x", 0]}, "pose: expected x, y, theta"),
        ("decide", {"lay": 0, "pose": [0, 1e999, 0]}, "pose: expected x, y, theta"),
        ("decide", {"lay": 0, "pose": [0, 10**400, 0]}, "pose: expected x, y, theta"),
        ("decide", {"box": [0, 0, 1, 10**400], "cells": "free"}, "box: expected x0, y0, x1, y1"),
        ("decide", {"box": [0, 0, 1], "cells": "free"}, "box: expected x0, y0, x1, y1"),
        ("decide", {"box": [0, 0, 1, 1e999], "cells": "free"}, "box: expected x0, y0, x1, y1"),
        ("decide", {"box": [0, 0, 1, 1], "cells": "gone"}, "cells: expected one of free, unknown"),
        ("undo", {}, "nothing to undo"),
        ("undo", {"part": "x"}, "part: expected a number"),
    ],
)  # fmt: skip
def test_what_cannot_be_decided_is_told_and_changes_nothing(one_server, path, asked, told):
    assert told in post(one_server, path, asked)["error"]
    assert post(one_server, "state", {})["said"] == 0


@pytest.fixture(scope="module")
def one_server(team):
    with served(team) as address:
        yield address


def test_the_page_needs_no_network_and_answers_to_nobody_elses_page(one_server):
    with urllib.request.urlopen(one_server, timeout=10) as answer:  # noqa: S310
        page, policy = answer.read().decode(), answer.headers["Content-Security-Policy"]
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in page
    assert "default-src 'none'" in policy
    assert post(one_server, "undo", {}, Host="evil.example") == 421
    assert post(one_server, "undo", {}, Origin="http://evil.example") == 403
    assert post(one_server, "undo", {}, Origin="null") == 403
    assert post(one_server, "undo", {}, **{"Content-Type": "text/plain"}) == 403
    assert post(one_server, "undo", [1]) == 400
    assert post(one_server, "elsewhere", {}) == 404
    host = one_server.removeprefix("http://").rstrip("/")
    assert "nothing to undo" in post(one_server, "undo", {}, Origin=f"http://{host}")["error"]


def test_a_result_without_places_is_refused_in_a_sentence(logs, tmp_path):
    mapweave.map(logs[:1], tmp_path / "gated", method="gated")
    with pytest.raises(UsageError, match="expected laser maps of the graph method"):
        mapweave.edit(tmp_path / "gated", port=0)


def test_a_file_that_cannot_be_written_is_told_in_the_page(team, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with served(team, decisions=tmp_path / "file" / "said.toml") as address:
        assert "file" in post(address, "save", {})["error"]
