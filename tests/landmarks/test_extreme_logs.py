"""Whatever numbers a log holds, its map is finite or there is one clear error; broken rows are counted."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

from mapweave.api.map_landmarks import map_logs
from mapweave.api.map_options import MapOptions
from mapweave.core.errors import EstimateError
from mapweave.core.landmark_log import SightingTable
from mapweave.core.records import Odometry
from mapweave.io.directory import result_directory
from mapweave.landmarks import mapping
from mapweave.landmarks.config import EkfSlamConfig
from mapweave.landmarks.ekf_replay import replay
from mapweave.landmarks.mapping import local_map, without_impossible

from .robot_worlds import drive

pytestmark = pytest.mark.drawn


@pytest.fixture
def blind(monkeypatch):
    """Nothing is taken for impossible before the filter."""
    for name in ("MOST_SPEED", "MOST_TURN", "MOST_RANGE", "MOST_BEARING"):
        monkeypatch.setattr(mapping, name, 1e308)


def with_number(log, column, value, rows=slice(40, 41)):
    """The log with `value` in some rows of one column."""
    seen, odometry = log.sightings, log.odometry
    columns = {name: np.array(getattr(seen, name)) for name in ("range", "bearing")}
    columns |= {name: np.array(getattr(odometry, name)) for name in ("v", "w")}
    columns[column][rows] = value
    return replace(
        log,
        odometry=Odometry(odometry.t, columns["v"], columns["w"]),
        sightings=SightingTable(seen.t, seen.what, columns["range"], columns["bearing"], seen.ids),
    )


def without_odometry(log):
    return replace(log, odometry=None)


def numbers(m):
    track_cov = np.zeros(0) if m.track.cov is None else m.track.cov
    calibration = np.array(list(m.calibration.values()))
    return [m.submap.pose, m.submap.mean, m.submap.cov, m.track.t, m.track.pose, track_cov, calibration]


@pytest.fixture(scope="module")
def log():
    return drive(3, seconds=40.0)[0]


@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 1e12, 1e5])
@pytest.mark.parametrize("column", ["v", "w", "range", "bearing"])
@pytest.mark.parametrize("wander", [False, True])
def test_a_row_that_no_robot_drives_or_sees_is_left_out_and_told(log, column, value, wander):
    broken = with_number(log, column, value)
    clean = log
    if wander:
        broken, clean = without_odometry(broken), without_odometry(log)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        m = local_map(broken)
    assert all(np.isfinite(a).all() for a in numbers(m))
    kind = "odometry" if column in "vw" else "sighting"
    told = not (wander and kind == "odometry") and not (column == "range" and abs(value) <= 1e5)
    assert m.dropped.get(f"{kind}: impossible", 0) == int(told)
    assert told == any("beyond any robot" in w for w in m.warnings)
    assert set(m.submap.ids) == set(local_map(clean).submap.ids)


@pytest.mark.usefixtures("blind")
@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 1e150, 1e60])
@pytest.mark.parametrize("column", ["v", "w", "range", "bearing"])
def test_an_estimate_that_leaves_finite_numbers_is_one_error(log, column, value):
    """The same numbers without the check before the filter: a finite map or an EstimateError, and no warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            m = local_map(with_number(log, column, value))
        except EstimateError as error:
            assert "EKF-SLAM left finite numbers" in str(error)  # noqa: PT017  (either outcome is right)
        else:
            assert all(np.isfinite(a).all() for a in numbers(m))


@pytest.mark.usefixtures("blind")
def test_a_range_that_overflows_the_filter_is_an_error_and_no_traceback(log):
    with pytest.raises(EstimateError, match="left finite numbers"):
        local_map(with_number(log, "range", 1e200))


def test_wheels_of_which_every_row_is_impossible_are_none(log):
    m, plain = local_map(with_number(log, "v", 1e9, slice(None))), local_map(without_odometry(log))
    assert m.odometry == plain.odometry == "none"
    np.testing.assert_array_equal(m.submap.mean, plain.submap.mean)


