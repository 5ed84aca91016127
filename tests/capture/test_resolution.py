"""A fit is as fine as what the robots will see, within the limits of the photos."""

from dataclasses import replace

import pytest
from omegaconf import OmegaConf

from splatrl.bodies import Sphere
from splatrl.capture.base import Reconstruction
from splatrl.capture.fitting.fit import FitSettings
from splatrl.capture.resolution import Resolution
from splatrl.configuration import conf_dir
from splatrl.envs.robot import Robot
from tests.capture.walks import walk


def photos() -> Reconstruction:
    """Return the walk with larger photos, whose focal length is 702 pixels."""
    return replace(walk(), width=960, height=540, K=walk().K * 3)


@pytest.mark.parametrize(
    ("resolution", "width", "cap"),
    [
        (Resolution(), 320, 60_000),
        (Resolution(256), 351, 60_000),  # 2 · 128 / 702 · 960
        (Resolution(512), 701, 216_000),
        (Resolution(256, robot_fov_deg=45.0), 846, 315_000),
        (Resolution(4096), 960, 405_000),
        (Resolution(256, width=200), 200, 60_000),
        (Resolution(width=960, gaussians=5), 960, 5),
        (Resolution(width=2000), 960, 405_000),
    ],
)
def test_width_and_cap_follow_from_the_robots_camera(resolution: Resolution, width: int, cap: int) -> None:
    fit = resolution.of(photos(), FitSettings(views=7))
    assert fit.views == 7 and fit.width == pytest.approx(width, abs=1) and fit.cap == pytest.approx(cap, rel=0.01)


def test_a_fit_has_twice_the_pixels_per_degree_of_a_robot() -> None:
    robot = Robot(Sphere(0.2), 1.0, fov_deg=60.0, image_width=300)
    fit = Resolution(300, 60.0).of(photos(), FitSettings())
    focal = float(photos().K[0, 0]) * fit.width / photos().width
    assert 2.0 <= focal / float(robot.K[0, 0]) < 2.01


def test_small_photos_are_not_enlarged() -> None:
    assert Resolution(512).of(walk(), FitSettings()).width == walk().width == 320


def test_impossible_robot_cameras_and_widths_are_refused() -> None:
    for wrong in ({"robot_width": 0}, {"robot_fov_deg": 180.0}):
        with pytest.raises(ValueError, match="robot: expected"):
            Resolution(**wrong)
    with pytest.raises(ValueError, match="width: expected a whole number of at least 1, got 0"):
        Resolution(width=0).of(photos(), FitSettings())


def test_the_default_robot_camera_is_that_of_the_configuration() -> None:
    box = OmegaConf.load(conf_dir() / "robot" / "box.yaml")
    assert (box.image_width, box.fov_deg) == (Robot.image_width, Robot.fov_deg)
