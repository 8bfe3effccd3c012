"""Arguments of verbs that are of another kind than they have to be."""

import pytest

import mapweave
from mapweave.core.errors import UsageError


@pytest.mark.parametrize(
    ("name", "given"), [("seed", "1"), ("seed", 1.5), ("share", [1]), ("start", 3), ("share", "1:0.5")]
)
def test_an_argument_of_another_kind_is_refused_by_its_name(name, given):
    with pytest.raises(UsageError, match=f"^{name}: expected"):
        mapweave.map("nowhere", **{name: given})
