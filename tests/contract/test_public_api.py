"""What `import mapweave` offers."""

import subprocess
import sys

import mapweave
import mapweave.evaluation.team
import mapweave.fusion.join


def test_every_public_verb_can_be_had_and_is_a_function():
    for name in mapweave._VERBS:
        assert callable(getattr(mapweave, name)), name
        assert name in dir(mapweave)


def test_a_room_with_a_verbs_name_does_not_take_its_place():
    assert mapweave.fuse is not sys.modules["mapweave.fusion"]
    assert mapweave.evaluate is not sys.modules["mapweave.evaluation"]
    assert mapweave.fuse.__doc__.startswith("One map from the local maps")


def test_importing_and_asking_for_help_imports_nothing_heavy():
    heavy = ("numpy", "scipy", "numba", "matplotlib", "pydantic")
    code = (
        "import sys\n"
        "from mapweave.cli import _run\n"
        "for word in (['--help'], ['map', '--help'], ['simulate', 'landmarks', '--help'], ['demo', '--help']):\n"
        "    assert _run(word) == 0\n"
        f"print([m for m in {heavy!r} if m in sys.modules], file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr.strip() == "[]"


def test_the_verbs_work_from_python(tmp_path):
    team = mapweave.simulate_landmarks(tmp_path / "team", robots=2, landmarks=8, minutes=0.5, seed=1)
    assert len(team.robots) == 2
    result = mapweave.map(tmp_path / "team", truth=tmp_path / "team")
    assert result.maps[0].robots == ("robot1", "robot2")
    assert result.score.landmarks.rmse < 1.0
    assert not (tmp_path / "result").exists()
