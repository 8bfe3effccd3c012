"""`mapweave simulate swarm` writes what `locate` reads."""

import pytest

from mapweave.cli import _run
from mapweave.io.sightings import read_sightings, read_swarm_truth


def simulate(tmp_path, *words):
    out = tmp_path / "s.csv"
    return _run(["simulate", "swarm", "--out", str(out), *words]), out


def test_sightings_and_truth_are_written_with_the_contracts_columns(tmp_path, capsys):
    code, out = simulate(tmp_path, "--robots", "20", "--dim", "2", "--sigma", "0.5deg", "--seed", "3")
    assert code == 0
    assert out.read_text().splitlines()[0] == "observer,target,bearing,sigma"
    truth = tmp_path / "s.truth.csv"
    assert truth.read_text().splitlines()[0] == "id,x,y"
    assert set(read_sightings(out).table.ids) == set(read_swarm_truth(truth).ids)
    assert "--anchor 1=" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sightings", "truth"),
    [
        (["--dim", "3", "--robots", "27"], "observer,target,azimuth,elevation,sigma", "id,x,y,z"),
        (
            ["--dim", "3", "--no-axis", "--robots", "27"],
            "observer,target,azimuth,elevation,sigma",
            "id,x,y,z,rx,ry,rz",
        ),
        (["--no-axis"], "observer,target,bearing,sigma", "id,x,y,heading"),
        (["--steps", "3"], "observer,target,bearing,sigma,t", "id,x,y,t"),
        (["--layout", "clusters", "--range", "15", "--single"], "observer,target,bearing,sigma", "id,x,y"),
        (["--layout", "random", "--mutual", "--blockers", "3"], "observer,target,bearing,sigma", "id,x,y"),
    ],
)
def test_every_kind_of_swarm_has_its_columns(tmp_path, words, sightings, truth):
    code, out = simulate(tmp_path, *words)
    assert code == 0
    assert out.read_text().splitlines()[0] == sightings
    assert (tmp_path / "s.truth.csv").read_text().splitlines()[0] == truth


def test_driving_robots_leave_their_odometry(tmp_path):
    code, _ = simulate(tmp_path, "--drive", "--steps", "4", "--robots", "9")
    assert code == 0
    assert (tmp_path / "s.odometry.csv").read_text().splitlines()[0] == "t,robot,v,w"


def test_equal_seeds_give_equal_bytes(tmp_path):
    _, out = simulate(tmp_path, "--seed", "5", "--outliers", "0.1")
    first = out.read_bytes()
    simulate(tmp_path, "--seed", "5", "--outliers", "0.1")
    assert out.read_bytes() == first


@pytest.mark.parametrize(
    "words",
    [
        ["--mutual", "--single"],
        ["--sigma", "0.5"],
        ["--dim", "4"],
        ["--missing", "2"],
        ["--layout", "ring"],
        ["--dim", "3", "--drive"],
    ],
)
def test_bad_usage_ends_with_2_and_writes_nothing(tmp_path, words):
    code, out = simulate(tmp_path, *words)
    assert code == 2
    assert not out.exists()