def with_names(log, n, each):
    """The log with `n` names more, each sighted `each` times."""
    seen = log.sightings
    t = np.repeat(np.linspace(seen.t[0], seen.t[-1], n), each)
    what = len(seen.ids) + np.repeat(np.arange(n), each)
    order = np.argsort(np.concatenate([seen.t, t]), kind="stable")
    columns = [
        np.concatenate([a, b])[order]
        for a, b in (
            (seen.t, t),
            (seen.what, what),
            (seen.range, np.full(len(t), 2.0)),
            (seen.bearing, np.full(len(t), 0.1)),
        )
    ]
    return replace(log, sightings=SightingTable(*columns, (*seen.ids, *(f"once {k}" for k in range(n)))))


def test_names_that_are_sighted_too_rarely_for_a_landmark_take_no_place_in_the_filter(log):
    plain, many = replay(log, EkfSlamConfig()), replay(with_names(log, 3000, 2), EkfSlamConfig())
    assert many.x.shape == plain.x.shape
    assert many.submap.ids == plain.submap.ids
    np.testing.assert_allclose(many.submap.mean, plain.submap.mean, atol=1e-3)  # driven in other steps


def test_more_landmarks_than_a_filter_holds_are_one_error_and_not_all_memory(log):
    with pytest.raises(EstimateError, match=r"landmarks sighted 3 times and oftener, at most 5000: .* 0\.8 GB"):
        local_map(with_names(log, 5001, 3))


def test_sane_rows_stay_as_they_are(log):
    assert without_impossible(log) is log


@pytest.mark.parametrize("stamps", [1e-9, 1e7, 1e300])
@pytest.mark.parametrize("wander", [False, True])
def test_stamps_close_together_or_far_apart_give_a_finite_map(log, stamps, wander):
    seen, odometry = log.sightings, log.odometry
    first = odometry.t[0]
    stretched = replace(
        log,
        odometry=None if wander else Odometry((odometry.t - first) * stamps, odometry.v, odometry.w),
        sightings=SightingTable((seen.t - first) * stamps, seen.what, seen.range, seen.bearing, seen.ids),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            m = local_map(stretched)
        except EstimateError:
            return
    assert all(np.isfinite(a).all() for a in numbers(m))


def written(folder, logs):
    """The result of mapping `logs`, written as CSV and read again, in `folder / "out"`."""
    rows = {"odometry": ["t,robot,v,w"], "sightings": ["t,robot,id,range,bearing"]}
    for robot, log in enumerate(logs, 1):
        o, s = log.odometry, log.sightings
        if o is not None:
            columns = (column.tolist() for column in (o.t, o.v, o.w))
            rows["odometry"] += [f"{t!r},{robot},{v!r},{w!r}" for t, v, w in zip(*columns, strict=True)]
        columns = (column.tolist() for column in (s.t, s.what, s.range, s.bearing))
        rows["sightings"] += [f"{t!r},{robot},L{k},{r!r},{b!r}" for t, k, r, b in zip(*columns, strict=True)]
    (folder / "log").mkdir()
    for name, lines in rows.items():
        (folder / "log" / f"{name}.csv").write_text("\n".join(lines) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        result = map_logs([folder / "log"], MapOptions())
        with result_directory(folder / "out") as work:
            result.write_into(work)
    return result


def test_written_files_of_an_extreme_log_hold_finite_numbers_alone(tmp_path):
    broken = with_number(with_number(drive(2, seconds=40.0)[0], "v", 1e308), "range", 1e300, slice(0, 200, 5))
    result = written(tmp_path, [drive(1, seconds=40.0)[0], broken])
    assert sum("beyond any robot" in w for w in result.warnings) == 2
    tables = [*(tmp_path / "out").rglob("*.tum"), *(tmp_path / "out").rglob("*.csv")]
    assert len(tables) >= 3
    words = {word for path in tables for word in path.read_text().lower().replace(",", " ").split()}
    assert not words & {"nan", "inf", "-inf"}
    for path in (tmp_path / "out").rglob("*.json"):
        json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} in a written file"))


def test_a_robot_of_which_nothing_sane_is_left_is_reported_beside_the_others(tmp_path):
    blind = without_odometry(with_number(drive(2, seconds=40.0)[0], "range", 1e300, slice(None)))
    result = written(tmp_path, [drive(1, seconds=40.0)[0], blind])
    assert [d.decision for d in result.fusion.decisions] == ["reference", "refused"]
    assert (tmp_path / "out" / "report.html").exists()
