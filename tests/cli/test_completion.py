"""Commands and options are completed in the user's shell."""

import shutil
import subprocess
import sys

import pytest

ASK = """
source "$0"
COMP_WORDS=(mapweave {words}); COMP_CWORD={at}
_mapweave
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("shell") / "mapweave.bash"
    done = subprocess.run(
        [sys.executable, "-m", "mapweave", "completion", "bash"], capture_output=True, text=True, check=True
    )
    path.write_text(done.stdout)
    return path


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(
    ("words", "found"), [("loc", {"locate", "localize"}), ("map --meth", {"--method"}), ("simulate off", {"office"})]
)
def test_bash_completes_commands_and_options(script, words, found):
    ask = ASK.format(words=words, at=len(words.split()))
    bash = shutil.which("bash")
    done = subprocess.run([bash, "-c", ask, str(script)], capture_output=True, text=True, check=True)  # noqa: S603
    assert set(done.stdout.split()) == found


def test_an_unknown_shell_is_one_line():
    words = [sys.executable, "-m", "mapweave", "completion", "csh"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
