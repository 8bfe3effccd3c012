"""What every scan did to the estimate, as a table."""

from pathlib import Path

from ..laser.laser_map import ScanRecords
from .table import write_table

HEAD = "t,host,x,y,theta,innovation_x,innovation_y,innovation_theta,beams,matches,decision,n_eff,resampled"


def write_scans(path: Path, scans: ScanRecords) -> None:
    """`path` holds a row a scan [s, m, rad]; `n_eff` is empty where no weights changed."""
    columns = [
        scans.t.tolist(),
        map(_plain, scans.host),
        *scans.pose.T.tolist(),
        *scans.innovation.T.tolist(),
        scans.beams.tolist(),
        scans.matches.tolist(),
        scans.decision,
        scans.n_eff.tolist(),
        scans.resampled.astype(int).tolist(),
    ]
    number = ["{:.6f}".format] * 11 + ["{:.3f}".format] * 2
    write_table(path, HEAD.split(","), zip(*columns, strict=True), number)


def _plain(host: str) -> str:
    return "".join(c for c in host if c not in ',"\r\n')
