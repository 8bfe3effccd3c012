"""Bad input at the command line: one clear line, the right exit status, nothing left half-written."""

import json
import shutil
from pathlib import Path

import pytest

from .terminal import run


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    team = tmp_path_factory.mktemp("world") / "team"
    words = ("--robots", 2, "--landmarks", 10, "--minutes", 0.5, "--seed", 4)
    assert run("simulate", "landmarks", "--out", team, *words)[0] == 0
    return team


@pytest.fixture
def team(recording, tmp_path):
    return shutil.copytree(recording, tmp_path / "in" / "team")


def edited(path, edit):
    lines = path.read_text().splitlines()
    path.write_text("\n".join(edit(lines)) + "\n")


def refused(tmp_path, *words, code=1):
    """What stderr says of a command that must fail and leave nothing behind."""
    before = sorted(p.name for p in tmp_path.iterdir())
    status, _, err = run(*words)
    assert status == code, err
    assert err.startswith("mapweave: ")
    assert err.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    return err


def test_a_word_in_a_line_is_named_with_file_and_line(team, tmp_path):
    def word(lines):
        lines[20] = lines[20].split()[0] + "\tfast\t0.1"
        return lines

    edited(team / "Robot2_Odometry.dat", word)
    err = refused(tmp_path, "map", team, "--out", tmp_path / "out")
    assert "Robot2_Odometry.dat:21: " in err
    assert "'fast'" in err


@pytest.mark.parametrize(("unit", "of"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)])
def test_stamps_in_another_unit_are_named(team, tmp_path, unit, of):
    def counted(lines):
        rows = [row.split() for row in lines]
        return [
            line if row[0] == "#" else "\t".join([f"{float(row[0]) * of:.0f}", *row[1:]])
            for line, row in zip(lines, rows, strict=True)
        ]

    for path in team.glob("Robot*_[OM]*.dat"):
        edited(path, counted)
    err = refused(tmp_path, "map", team, "--out", tmp_path / "out")
    assert f"Robot1_Odometry.dat: stamps are in {unit}" in err
    log = tmp_path / "in" / "log.clf"
    log.write_text("".join(f"FLASER 3 2 2 2 0 0 0 0 0 0 {(1.7e9 + k) * of:.0f} host 0\n" for k in range(9)))
    err = refused(tmp_path, "map", log, "--out", tmp_path / "out")
    assert f"log.clf: stamps are in {unit}" in err


def test_a_truncated_zip_is_refused(team, tmp_path):
    whole = shutil.make_archive(str(tmp_path / "in" / "cut"), "zip", team.parent, "team")
    Path(whole).write_bytes(Path(whole).read_bytes()[:2000])
    assert "cut.zip" in refused(tmp_path, "map", whole, "--out", tmp_path / "out")


@pytest.mark.parametrize("name", ["no_such.zip", "no_such_folder"])
def test_a_log_that_is_not_there_is_named(tmp_path, name):
    assert name in refused(tmp_path, "map", tmp_path / name, "--out", tmp_path / "out")


def test_missing_barcodes_are_an_error(team, tmp_path):
    (team / "Barcodes.dat").unlink()
    assert "Barcodes.dat" in refused(tmp_path, "map", team, "--out", tmp_path / "out")


def test_two_data_sets_mixed_are_an_error(team, tmp_path):
    other = shutil.copytree(team, tmp_path / "in" / "other")
    assert "two data sets are mixed" in refused(tmp_path, "map", team, other, "--out", tmp_path / "out")


def test_a_folder_that_is_no_log_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "notes.txt").write_text("nothing\n")
    assert "expected" in refused(tmp_path, "map", tmp_path / "in", "--out", tmp_path / "out")


def test_nan_negative_ranges_and_unsorted_stamps_are_mended_and_counted(team, tmp_path):
    def worse(lines):
        for at, column, value in ((10, 2, "nan"), (12, 2, "-1.0")):
            words = lines[at].split()
            words[column] = value
            lines[at] = "\t".join(words)
        lines[-1], lines[-4] = lines[-4], lines[-1]
        return lines

    edited(team / "Robot1_Measurement.dat", worse)
    assert run("map", team, "--out", tmp_path / "out")[0] == 0
    robot = json.loads((tmp_path / "out" / "metrics.json").read_text())["robots"]["1"]
    assert sum(robot["dropped"].values()) >= 2
    assert robot["dropped"] != json.loads((tmp_path / "out" / "metrics.json").read_text())["robots"]["2"]["dropped"]


