"""What all tests share: runtime shape checks, the real logs, the command line."""

import os
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

from . import typecheck

# Shapes and types of every public function are checked while the tests run; in production they cost nothing.
CHECKED = ("core", "solve", "landmarks", "fusion", "laser", "swarm", "team", "evaluation")
if os.environ.get("MAPWEAVE_TYPECHECK", "1") == "1":
    install_import_hook([f"mapweave.{room}" for room in CHECKED], f"{typecheck.__name__}.checked")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder with the real logs; tests that need it skip, and say so, when it is not there."""
    where = os.environ.get("MAPWEAVE_DATA")
    if not where or not Path(where).is_dir():
        pytest.skip("real logs are not here: set MAPWEAVE_DATA to the folder that holds them")
    return Path(where)
