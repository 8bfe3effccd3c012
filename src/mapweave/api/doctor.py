"""`doctor`: what mapweave runs on, and whether a compiled kernel does what it should; or what bends a map."""

import os
import platform
import re
from dataclasses import dataclass
from importlib.metadata import EntryPoint, PackageNotFoundError, requires, version
from pathlib import Path
from time import perf_counter
from typing import Any, overload

import numpy as np

from ..core.paths import checked_arguments
from ..core.plugins import KINDS, is_ours, plugged
from ..core.version import __version__
from ..io.directory import write_json
from ..kernels._jit import cache_root, threads
from ..kernels.walls.segments import cast
from ..report.result import ResultBase, Rows
from ..report.small_pages import draw_checks, write_small_page
from ..report.style import Target
from .causes import Causes, causes_of
from .read import Log
from .result import MapResult

NEED = re.compile(r"^(?P<name>[\w.-]+)(?:\[[^]]*\])?(?P<range>[^;]*)(?:;.*extra\s*==\s*['\"](?P<extra>[\w-]+)['\"])?")
FOR_USERS = ("viewer", "parquet", "pandas", "xarray", "gym", "cluster", "live")
WALL = 2.0  # [m] ahead of the scanner of the trial


@dataclass(frozen=True, slots=True)
class Package:
    """A package that is needed (extra: "") or that an extra brings. version: None where it is not installed."""

    name: str
    extra: str
    least: str
    version: str | None

    @property
    def good(self) -> bool:
        """Whether it is there and new enough."""
        return self.version is not None and _numbers(self.version) >= _numbers(self.least)


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosis(ResultBase):
    """What `doctor` found. cache: where compiled kernels are kept; first, second: [s] that two calls of one took."""

    python: str
    system: str
    packages: tuple[Package, ...]
    cores: int
    threads: int
    cache: Path | None
    kernels: int
    cache_bytes: int
    writable: bool
    first: float
    second: float
    kernel_error: str
    plugins: dict[str, dict[str, str]]  # kind -> name -> package and version, "" where it is this one

    @property
    def healthy(self) -> bool:
        """Whether everything that is needed is there and the kernel gave the right answer."""
        return not self.kernel_error and all(p.good for p in self.packages if not p.extra)

    @property
    def metrics(self) -> dict[str, Any]:
        return {
            "version": __version__,
            "python": self.python,
            "system": self.system,
            "packages": {p.name: p.version for p in self.packages if not p.extra},
            "extras": {extra: all(p.good for p in got) for extra, got in self._extras().items()},
            "cores": self.cores,
            "threads": self.threads,
            "cache": None if self.cache is None else str(self.cache),
            "cached_kernels": self.kernels,
            "cache_bytes": self.cache_bytes,
            "cache_writable": self.writable,
            "first_call_s": self.first,
            "second_call_s": self.second,
            "kernel_error": self.kernel_error,
            "plugins": self.plugins,
            "healthy": self.healthy,
        }

    def lines(self) -> list[str]:
        """All of it, a line each."""
        needed = ", ".join(f"{p.name} {_version_text(p)}" for p in self.packages if not p.extra)
        extras = ", ".join(
            f"{extra} {'installed' if all(p.good for p in got) else 'not installed'}"
            for extra, got in self._extras().items()
        )
        kept = "nowhere (nothing is compiled)"
        if self.cache is not None:
            state = "writable" if self.writable else "NOT writable: every run compiles anew (set NUMBA_CACHE_DIR)"
            kept = f"{self.cache}, {self.kernels} kernels, {self.cache_bytes / 1e6:.1f} MB, {state}"
        tried = self.kernel_error or f"first call {self.first:.3f} s, second {1e3 * self.second:.3f} ms"
        return [
            f"mapweave {__version__}, Python {self.python}, {self.system}",
            f"packages: {needed}",
            f"extras: {extras}",
            f"cores: {self.cores}, threads of parallel kernels: {self.threads}",
            f"compiled kernels: {kept}",
            f"a kernel tried: {tried}",
            *(
                f"{kind}: " + ", ".join(f"{name} ({whose})" if whose else name for name, whose in found.items())
                for kind, found in self.plugins.items()
            ),
            "all is well" if self.healthy else "something is wrong: see above",
        ]

    def checks(self) -> list[tuple[str, str, bool | None]]:
        """What was looked at, what was found, and whether that is good; None: an extra that is not installed."""
        kernel = self.kernel_error or "gave the right answer"
        return [
            *((p.name, _version_text(p), p.good) for p in self.packages if not p.extra),
            *(
                (
                    f"extra {extra}",
                    ", ".join(f"{p.name} {_version_text(p).replace('MISSING', 'not installed')}" for p in got),
                    all(p.good for p in got) or None,
                )
                for extra, got in self._extras().items()
            ),
            ("cache of compiled kernels", "writable" if self.writable else "not writable", self.writable),
            ("a kernel tried", kernel, not self.kernel_error),
        ]

    def headline(self) -> Rows:
        words = {True: "good", False: "wrong", None: "not installed"}
        return ("what", "found", "verdict"), [(name, value, words[good]) for name, value, good in self.checks()]

    def draw(self, target: Target) -> None:
        """Every check and how it came out, and how long a kernel took at first and then."""
        draw_checks(target, self.checks(), [("first call", self.first), ("second call", self.second)])

    def write_into(self, folder: Path) -> None:
        """metrics.json, report.html and its picture: what to send along with a question."""
        png = folder / "figures" / "checks.png"
        self.draw(png)
        write_small_page(folder, "What mapweave runs on", self.lines(), self.headline(), png)
        write_json(folder / "metrics.json", self.metrics)

    def _extras(self) -> dict[str, list[Package]]:
        named = {p.extra for p in self.packages}
        return {e: [p for p in self.packages if p.extra == e] for e in FOR_USERS if e in named}


