"""A pipe can be read but once, and formats are told by looking twice: `localize` lost the first fifth of a log."""

import os

import pytest

import mapweave

VERBS = {
    "map": lambda pipe, _: mapweave.map(pipe),
    "read": lambda pipe, _: mapweave.read(pipe),
    "localize": mapweave.localize,
    "evaluate": lambda pipe, made: mapweave.evaluate(made, pipe),
}


@pytest.mark.parametrize("verb", VERBS)
def test_a_pipe_is_refused_and_not_waited_for(verb, tmp_path):
    drive = mapweave.simulate_laser(None, mapweave.CorridorConfig(distance=4.0), seed=1)
    made = mapweave.map(drive.log, method="gated")
    os.mkfifo(pipe := tmp_path / "pipe.clf")
    with pytest.raises(mapweave.ReaderError, match=r"pipe\.clf: expected a file, found a pipe"):
        VERBS[verb](pipe, made)
