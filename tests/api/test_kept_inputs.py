"""What a command reads is still there when it ends: a result never takes the place of its own input."""

import pytest

import mapweave
from mapweave.core.errors import UsageError


def everything(folder):
    return {p.relative_to(folder): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def team(tmp_path):
    mapweave.simulate_landmarks(tmp_path / "team", robots=1, landmarks=4, minutes=0.1)
    return tmp_path / "team"


def test_mapping_a_simulated_team_onto_itself_is_refused_and_leaves_it_whole(team):
    before = everything(team)
    for reads in ({"logs": team}, {"logs": [team.parent / "other", team]}, {"logs": "other", "truth": team}):
        with pytest.raises(UsageError, match="the result would replace it"):
            mapweave.map(out=team, **reads)
    assert everything(team) == before


def test_every_verb_refuses_to_replace_what_it_reads(team):
    inside = team / "file.csv"
    inside.write_text("x")
    jobs = (
        lambda: mapweave.localize("log.mcap", team, out=team),
        lambda: mapweave.fuse([team / "a", team / "b"], out=team),
        lambda: mapweave.locate(inside, out=team),
        lambda: mapweave.solve_pose_graph(inside, out=team),
        lambda: mapweave.explore(str(inside), out=team),
    )
    for job in jobs:
        with pytest.raises(UsageError, match="the result would replace it"):
            job()


def test_a_built_in_scenario_may_be_explored_into_a_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert mapweave.explore("yuan", out="yuan", until=1).metrics["summary"]["runs"] == 1
