"""`configuration`: every setting of a job with its default and meaning, as a file to edit and hand back."""

from importlib import import_module

from ..core.config_text import as_toml
from ..core.errors import UsageError
from ..core.paths import checked_arguments

JOBS: dict[tuple[str, bool], str] = {
    # (verb, on laser logs or in laser worlds): the configuration it reads
    ("map", False): "mapweave.api.map_landmarks:LandmarkMapConfig",
    ("map", True): "mapweave.api.map_laser:LaserMapConfig",
    ("fuse", False): "mapweave.fusion.config:FuseConfig",
    ("fuse", True): "mapweave.api.map_laser:LaserMapConfig",
    ("locate", False): "mapweave.api.locate:LocateConfig",
    ("localize", True): "mapweave.api.localize:LocalizeJobConfig",
    ("explore", False): "mapweave.exploration.landmarks.config:ExploreConfig",
    ("explore", True): "mapweave.exploration.laser.config:LaserMissionConfig",
}


@checked_arguments
def configuration(job: str, *, laser: bool = False) -> str:
    """Every setting of a job with its default and its meaning, as TOML to edit and hand back as `config`.

    Parameters
    ----------
    job
        map, fuse, locate, localize or explore.
    laser
        The keys for laser logs (map, fuse) or laser worlds (explore); `localize` has no others. Of `[laser]` it prints
        what it reads; a file with all that `map` reads there is taken, too.

    Raises
    ------
    UsageError
        For a job that reads no configuration.

    Examples
    --------
    >>> print(configuration("map").splitlines()[0])
    # mapweave map: every key with its default; change,
    """
    return as_toml(configuration_class(job, laser=laser)(), _head(job, laser=laser))


def configuration_class(job: str, *, laser: bool = False) -> type:
    """The class of the configuration that `job` reads."""
    where = JOBS.get((job, laser or job == "localize"))
    if where is None:
        known = ", ".join(f"{verb} --laser" if of_laser else verb for verb, of_laser in JOBS if verb != "localize")
        asked = f"{job} --laser" if laser else job
        raise UsageError(f"expected one of {known}, localize, found {asked!r}")
    module, _, name = where.partition(":")
    found_class: type = getattr(import_module(module), name)
    return found_class


def _head(job: str, *, laser: bool) -> str:
    named = f"{job} --laser" if laser and job != "localize" else job
    return (
        f"mapweave {named}: every key with its default; change,\n"
        f"delete or keep any, and hand the file to `mapweave {job}` with --config."
    )
