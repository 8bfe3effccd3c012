"""What can be wrong with the fixes of a robot, and the finding that tells it, whatever map they are to lay."""

from dataclasses import replace

import numpy as np
import pytest

SPOILT = [
    pytest.param(lambda f: replace(f, place=f.place * [-1.0, 1.0, 1.0]), "fixes-mirrored", id="south"),
    pytest.param(lambda f: replace(f, place=f.place * [1.0, -1.0, 1.0]), "fixes-mirrored", id="west"),
    pytest.param(lambda f: replace(f, t=f.t + 1e6), "fixes-unused", id="another-day"),
    pytest.param(lambda f: replace(f, cov=np.full((len(f), 2, 2), np.nan)), "fixes-untold", id="untold"),
    pytest.param(lambda f: replace(f, cov=0.01 * f.cov), "fixes-worse", id="too-sure"),
    pytest.param(lambda f: replace(f, dropped={"fix without satellites": 3}), "fixes-dropped", id="no-satellites"),
    pytest.param(
        lambda f: replace(f, place=f.place[np.random.default_rng(1).permutation(len(f))]), "fixes-vague", id="shuffled"
    ),
]
