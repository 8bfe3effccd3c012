"""One robot's laser keyframe graph as a file: what merging and going on tomorrow need."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.errors import ReaderError
from ..laser.beam import IntensityCalibration
from ..laser.closures import Closure
from ..laser.robot_graph import Revisits, RobotGraph
from .npz import read_arrays, write_arrays

NAME = "robot_graph.npz"
VERSION = 1
ARRAYS = ("t", "pose", "cov", "path", "step", "step_information", "start", "lined", "sensor")
WORDS = ("text", "closure_reason", "border")
GAPS = ("light_residual", "closure_numbers")  # NaN where there is nothing to tell
THIN = ("points", "normals", "q")  # float32: a scanner's noise is a thousand times their rounding


def write_robot_graph(path: Path, graph: RobotGraph) -> None:
    """`path` holds the graph; the same graph gives the same bytes."""
    calibration = graph.calibration
    held: dict[str, np.ndarray] = {
        "version": np.array(VERSION),
        "text": np.array([graph.robot, graph.feature, graph.source, graph.log_hash]),
        **{_key(name): getattr(graph, name) for name in ARRAYS},
        **{name: np.asarray(a, np.float32) for name in THIN if (a := getattr(graph, name)) is not None},
        "border": np.array(graph.border),
        "unclear": np.array(graph.unclear, dtype=np.int64),
        "glass": np.flatnonzero(graph.glass),
        **_closures(graph.closures),
        **_revisits(graph.revisits),
    }
    if calibration is not None:
        held |= {
            "light_knots": calibration.knots,
            "light_log_gain": calibration.log_gain,
            "light_numbers": np.array(
                [calibration.exponent, calibration.scale, calibration.residual, calibration.samples]
            ),
            "light_residual": calibration.residual_by_range,
            "light_worth": np.array([calibration.information, calibration.middle]),
            "light_cosines": calibration.cosines,
            "light_log_incidence": calibration.log_incidence,
            "light_gain_sd": calibration.gain_sd,
            "light_exponent_sd": np.array(calibration.exponent_sd),
        }
    write_arrays(path, held, gaps=GAPS)


def read_robot_graph(path: Path) -> RobotGraph:
    """The graph in `path`; raises ReaderError when it is missing, damaged or of another version."""
    try:
        held = read_arrays(path, "a laser graph")
        version = int(held["version"])
        if version != VERSION:
            raise ReaderError(path, f"expected a laser graph of version {VERSION}, found {version}")
        return _graph_of(held)
    except (KeyError, ValueError, IndexError, TypeError, OverflowError) as error:
        raise ReaderError(path, f"it is no laser graph, or damaged: {error}") from None


def _key(name: str) -> str:
    """An array's name in the file, where `path` is how far was driven and no file."""
    return "driven" if name == "path" else name


def _graph_of(held: dict[str, np.ndarray]) -> RobotGraph:
    robot, feature, source, log_hash = (str(word) for word in held["text"])
    n, m = len(held["t"]), len(held["points"])
    shapes = {
        "pose": (n, 3),
        "cov": (n, 3, 3),
        "path": (n,),
        "step": (max(n - 1, 0), 3),
        "step_information": (max(n - 1, 0), 3, 3),
        "start": (n + 1,),
        "points": (m, 2),
        "normals": (m, 2),
        "lined": (m,),
        "sensor": (n, 2),
        **({"q": (m,)} if "q" in held else {}),
    }
    for name, shape in shapes.items():
        array = held[_key(name)]
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    for name, values in held.items():
        if (values.dtype.kind in "fiub") == (name in WORDS):
            raise ValueError(f"{name} has values of the type {values.dtype}")
        floats = values if values.dtype.kind == "f" else np.zeros(0)
        wild = np.isinf(floats) if name in GAPS else ~np.isfinite(floats)
        if wild.any():
            raise ValueError(f"{name} has numbers that are not finite")
    start = held["start"]
    if start[0] != 0 or start[-1] != m or (np.diff(start) < 0).any():
        raise ValueError("start does not part the points")
    light = None
    if "light_knots" in held:
        exponent, scale, residual, samples = held["light_numbers"].tolist()
        light = IntensityCalibration(
            held["light_knots"],
            held["light_log_gain"],
            exponent,
            scale,
            residual,
            int(samples),
            held["light_residual"],
        )
        if "light_worth" in held:  # graphs written before light was weighed have none
            information, middle = held["light_worth"].tolist()
            light = replace(
                light,
                cosines=held["light_cosines"],
                log_incidence=held["light_log_incidence"],
                information=information,
                middle=middle,
            )
        if "light_gain_sd" in held:  # nor, before 0.4, how sure the law is
            light = replace(light, gain_sd=held["light_gain_sd"], exponent_sd=float(held["light_exponent_sd"]))
    return RobotGraph(
        robot=robot,
        closures=_read_closures(held, n),
        points=held["points"],
        normals=held["normals"],
        q=held.get("q"),
        feature=feature,
        calibration=light,
        source=source,
        log_hash=log_hash,
        revisits=_read_revisits(held, n),
        border=_read_border(held, n),
        unclear=tuple(k for k in held.get("unclear", np.zeros(0)).tolist() if 0 <= k < n),
        glass=np.isin(np.arange(m), held.get("glass", np.zeros(0))),
        **{name: held[_key(name)] for name in ARRAYS},
    )