def test_a_robot_that_saw_nothing_stands_alone_and_the_others_get_their_map(team, tmp_path):
    (team / "Robot2_Measurement.dat").write_text("# nothing\n")
    code, _, err = run("map", team, "--out", tmp_path / "out")
    assert (code, err) == (0, "")
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["components"] == [["1"], ["2"]]
    assert {d["robot"]: d["decision"] for d in metrics["fusion"]}["2"] == "refused"
    assert (tmp_path / "out" / "components" / "2" / "trajectories" / "robot2.tum").exists()


def test_a_robot_without_odometry_is_mapped_and_marked(team, tmp_path):
    (team / "Robot2_Odometry.dat").unlink()
    assert run("map", team, "--out", tmp_path / "out")[0] == 0
    robots = json.loads((tmp_path / "out" / "metrics.json").read_text())["robots"]
    assert robots["2"]["odometry"] == "none"
    assert robots["1"]["odometry"] != "none"
    assert any("no odometry" in w for w in robots["2"]["warnings"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--weights", "heaviest"), "weights"),
        (("--method", "magic"), "--method"),
        (("--jobs", "0"), "--jobs"),
        (("--fuse-every", "-3"), "--fuse-every"),
        (("--every", "0"), "--every"),
        (("--share", "1:2.0"), "--share"),
        (("--share", "1=0.5"), "--share"),
        (("--share", "9:0.5"), "no robot 9"),
        (("--start", "robot2=1,2"), "--start"),
        (("--robots", "one"), "--robots"),
        (("--seed", "many"), "--seed"),
        (("--frobnicate",), "--frobnicate"),
    ],
)
def test_a_bad_option_is_a_usage_error(recording, tmp_path, words, said):
    assert said in refused(tmp_path, "map", recording, "--out", tmp_path / "out", *words, code=2)


def test_asking_for_a_robot_that_is_not_there_is_an_error_of_the_data(recording, tmp_path):
    assert "robot" in refused(tmp_path, "map", recording, "--out", tmp_path / "out", "--robots", "7")


def test_whatever_the_logs_a_robot_that_is_asked_for_and_not_there_is_an_error_of_the_data(recording, tmp_path):
    laser = tmp_path / "in" / "laser.clf"
    laser.parent.mkdir()
    beams = " ".join(["2.0"] * 180)
    laser.write_text("".join(f"FLASER 180 {beams} {k} 0 0 {k} 0 0 {k} here 0\n" for k in range(3)))
    for logs in ((laser,), (laser, laser), (recording, laser)):
        assert "no robot 9" in refused(tmp_path, "map", *logs, "--out", tmp_path / "out", "--robots", "9")


def test_a_configuration_is_refused_with_all_its_mistakes_at_once(recording, tmp_path):
    (tmp_path / "c.toml").write_text("[ekf]\nrange_floor = 'far'\n[fuse]\nspeed = 1\n")
    err = refused(tmp_path, "map", recording, "--out", tmp_path / "out", "--config", tmp_path / "c.toml", code=2)
    assert "c.toml" in err
    assert "ekf.range_floor" in err
    assert "fuse.speed" in err


@pytest.mark.slow
def test_a_folder_with_something_else_in_it_is_not_overwritten_without_force(recording, tmp_path):
    target = tmp_path / "mine"
    target.mkdir()
    (target / "thesis.tex").write_text("years of work\n")
    assert "--force" in refused(tmp_path, "map", recording, "--out", target, code=2)
    assert (target / "thesis.tex").read_text() == "years of work\n"
    assert run("map", recording, "--out", target, "--force")[0] == 0
    assert (target / "metrics.json").exists()
    assert run("map", recording, "--out", target)[0] == 0


