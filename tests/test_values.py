"""Numbers are formatted for people."""

import pytest

from splatrl.values import tenths


@pytest.mark.parametrize(
    ("value", "expected"), [(-0.04, "0.0"), (-0.0, "0.0"), (0.04, "0.0"), (-0.06, "-0.1"), (12.34, "12.3")]
)
def test_numbers_that_round_to_zero_have_no_sign(value: float, expected: str) -> None:
    assert tenths(value) == expected
