"""Truth is read for scoring alone, the better kind first."""

import numpy as np
import pytest

from mapweave.core.errors import ReaderError
from mapweave.io.landmark_truth import read_robot_truth, read_survey


def test_dense_truth_goes_before_instants_and_instants_before_keyframes(tmp_path):
    row = "1.0 2.0 3.0 0.5"
    (tmp_path / "Robot1_Groundtruth.dat").write_text(f"# t x y th\n{row}\n")
    (tmp_path / "Robot1_GroundtruthInstants.dat").write_text(f"{row} 4 0.1\n")
    (tmp_path / "Robot2_GroundtruthInstants.dat").write_text(f"{row} 4 0.1\n")
    (tmp_path / "Robot2_GroundtruthKeyframes.dat").write_text(f"{row}\n")
    (tmp_path / "Robot3_GroundtruthKeyframes.dat").write_text(f"{row}\n{row}\n0.5 1 1 7.0\n")
    truth = read_robot_truth(tmp_path)
    assert {k: kind for k, (_, kind) in truth.items()} == {
        "robot1": "groundtruth",
        "robot2": "instants",
        "robot3": "keyframes",
    }
    assert np.allclose(truth["robot3"][0].pose, [[1, 1, 7 - 2 * np.pi], [2, 3, 0.5]])


def test_a_survey_is_read_from_a_data_set_or_from_csv(tmp_path):
    (tmp_path / "Landmark_Groundtruth.dat").write_text("# s x y sx sy\n 6 1.0 2.0 0.1 0.1\n")
    (tmp_path / "survey.csv").write_text("id,x,y\nbarcode:72,1.5,-2\n")
    assert read_survey(tmp_path).ids == ("6",)
    survey = read_survey(tmp_path / "survey.csv")
    assert survey.ids == ("barcode:72",)
    assert survey.xy.tolist() == [[1.5, -2.0]]


def test_a_survey_that_is_missing_or_malformed_is_refused(tmp_path):
    with pytest.raises(ReaderError, match=r"expected Landmark_Groundtruth\.dat"):
        read_survey(tmp_path)
    (tmp_path / "survey.csv").write_text("id,x,y\n6,1,here\n")
    with pytest.raises(ReaderError, match=r"survey\.csv:2: expected id,x,y with numbers"):
        read_survey(tmp_path / "survey.csv")


@pytest.mark.data
def test_the_real_truth_is_read(data):
    path = data / "mrclam" / "MRCLAM_Dataset3.zip"
    assert len(read_survey(path)) == 15
    truth = read_robot_truth(path)
    assert [kind for _, kind in truth.values()] == ["instants"] * 5
    assert len(truth["robot4"][0].t) == 27
