"""Numbers are checked and formatted for people, and errors name their key."""

import math
import re

import pytest

from splatrl.values import are_numbers, one_line, require_number, tenths, under_key


@pytest.mark.parametrize(
    ("bounds", "accepted", "refused", "expected"),
    [
        (
            {"low": 1},
            [1, 1.5, 1e300],
            [0.999, -1, float("inf"), float("nan"), True, "2", None],
            "a number of at least 1",
        ),
        ({"low": 0.0, "high": 2.0}, [0, 0.0, 2.0], [-1e-9, 2.1], "a number from 0.0 to 2.0"),
        ({"above": 0.0}, [1e-300, 5], [0, 0.0, -1, float("inf"), float("nan")], "a number above 0.0"),
        ({"above": 0, "high": 9}, [9, 0.1], [0, 9.1], "a number above 0, at most 9"),
        ({"low": 1, "whole": True}, [1, 2**62], [0, 1.0, True, 10**400], "a whole number of at least 1"),
        ({"above": 0.0, "unit": "metres"}, [0.1], [0.0], "a number of metres above 0.0"),
        ({"low": 0.0, "unit": "metres"}, [0.0], [-0.1], "a number of metres, at least 0.0"),
    ],
)
def test_numbers_out_of_range_are_refused_with_the_range(
    bounds: dict, accepted: list, refused: list, expected: str
) -> None:
    for value in accepted:
        require_number("a.key", value, **bounds)
    for value in refused:
        with pytest.raises(ValueError, match=re.escape(f"a.key: expected {expected}, got {value!r:.80}") + "$"):
            require_number("a.key", value, **bounds)


@pytest.mark.parametrize("values", ["123", 3, None, [1, 2], [1, 2, "3"], [1, 2, math.nan], [1, 2, 10**400]])
def test_what_is_not_three_finite_numbers_is_told_apart(values: object) -> None:
    assert not are_numbers(values, 3) and are_numbers((1, 2.5, -3), 3)


@pytest.mark.parametrize(
    ("value", "expected"), [(-0.04, "0.0"), (-0.0, "0.0"), (0.04, "0.0"), (-0.06, "-0.1"), (12.34, "12.3")]
)
def test_numbers_that_round_to_zero_have_no_sign(value: float, expected: str) -> None:
    assert tenths(value) == expected


@pytest.mark.parametrize(("said", "expected"), [("too large", "task: too large"), ("task.step: no", "task.step: no")])
def test_an_error_is_put_under_a_key_once(said: str, expected: str) -> None:
    with pytest.raises(ValueError, match=f"^{expected}$"), under_key("task"):
        raise ValueError(said)


def test_a_message_is_one_line_in_which_nothing_controls_the_terminal() -> None:
    told = one_line(ValueError("name:\n  got \x1b[2Jсад\u202e"))
    assert told == r"name: got \x1b[2Jсад\u202e"
    assert one_line(ValueError("  ")) == "ValueError"
