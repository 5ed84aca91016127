"""Fitting a plane to the ground, and reporting where the ground is not a plane."""

import math
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

from splatrl import backyard, read_scene
from splatrl.collision import Occupancy
from splatrl.physics.ground import Ground, fit_ground
from splatrl.physics.places import standing_heights, widest_part
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Scene
from tests.physics.relief import ReliefRenderer, Surface, relief_voxels

BOUNDS = (-1.2, -0.8), (1.4, 1.0)
CORNERS = np.array([[x, y] for x in (-1.2, 1.4) for y in (-0.8, 1.0)])


def found(surface: Surface, noise: float = 0.0) -> Ground:
    return fit_ground(ReliefRenderer(surface, noise), relief_voxels(surface), *BOUNDS)


@pytest.mark.parametrize(("slope_x", "slope_y", "height"), [(0.02, -0.05, 0.13), (0.0, 0.1, -0.4), (-0.15, 0.08, 1.0)])
def test_a_tilted_plane_is_found_to_a_tenth_of_a_millimetre(slope_x: float, slope_y: float, height: float) -> None:
    def surface(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return height + slope_x * x + slope_y * y

    ground = found(surface)
    truth = surface(*torch.from_numpy(CORNERS).unbind(1)).numpy()
    np.testing.assert_allclose(ground.height(CORNERS), truth, atol=1e-4)
    assert ground.tilt == pytest.approx(math.atan(math.hypot(slope_x, slope_y)), abs=1e-4)
    assert ground.is_plane and ground.trouble is None
    assert ground.spread < 1e-4


def test_a_tilt_within_the_error_of_depth_is_made_level() -> None:
    ground = found(lambda x, y: 0.02 + 0.003 * x, noise=0.005)
    assert ground.plane[:3].tolist() == [0.0, 0.0, 1.0]
    assert ground.plane[3] == pytest.approx(0.02, abs=0.001)
    assert ground.spread == pytest.approx(0.005, abs=0.002)


def printed_fits() -> None:
    """Print every bit of the fits of a level and a sloping ground."""
    for slope in (0.0, 0.05):
        ground = found(lambda x, y, slope=slope: 0.1 + slope * x, noise=0.005)
        print([value.hex() for value in (*ground.plane.tolist(), ground.spread, *ground.range)])


def test_the_ground_has_the_same_bytes_with_any_number_of_threads(capsys: pytest.CaptureFixture[str]) -> None:
    printed_fits()  # with one thread, see conftest.py
    many = {f"{library}_NUM_THREADS": "3" for library in ("OMP", "OPENBLAS", "MKL")}  # which a new process reads
    command = [sys.executable, "-c", "from tests.physics.test_ground import printed_fits as fits; fits()"]
    again = subprocess.run(command, env={**os.environ, **many}, capture_output=True, text=True, check=True)
    assert again.stdout == capsys.readouterr().out and again.stdout.count("\n") == 2


def test_objects_and_grass_do_not_lift_the_plane() -> None:
    def surface(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        thing = 0.25 * ((x - 0.5).abs() < 0.3) * (y.abs() < 0.25)
        blades = 0.06 * ((x * 37).sin() * (y * 41).cos() > 0.8)
        return 0.01 + thing + blades

    ground = found(surface)
    np.testing.assert_allclose(ground.height(CORNERS), 0.01, atol=0.002)
    assert ground.is_plane


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        (lambda x, y: 0.1 * (x > 0.1) + 0.1 * (x > 0.5), "lie more than 0.03 m off the best fit"),
        (lambda x, y: 0.25 * (x * 2).sin() * (y * 2).cos(), "lie more than 0.03 m off the best fit"),
        (lambda x, y: -0.4 * (x > 0.7), "of the places to stand lie below it"),
    ],
    ids=["steps", "hills", "pit"],
)
def test_a_ground_that_is_not_one_plane_is_reported(surface: Surface, said: str) -> None:
    ground = found(surface)
    assert not ground.is_plane
    assert ground.trouble is not None and said in ground.trouble
    assert ground.trouble in str(ground)


def test_a_scene_without_visible_ground_is_refused() -> None:
    renderer = ReliefRenderer(lambda x, y: 0.0 * x)
    with pytest.raises(
        ValueError, match=r"ground: expected at least 6 places .* got 0; bodies need ground to stand on"
    ):
        fit_ground(renderer, Occupancy.empty(0.05), *BOUNDS)
    with pytest.raises(ValueError, match="ground: expected lower < upper"):
        fit_ground(renderer, Occupancy.empty(0.05), (0.0, 0.0), (0.0, 1.0))


def test_the_standing_height_is_the_lowest_top_with_free_space_above_it() -> None:
    solid = np.zeros((3, 2, 12), bool)
    solid[0, 0, 0] = True  # a floor
    solid[1, 0, [0, 4]] = True  # a floor below something too low to stand under
    solid[2, 0, [0, 9]] = True  # and a floor with room above it
    heights = standing_heights(Occupancy(solid, (0, 0, -1), 0.05), (0.0, 0.0), (1.0, 1.0))[1]
    np.testing.assert_allclose(heights, [[0.0, np.nan], [0.2, np.nan], [0.0, np.nan]], atol=1e-9)


def test_the_widest_part_is_the_largest_component_without_high_steps() -> None:
    heights = np.array([[0.0, 0.05, 0.1, np.nan], [0.0, 0.8, 0.2, 0.4], [0.9, 0.8, 0.85, 0.85]])
    assert widest_part(heights).tolist() == [[True, True, True, False], [True, False, True, False], [False] * 4]
    assert not widest_part(np.full((2, 3), np.nan)).any()


def check_level(scene: Scene, half: float, within: float) -> None:
    """Assert that the ground that is found within ±``half`` is the plane z = 0."""
    lower, upper = (-half, -half), (half, half)
    ground = fit_ground(NativeRenderer(scene.gaussians), Occupancy.from_scene(scene), lower, upper)
    corners = np.array([[x, y] for x in (-half, half) for y in (-half, half)])
    assert np.abs(ground.height(corners)).max() <= within, str(ground)
    assert math.degrees(ground.tilt) <= 0.5
    assert ground.is_plane


@pytest.mark.parametrize("half", [1.0, 2.5])
def test_the_ground_of_the_backyard_is_found_to_half_a_centimetre(half: float) -> None:
    check_level(backyard(), half, 0.005)


@pytest.mark.parametrize("half", [1.0, 1.6])
def test_the_floor_of_the_kitchen_is_found_to_a_centimetre(half: float, shared_scenes: Path) -> None:
    tree = ElementTree.parse(shared_scenes / "kitchen" / "collision.xml")
    floor = next(node for node in tree.iter("geom") if node.get("name") == "floor")
    assert floor.get("pos") is None, "the reference floor lies at z = 0"
    check_level(
        read_scene(shared_scenes / "kitchen" / "kitchen.spz", world_from_splat={"axes": ["x", "-z", "y"]}), half, 0.01
    )