def test_an_earlier_result_stays_when_the_new_one_fails(recording, team, tmp_path):
    assert run("map", recording, "--out", tmp_path / "out")[0] == 0
    held = {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    (team / "Barcodes.dat").unlink()
    refused(tmp_path, "map", team, "--out", tmp_path / "out")
    assert held == {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}


def test_interrupted_it_says_so_and_leaves_the_earlier_result(recording, tmp_path, monkeypatch):
    assert run("map", recording, "--out", tmp_path / "out")[0] == 0
    held = (tmp_path / "out" / "metrics.json").read_bytes()

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("mapweave.api.team.write_team_report", stop)
    code, _, err = run("map", recording, "--out", tmp_path / "out")
    assert (code, err) == (130, "mapweave: interrupted\n")
    assert (tmp_path / "out" / "metrics.json").read_bytes() == held
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_fusing_what_is_no_result_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    assert "local maps" in refused(tmp_path, "fuse", tmp_path / "empty", "--out", tmp_path / "out")
    assert "no such file or folder" in refused(tmp_path, "fuse", tmp_path / "nowhere", "--out", tmp_path / "out")


def test_a_damaged_local_map_is_named(recording, tmp_path):
    run("map", recording, "--out", tmp_path / "a", "--robots", "1")
    (tmp_path / "a" / "local" / "robot1" / "local_map.npz").write_bytes(b"PK damaged")
    assert "local_map.npz" in refused(tmp_path, "fuse", tmp_path / "a", "--out", tmp_path / "out")


def test_evaluating_what_is_no_result_or_against_nothing_is_refused(recording, tmp_path):
    (tmp_path / "empty").mkdir()
    assert "metrics.json" in refused(tmp_path, "evaluate", tmp_path / "empty", "--truth", recording)
    run("map", recording, "--out", tmp_path / "a", "--robots", "1")
    assert "nothing.zip" in refused(tmp_path, "evaluate", tmp_path / "a", "--truth", tmp_path / "nothing.zip")
    (tmp_path / "s.csv").write_text("id,x,y\n6,1.0,2.0\n7,one,2.0\n")
    assert "s.csv:3" in refused(tmp_path, "evaluate", tmp_path / "a", "--truth", tmp_path / "s.csv")


@pytest.mark.parametrize(
    ("name", "text", "said", "code"),
    [
        ("s.csv", "id,x,y\n6,1.0,2.0\n7,one,2.0\n", "s.csv:3", 1),
        ("robot1.tum", "0 1 2 3\n", "robot1.tum:1", 1),
        ("t.relations", "1 2 3\n", "t.relations:1", 1),
        ("truth.clf", "ODOM 1 2 3\n", "truth.clf: no kind of truth", 2),
    ],
)
def test_truth_that_cannot_be_read_is_refused_before_the_log_costs_any_time(tmp_path, name, text, said, code):
    (tmp_path / name).write_text(text)
    (tmp_path / "log.clf").write_text("no log at all\n")
    assert said in refused(
        tmp_path, "map", tmp_path / "log.clf", "--out", tmp_path / "out", "--truth", tmp_path / name, code=code
    )


@pytest.mark.slow
@pytest.mark.drawn
def test_a_score_is_added_to_the_report_and_takes_the_place_of_an_earlier_one(recording, tmp_path):
    out = tmp_path / "out"
    run("map", recording, "--out", out, "--no-refine")
    plain = (out / "report.html").read_text()
    before = json.loads((out / "metrics.json").read_text())
    assert "evaluation" not in before
    for _ in range(2):
        code, told, err = run("evaluate", out, "--truth", recording, "--json")
        assert (code, err) == (0, "")
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["evaluation"] == json.loads(told)
    assert {k: v for k, v in metrics.items() if k != "evaluation"} == before
    page = (out / "report.html").read_text()
    assert page.count("<h2>Score against team</h2>") == 1
    assert page.index("Score against team") < page.index("<footer>")
    assert page.index("Score against team") < page.index("<h2>Files</h2>")
    assert page.index("<p>Against team: ") < page.index('<div class="cards">')
    for name in ("score", "score-top"):
        page = page.partition(f"<!-- {name}: begin -->")[0] + page.partition(f"<!-- {name}: end -->")[2]
    assert page == plain
    assert (out / "figures" / "score.png").stat().st_size > 1000
    (out / "report.html").unlink()
    assert run("evaluate", out, "--truth", recording)[0] == 0
    assert not (out / "report.html").exists()


def test_a_result_that_cannot_be_written_is_scored_all_the_same(recording, tmp_path, monkeypatch):
    out = tmp_path / "out"
    run("map", recording, "--out", out, "--no-refine")
    before = (out / "metrics.json").read_bytes()

    def full(*_, **__):
        raise OSError(28, "No space left on device", None)

    monkeypatch.setattr("mapweave.io.directory.tempfile.mkstemp", full)
    code, told, err = run("evaluate", out, "--truth", recording)
    assert code == 0
    assert "ATE" in told
    assert err.startswith("mapweave: ")
    assert err.endswith("cannot be written: No space left on device: the report is left as it is\n")
    assert (out / "metrics.json").read_bytes() == before


def test_viewing_what_is_no_result_is_refused(tmp_path):
    assert "metrics.json" in refused(tmp_path, "view", tmp_path)


def test_version_and_help_need_no_data():
    assert run("--version")[1].startswith("mapweave ")
    for command in ("map", "fuse", "evaluate", "view", "demo", "simulate"):
        code, out, _ = run(command, "--help")
        assert code == 0
        assert "Usage: mapweave" in out
