"""Numbers are formatted for people, and errors name their key."""

import pytest

from splatrl.values import tenths, under_key


@pytest.mark.parametrize(
    ("value", "expected"), [(-0.04, "0.0"), (-0.0, "0.0"), (0.04, "0.0"), (-0.06, "-0.1"), (12.34, "12.3")]
)
def test_numbers_that_round_to_zero_have_no_sign(value: float, expected: str) -> None:
    assert tenths(value) == expected


@pytest.mark.parametrize(("said", "expected"), [("too large", "task: too large"), ("task.step: no", "task.step: no")])
def test_an_error_is_put_under_a_key_once(said: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"^{expected}$"), under_key("task"):
        raise ValueError(said)
