import math
from typing import Any

import pytest

from splatrl.bodies import Box, Capsule, Sphere


def test_the_radius_of_a_body_is_that_of_its_bounding_sphere() -> None:
    assert Box((2.0, 4.0, 4.0)).radius == 3.0
    assert Sphere(0.3).radius == 0.3
    assert Capsule(0.2, 1.0).radius == 0.7


def test_half_the_width_of_a_body_is_that_of_its_narrower_side() -> None:
    assert [body.half_width for body in (Box((4.0, 2.0, 1.0)), Sphere(0.3), Capsule(0.2, 1.0))] == [1.0, 0.3, 0.2]


def test_a_body_reaches_as_far_up_as_half_its_height() -> None:
    assert Box((2.0, 4.0, 3.0)).half_height == 1.5
    assert Sphere(0.3).half_height == 0.3
    assert Capsule(0.2, 1.0).half_height == 0.7


def test_a_box_made_from_a_list_equals_one_made_from_a_tuple() -> None:
    assert Box([1, 2, 3]) == Box((1.0, 2.0, 3.0))
    assert hash(Box([1, 2, 3])) == hash(Box((1.0, 2.0, 3.0)))


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_extents_that_are_not_positive_are_refused_by_name(bad: float) -> None:
    with pytest.raises(
        ValueError, match=r"Box\.size\.y: expected a number of metres above 0.0, at most 1000000.0, got"
    ):
        Box((1.0, bad, 1.0))
    with pytest.raises(ValueError, match=r"Sphere\.radius"):
        Sphere(bad)
    with pytest.raises(ValueError, match=r"Capsule\.cap_radius"):
        Capsule(bad, 1.0)
    with pytest.raises(ValueError, match=r"Capsule\.length"):
        Capsule(1.0, bad)


@pytest.mark.parametrize("bad", [(1.0, 2.0), 3, None, "abcd"])
def test_a_box_without_three_extents_is_refused(bad: Any) -> None:
    with pytest.raises(ValueError, match=r"Box\.size: expected 3 full extents along x, y and z in metres, got "):
        Box(bad)
    with pytest.raises(ValueError, match=r"Box\.size\.x: expected a number of metres"):
        Box(("a", 1.0, 1.0))
