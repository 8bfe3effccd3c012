"""The user's own folder for what need not be computed again: shared by all environments and installations."""

import os
import time
from pathlib import Path

FORGOTTEN = 14 * 86400.0  # [s] after which what was not written again is nobody's any more


def own_folder(name: str) -> Path | None:
    """`~/.cache/mapweave/NAME`, or below the folder of MAPWEAVE_CACHE_DIR; None where there is none to be trusted.

    What is read from there is run: a folder that others may write to is not used.
    """
    try:
        named = os.environ.get("MAPWEAVE_CACHE_DIR")
        cached = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(named or Path(cached) / "mapweave") / name
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        state = folder.stat()
        if hasattr(os, "getuid") and (state.st_uid != os.getuid() or state.st_mode & 0o022):
            return None
    except (OSError, RuntimeError):
        return None
    return folder


def is_forgotten(path: Path) -> bool:
    """Whether `path` was written long ago."""
    return time.time() - path.stat().st_mtime > FORGOTTEN
