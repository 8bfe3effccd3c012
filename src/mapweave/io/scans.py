"""What every scan did to the estimate, as a table."""

from pathlib import Path

from ..laser.laser_map import ScanRecords
from .rows import open_text

HEAD = "t,host,x,y,theta,innovation_x,innovation_y,innovation_theta,beams,matches,decision,n_eff,resampled"


def write_scans(path: Path, scans: ScanRecords) -> None:
    """`path` holds a row a scan [s, m, rad]; `n_eff` is empty where no weights changed."""
    with open_text(path) as file:
        file.write(HEAD + "\n")
        for k in range(len(scans)):
            n_eff = scans.n_eff[k]
            numbers = [*scans.pose[k].tolist(), *scans.innovation[k].tolist()]
            fields = [
                f"{scans.t[k]:.6f}",
                _plain(scans.host[k]),
                *(f"{v:.6f}" if v == v else "" for v in numbers),  # noqa: PLR0124  (NaN is nothing to tell)
                str(scans.beams[k]),
                str(scans.matches[k]),
                scans.decision[k],
                f"{n_eff:.3f}" if n_eff == n_eff else "",  # noqa: PLR0124
                str(int(scans.resampled[k])),
            ]
            file.write(",".join(fields) + "\n")


def _plain(host: str) -> str:
    return "".join(c for c in host if c not in ',"\r\n')
