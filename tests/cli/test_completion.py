"""Commands and options are completed in the user's shell."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ASK = """
source "$0"
COMP_WORDS=(mapweave {words}); COMP_CWORD={at}
_mapweave
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


TOP = Path(__file__).parents[2]


def printed(shell):
    words = [sys.executable, "-m", "mapweave", "completion", shell]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout  # noqa: S603


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("shell") / "mapweave.bash"
    path.write_text(printed("bash"))
    return path


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("loc", {"locate", "localize"}),
        ("map --meth", {"--method"}),
        ("simulate off", {"office"}),
        ("map team --out result --tr", {"--truth"}),  # a folder that is called as a command is
        ("explore office --pl", {"--planner"}),
        ("map team office --config pyproj", {"pyproject.toml"}),
    ],
)
def test_bash_completes_commands_and_options(script, words, found):
    ask = ASK.format(words=words, at=len(words.split()))
    bash = shutil.which("bash")
    done = subprocess.run([bash, "-c", ask, str(script)], capture_output=True, text=True, check=True, cwd=TOP)  # noqa: S603
    assert set(done.stdout.split()) == found


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
def test_bash_completes_a_file_whose_name_has_a_blank_as_one_word(script, tmp_path):
    (tmp_path / "robot 1.bag").touch()
    words = [shutil.which("bash"), "-c", ASK.format(words="map rob", at=2), str(script)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, cwd=tmp_path)  # noqa: S603
    assert done.stdout.splitlines() == ["robot 1.bag"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh on this machine")
def test_zsh_takes_the_script_as_it_is_sourced(tmp_path):
    script = printed("zsh")
    (tmp_path / "mapweave.zsh").write_text(script)
    ask = 'autoload -U compinit; compinit -u -D; source "$0"; print $_comps[mapweave]; whence -w $_comps[mapweave]'
    words = [shutil.which("zsh"), "-f", "-c", ask, str(tmp_path / "mapweave.zsh")]
    done = subprocess.run(words, capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.split() == ["_cyclopts_mapweave", "_cyclopts_mapweave:", "function"]
    assert done.stderr == ""


def test_zsh_expects_no_value_after_a_flag():
    assert [line for line in printed("zsh").splitlines() if "--axis[" in line and line.endswith(":axis' \\")] == []


@pytest.mark.skipif(shutil.which("fish") is None, reason="no fish on this machine")
@pytest.mark.parametrize(("words", "found"), [("map team --ou", "--out"), ("explore office --pl", "--planner")])
def test_fish_completes_after_a_folder_that_is_called_as_a_command_is(tmp_path, words, found):
    (tmp_path / "mapweave.fish").write_text(printed("fish"))
    ask = f"source {tmp_path}/mapweave.fish; complete -C 'mapweave {words}'"
    words = [shutil.which("fish"), "--no-config", "-c", ask]
    done = subprocess.run(words, capture_output=True, text=True, check=True)  # noqa: S603
    assert [line.split()[0] for line in done.stdout.splitlines()] == [found]


def test_an_unknown_shell_is_one_line():
    words = [sys.executable, "-m", "mapweave", "completion", "csh"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
