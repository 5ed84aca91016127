"""Dragging handles changes the values of a scene.yaml."""

import math

import pytest

from splatrl.viewer.place import Handle, changes, dragged, handles, listed, numbers_of, typed

VALUES = {
    "goal": [0.5, 1.0, 90.0],
    "object": [0.7, 1.0, 0.5],
    "walk": [[-1.0, -1.5], [1.0, 1.5]],
    "bounds": [[-2.0, -3.0, 0.0], [2.0, 3.0, 2.5]],
}


def test_every_value_that_is_given_has_a_handle() -> None:
    found = {handle.name: handle for handle in handles(VALUES, 0.4)}
    assert sorted(found) == ["bounds 0", "bounds 1", "goal", "object", "walk 0", "walk 1"]
    assert found["goal"].position == (0.5, 1.0, 0.4) and found["goal"].yaw == pytest.approx(math.pi / 2)
    assert found["walk 1"].position == (1.0, 1.5, 0.4)
    assert found["bounds 0"].position == (-2.0, -3.0, 0.0)
    assert handles({"goal": None, "bounds": None}, 0.4) == []


def test_a_handle_that_is_released_where_it_was_changes_nothing() -> None:
    for handle in handles(VALUES, 0.4):
        assert changes(VALUES, dragged(VALUES, handle, 0.5)) == {}


@pytest.mark.parametrize(
    ("handle", "expected"),
    [
        (Handle("goal", (0.12345, -0.5, 9.0), -math.pi / 6), {"goal": [0.123, -0.5, -30.0]}),
        (Handle("object", (0.1, 0.2, 0.3)), {"object": [0.1, 0.2, 0.3]}),
        (Handle("bounds 1", (2.5, 3.0, 2.0)), {"bounds": [[-2.0, -3.0, 0.0], [2.5, 3.0, 2.0]]}),
        (Handle("walk 0", (-1.7, -1.6, 0.4)), {"walk": [[-1.5, -1.5], [1.0, 1.5]]}),
    ],
)
def test_a_drag_changes_only_its_own_value(handle: Handle, expected: dict[str, object]) -> None:
    assert changes(VALUES, dragged(VALUES, handle, 0.5)) == expected
    assert VALUES["walk"] == [[-1.0, -1.5], [1.0, 1.5]]


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("goal", "-0.5, 1, -30", {"goal": [-0.5, 1.0, -30.0]}),
        ("object", "0.12345 -2e-3 0.3", {"object": [0.12345, -0.002, 0.3]}),
        ("walk 1", "-.5,2", {"walk": [[-1.0, -1.5], [-0.5, 2.0]]}),
        ("bounds 0", "-2, -3, -0.1", {"bounds": [[-2.0, -3.0, -0.1], [2.0, 3.0, 2.5]]}),
    ],
)
def test_typed_numbers_are_taken_as_they_are(name: str, text: str, expected: dict[str, object]) -> None:
    assert changes(VALUES, typed(VALUES, name, text)) == expected
    assert VALUES["walk"] == [[-1.0, -1.5], [1.0, 1.5]]


@pytest.mark.parametrize(
    "text", ["", "-", "0.5, 1", "0.5, 1, 90, 0", "a, b, c", "nan, 0, 0", "1e400, 0, 0", "1e39, 0, 0"]
)
def test_a_text_without_the_numbers_of_a_handle_is_refused(text: str) -> None:
    told = rf"goal: expected 3 numbers such as -0\.5, 1\.25, 90, got {text or 'none'}"
    with pytest.raises(ValueError, match=told):
        typed(VALUES, "goal", text)


def test_the_numbers_of_a_handle_are_listed_without_loss() -> None:
    assert listed(numbers_of(VALUES, "goal")) == "0.5, 1, 90"
    values = {"bounds": [[-1.7000000476837158, 1e-7, 270.0], [1.0, 2.0, 3.0]]}
    text = listed(numbers_of(values, "bounds 0"))
    assert text == "-1.7000000476837158, 1e-07, 270" and typed(values, "bounds 0", text) == values
