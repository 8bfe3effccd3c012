"""`reproduce hara`: odometry, matching, gate and particle filter on the paper's kind of loop, six times."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.version import __version__
from ...core.workers import Progress, no_progress, one_blas_thread
from ...io.directory import check_target, write_json
from ...report.result import ResultBase, Rows
from ...report.style import Target
from . import page as report
from .experiments import Method, Picture, compare, methods

NOTES = tuple(
    """
The paper's corridor and its log are not published. Here the ring is 60 by 30 m, 2.5 m wide, driven for 200 m with 15 to
20 m of odometry error at the end, as the paper reports; the paper prints maps, no errors.

Intensity is made independent of range and incidence by a curve found from the log itself; the paper uses it as read and
names this as future work.

The particle filter's moves come from matching against a local map, and every particle is refined against its own map;
the paper's own filter (odometry proposes, nothing is refined) is there as PAPER_FILTER.

Errors are root mean square positions after one rigid alignment to the truth.
""".strip()
    .replace("\n\n", "\t")
    .replace("\n", " ")
    .split("\t")
)


@dataclass(frozen=True, slots=True, repr=False)
class HaraReproduction(ResultBase):
    """errors: (methods, seeds) ATE [m]; pictures: the maps of one seed."""

    seed: int
    quick: bool
    particles: int
    methods: tuple[Method, ...]
    errors: Float[np.ndarray, "m s"]
    pictures: tuple[Picture, ...]
    timing: dict[str, float]

    def table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """Head and rows: ATE [m] at each seed, mean, worst, and the mean as a share of odometry's."""
        seeds = self.errors.shape[1]
        head = ("method", "paper", *(f"seed {self.seed + k}" for k in range(seeds)), "mean [m]", "worst", "of odometry")
        rows: list[tuple[object, ...]] = []
        for method, e in zip(self.methods, self.errors, strict=True):
            share = e.mean() / self.errors[0].mean()
            rows.append(
                (
                    method.name,
                    method.figure,
                    *(f"{v:.2f}" for v in e),
                    f"{e.mean():.3f}",
                    f"{e.max():.2f}",
                    f"{share:.3f}",
                )
            )
        return head, rows

    def headline(self) -> Rows:
        return self.table()

    def lines(self) -> list[str]:
        means = ", ".join(f"{m.name} {e.mean():.2f} m" for m, e in zip(self.methods, self.errors, strict=True))
        told = [f"Hara, Kawata, Ohya, Yuta: mean trajectory error over {self.errors.shape[1]} drives of 200 m: {means}"]
        return [*told, *NOTES]

    def draw(self, target: Target) -> None:
        """The maps of Figs. 4 to 7 side by side."""
        report.draw_maps(target, self.pictures)

    def write_into(self, folder: Path) -> None:
        report.write(folder, self.pictures, *self.table(), NOTES)
        write_json(folder / "metrics.json", self.metrics)

    @property
    def metrics(self) -> dict[str, Any]:
        rows = [
            {
                "method": m.name,
                "figure": m.figure or None,
                "ate": e,
                "ate_mean": float(e.mean()),
                "ate_max": float(e.max()),
            }
            for m, e in zip(self.methods, self.errors, strict=True)
        ]
        return {
            "version": __version__,
            "seed": self.seed,
            "quick": self.quick,
            "particles": self.particles,
            "methods": rows,
            "notes": list(NOTES),
            "timing": self.timing,
        }


@one_blas_thread()
def reproduce_hara(
    out: Path | str | None = None,
    *,
    quick: bool = False,
    seed: int = 0,
    force: bool = False,
    on_progress: Progress = no_progress,
) -> HaraReproduction:
    """Every method on six simulated loops with 512 particles (`quick`: two loops, 64), written to `out` if given.

    The same seed gives the same figures. Raises UsageError when `out` holds something other than a result.
    """
    if out is not None:
        check_target(Path(out), force=force)
    begun = perf_counter()
    particles, seeds = (64, 2) if quick else (512, 6)
    chosen = methods(particles)
    errors, pictures = compare(chosen, range(seed, seed + seeds), seed, on_progress)
    result = HaraReproduction(seed, quick, particles, chosen, errors, pictures, {"all": perf_counter() - begun})
    if out is not None:
        result.write(out, force=force)
    return result
