"""The demo leaves a result that says nothing of where it was made."""

import json

import pytest

from mapweave.api.demo import demo


@pytest.mark.slow
def test_the_demo_is_scored_and_its_metrics_name_the_recording_it_leaves(tmp_path):
    out = tmp_path / "demo"
    demo(out)
    text = (out / "metrics.json").read_text(encoding="utf-8")
    told = json.loads(text)
    assert {robot["source"] for robot in told["robots"].values()} == {"recording"}
    assert (out / "recording" / "Barcodes.dat").exists()
    assert str(tmp_path) not in text
    assert told["evaluation"]["landmark_rmse"] < told["evaluation"]["mean_single_rmse"]
    assert told["online"]
