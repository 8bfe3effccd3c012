"""The documentation names files that are there."""

import re
from pathlib import Path

import pytest

TOP = Path(__file__).parent.parent
SOURCE = TOP / "src" / "mapweave"
NAMED = re.compile(r"`((?:[a-z_]+/)+(?:[a-z_0-9]+\.py)?)`")
PAGES = sorted([*TOP.glob("docs/**/*.md"), TOP / "README.md"])
FOLDERS_OF_RESULTS = {"trajectories/", "state/", "figures/", "log/", "recording/", "result/", "local/", "components/"}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_file_and_folder_a_page_names_is_there(page):
    missing = [
        name
        for name in NAMED.findall(page.read_text(encoding="utf-8"))
        if not ((SOURCE / name).exists() or (TOP / name).exists() or name.split("/")[0] + "/" in FOLDERS_OF_RESULTS)
    ]
    assert not missing
