"""A trajectory alone against the true one: two TUM files, as evo scores them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import UsageError
from ..core.records import Track
from ..evaluation.plain_tracks import WITHIN, Errors, TrackScore, score_tracks
from ..io.tum import read_tum_rows, track_from
from .result import EvaluationBase

if TYPE_CHECKING:
    from ..report.style import Target


@dataclass(frozen=True, slots=True, repr=False)
class TrackEvaluation(EvaluationBase):
    """APE and RPE of a trajectory; score: None where no stamp of it is one of the truth's."""

    name: str
    estimate: Track
    truth: Track
    score: TrackScore | None

    @property
    def unscored(self) -> str:
        return "" if self.score else f"no stamp of {self.name} is within {1000 * WITHIN:.0f} ms of one of the truth"

    def draw(self, target: "Target") -> None:
        """Both trajectories from above, the estimate where it fits best."""
        from ..report.score import draw_tracks  # noqa: PLC0415  (figures cost half a second)

        if self.score is not None:
            draw_tracks(target, self.estimate, self.truth, self.score.T_truth_estimate)

    def as_json(self) -> dict[str, Any]:
        return {} if self.score is None else asdict(self.score)

    def lines(self) -> list[str]:
        if self.score is None:
            return [self.unscored]
        s = self.score
        rows = [("APE as it is", s.ape, "m"), ("APE aligned", s.ape_aligned, "m"), ("RPE a step", s.rpe, "m")]
        rows += [("heading as it is", s.ape_rotation, "deg"), ("turn a step", s.rpe_rotation, "deg")]
        return [f"{self.name}: {s.n} poses", *(_line(*row) for row in rows if row[1] is not None)]


def _line(what: str, e: Errors | None, unit: str) -> str:
    return "" if e is None else f"{what}: RMSE {e.rmse:.4f} {unit}, mean {e.mean:.4f}, most {e.max:.4f}"


def is_track(path: object) -> bool:
    """Whether `path` is a file of a trajectory."""
    return isinstance(path, str | Path) and Path(path).suffix.lower() in {".tum", ".txt"} and Path(path).is_file()


def evaluate(path: Path, truth: Sequence[Path]) -> TrackEvaluation:
    """The score of the trajectory in `path`."""
    if len(truth) != 1 or not is_track(truth[0]):
        found = ", ".join(str(p) for p in truth)
        raise UsageError(f"truth: expected one TUM trajectory, as {path} is one, found {found}")
    own, true = read_tum_rows(path), read_tum_rows(truth[0])
    return TrackEvaluation(path.name, track_from(own), track_from(true), score_tracks(own, true))