def _read_border(held: dict[str, np.ndarray], n: int) -> tuple[str, ...]:
    if "border" not in held:
        return ()  # of a version that knew no segments
    if held["border"].shape != (n,):
        raise ValueError(f"border has shape {held['border'].shape}, expected {(n,)}")
    return tuple(str(word) for word in held["border"])


def _revisits(revisits: Revisits) -> dict[str, np.ndarray]:
    """Nothing where there are none."""
    if not len(revisits):
        return {}
    return {
        "revisit_t": revisits.t,
        "revisit_at": revisits.at,
        "revisit_step": revisits.step,
        "revisit_cov": revisits.cov,
        "revisit_closures": np.array(revisits.closures),
    }


def _read_revisits(held: dict[str, np.ndarray], n: int) -> Revisits:
    if "revisit_t" not in held:
        return Revisits()
    t, at, step, cov = (held[f"revisit_{name}"] for name in ("t", "at", "step", "cov"))
    v = len(t)
    if t.shape != (v,) or at.shape != (v,) or step.shape != (v, 3) or cov.shape != (v, 3, 3):
        raise ValueError("the revisits' arrays do not fit each other")
    if at.dtype.kind != "i" or (v and not 0 <= at.min() <= at.max() < n) or (np.diff(t) < 0).any():
        raise ValueError("revisits hang on keyframes that are not there, or are not in order of time")
    return Revisits(t, at, step, cov, int(held["revisit_closures"]))


def _closures(closures: tuple[Closure, ...]) -> dict[str, np.ndarray]:
    m = len(closures)
    numbers = [[np.nan if v is None else v for v in (c.share, c.nis, c.score, c.runner_up)] for c in closures]
    return {
        "closure_ends": np.array([(*c.robots, c.first, c.second, c.accepted) for c in closures], np.int64).reshape(
            m, 5
        ),
        "closure_measured": np.array([c.measured for c in closures], float).reshape(m, 3),
        "closure_information": np.array([c.information for c in closures], float).reshape(m, 3, 3),
        "closure_innovation": np.array([c.innovation for c in closures], float).reshape(m, 3),
        "closure_numbers": np.array(numbers, float).reshape(m, 4),
        "closure_reason": np.array([c.reason for c in closures], dtype=np.str_).reshape(m),
    }


def _read_closures(held: dict[str, np.ndarray], n: int) -> tuple[Closure, ...]:
    out = []
    for k, (a, b, first, second, accepted) in enumerate(held["closure_ends"].tolist()):
        if not (0 <= first < n and 0 <= second < n):
            raise ValueError(f"closure {k} ties keyframes {first} and {second} of {n}")
        share, nis, score, runner_up = (None if np.isnan(v) else v for v in held["closure_numbers"][k].tolist())
        out.append(
            Closure(
                (a, b),
                first,
                second,
                bool(accepted),
                str(held["closure_reason"][k]),
                held["closure_measured"][k],
                held["closure_information"][k],
                held["closure_innovation"][k],
                share or 0.0,
                nis,
                score,
                runner_up,
            )
        )
    return tuple(out)
