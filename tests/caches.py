"""Folders for MAPWEAVE_CACHE_DIR that begin empty, but for the kernels that are compiled already."""

from pathlib import Path

from mapweave.kernels.compiling import own_folder


def own_cache(folder: Path) -> Path:
    """`folder / "cache"`, made, in which the kernels are those of the cache that is in use now.

    A test that compiled its own would take minutes; whoever is to compile is given a folder without this.
    """
    cache, kernels = folder / "cache", own_folder("kernels")
    cache.mkdir()
    if kernels is not None:
        (cache / "kernels").symlink_to(kernels)
    return cache
