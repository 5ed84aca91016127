from dataclasses import replace

import numpy as np
import pytest
import torch

from splatrl.scenes.frame import similarity
from splatrl.scenes.placement import floor_height
from splatrl.scenes.stated import StatedFrame
from splatrl.scenes.upright import Guess, Upright

NO_GUESS = Guess("given", "the test says so")
LYING = Upright(np.array([0.0, -1.0, 0.0]), -0.7, None, 2.0, NO_GUESS, NO_GUESS, NO_GUESS, NO_GUESS)
"""A file with −y up, its floor 0.7 units below the origin and 2 m per unit."""
TURNED = similarity(["x", "z", "-y"], 3.0, [1.0, 2.0, 5.0])


@pytest.mark.parametrize(
    ("stated", "floor"),
    [
        (StatedFrame(), 0.0),
        (StatedFrame(scale=5.0), 0.0),
        (StatedFrame(axes=["x", "z", "-y"]), 0.0),
        (StatedFrame(translation=[1.0, 2.0, 0.0]), -1.4),
        (StatedFrame(transform=TURNED), 5.0 - 2.1),
        (StatedFrame(transform=TURNED, scale=1.5), 2.5 - 1.05),
    ],
)
def test_stated_values_override_the_guess_and_the_floor_follows_them(stated: StatedFrame, floor: float) -> None:
    world_from_splat = similarity(**stated.frame(LYING))
    assert floor_height(LYING, world_from_splat) == pytest.approx(floor)
    direction = world_from_splat[:3, :3] @ torch.from_numpy(LYING.up)
    torch.testing.assert_close(direction / direction.norm(), torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))


@pytest.mark.parametrize("up", [[0.0, -1.0, 0.0], [0.1, -0.9, 0.3]])
@pytest.mark.parametrize("stated", [StatedFrame(), StatedFrame(scale=0.25)])
def test_a_far_origin_becomes_that_of_the_world_to_a_tenth_of_a_millimetre(stated: StatedFrame, up: list) -> None:
    far = [432_100.0, 5_412_345.0, 212.0]
    away = replace(LYING, up=np.array(up) / np.linalg.norm(up), origin=far)
    world_from_splat = similarity(**stated.frame(away))
    at = world_from_splat @ torch.tensor([*far, 1.0], dtype=torch.float64)
    torch.testing.assert_close(at[:2], torch.zeros(2, dtype=torch.float64), atol=1e-4, rtol=0.0)
    assert floor_height(away, world_from_splat) == pytest.approx(0.0, abs=1e-4)


def test_up_is_known_where_axes_or_a_transform_state_it() -> None:
    assert StatedFrame(scale=2.0, translation=[0.0, 0.0, 1.0]).up() is None
    assert StatedFrame(axes=["x", "z", "-y"]).up() == [0.0, -1.0, 0.0]
    assert StatedFrame(transform=TURNED).up() == [0.0, -3.0, 0.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axes": ["x", "y"]}, "axes: expected 3"),
        ({"axes": ["x", "y", "z"], "transform": TURNED}, "transform: expected either a transform or axes"),
        (
            {"translation": [0.0, 0.0, 1.0], "transform": TURNED},
            "transform: expected either a transform or axes and translation",
        ),
        ({"scale": 0.0}, "scale: expected a number of metres per unit above 0.0, got 0.0"),
    ],
)
def test_invalid_and_contradictory_frames_are_refused(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StatedFrame(**arguments)