@overload
def doctor(subject: None = None) -> Diagnosis: ...
@overload
def doctor(subject: Path | str | MapResult | Log) -> Causes: ...
@checked_arguments
def doctor(subject: Path | str | MapResult | Log | None = None) -> Diagnosis | Causes:
    """Tell why a map is bent: the likeliest cause, its evidence, and what mends it.

    Without a map, check the installation: versions, extras, cores, threads, kernel cache, a kernel compiled and tried.

    Parameters
    ----------
    subject
        A result of `map` or `fuse`, in memory or its folder; or a log, which is mapped first (the installation).

    Raises
    ------
    ReaderError
        For a folder or a log that is missing or damaged.
    DataError
        For logs that cannot be mapped, unless their unit is the reason.
    UsageError
        For a result of another kind than a map.

    Examples
    --------
    >>> doctor().healthy
    True
    >>> drive = simulate_laser("drive.mcap", CorridorConfig(distance=4.0), seed=1)
    >>> [cause.name for cause in doctor("drive.mcap").causes]
    ['corridor']
    """
    if subject is not None:
        return causes_of(subject)
    first, second, error = _try_kernel()
    cache = cache_root(cast)
    files = [] if cache is None else [f for f in cache.rglob("*.nbc") if f.is_file()]
    return Diagnosis(
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        packages=tuple(_packages()),
        cores=os.cpu_count() or 1,
        threads=threads(),
        cache=cache,
        kernels=len(files),
        cache_bytes=sum(f.stat().st_size for f in files),
        writable=cache is not None and os.access(cache, os.W_OK),
        first=first,
        second=second,
        kernel_error=error,
        plugins={kind: {name: _whose(one) for name, one in plugged(kind).items()} for kind in KINDS},
    )


def _whose(found: EntryPoint) -> str:
    return "" if is_ours(found) or found.dist is None else f"{found.dist.name} {found.dist.version}"


def _try_kernel() -> tuple[float, float, str]:
    """Seconds of the first and the second call of a beam against a wall, and what is wrong with the answer."""
    sensor, beam, nobody = np.zeros((1, 3)), np.zeros(1), np.zeros((1, 0, 3))
    wall = np.array([[WALL, -1.0, WALL, 1.0]])
    spent = []
    for _ in range(2):
        began = perf_counter()
        try:
            ranges, _, _ = cast(sensor, beam, wall, nobody, 10.0)
        except Exception as error:  # noqa: BLE001  (whatever the compiler says is the diagnosis)
            return 0.0, 0.0, f"FAILED: {error}"
        spent.append(perf_counter() - began)
    off = abs(float(ranges[0, 0]) - WALL)
    return spent[0], spent[1], "" if off < 1e-12 else f"FAILED: a wall at {WALL} m is seen {off:g} m off"


def _packages() -> list[Package]:
    try:
        wanted = requires("mapweave") or []
    except PackageNotFoundError:
        wanted = []
    packages = []
    for text in wanted:
        need = NEED.match(text)
        extra = (need["extra"] or "") if need else ""
        if need is None or (extra and extra not in FOR_USERS):
            continue
        least = re.search(r">=\s*([\d.]+)", need["range"])
        packages.append(Package(need["name"], extra, least[1] if least else "0", _installed(need["name"])))
    return packages


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _version_text(package: Package) -> str:
    if package.version is None:
        return "MISSING"
    return package.version if package.good else f"{package.version} (TOO OLD, needs {package.least})"


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(word) for word in re.findall(r"\d+", text.split("+", maxsplit=1)[0])[:3])
