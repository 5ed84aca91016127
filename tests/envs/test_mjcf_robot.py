"""Robots whose camera is defined in their MJCF."""

from pathlib import Path

import pytest
import torch

from splatrl.bodies import Box
from splatrl.envs import mjcf_robot

BODY = Box((0.2, 0.2, 0.1))
PLACED = 'name="eye" pos="0.1 0 0.05" xyaxes="0 -1 0 0 0 1"'


def written(folder: Path, camera: str, head: str = "") -> Path:
    """Write a robot with a head that cannot move, which carries a camera, and return its path."""
    path = folder / "robot.xml"
    path.write_text(
        f'<mujoco>{head}<worldbody><body name="trunk" pos="0 0 0.3"><freejoint/><geom size="0.1"/>'
        f'<body name="head" pos="0.2 0 0.1" euler="0 20 30"><geom size="0.03"/><camera {camera}/></body>'
        "</body></worldbody></mujoco>"
    )
    return path


def test_the_camera_is_mounted_on_the_body_that_carries_it_even_if_the_file_fuses_bodies(tmp_path: Path) -> None:
    plain = mjcf_robot(written(tmp_path, PLACED), "eye", BODY)
    fused = mjcf_robot(written(tmp_path, PLACED, '<compiler fusestatic="true"/>'), "eye", BODY)
    assert plain == fused and plain.height == pytest.approx(0.4)
    mount = torch.tensor(plain.mount)
    torch.testing.assert_close(mount[:3, 3], torch.tensor([0.1, 0.0, 0.05]))
    torch.testing.assert_close(mount[:3, 2], torch.tensor([1.0, 0.0, 0.0]), atol=1e-6, rtol=0)  # looks ahead


SENSOR = 'resolution="640 480" sensorsize="0.0064 0.0048"'


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ('mode="targetbody" target="trunk"', "mode: expected fixed, got targetbody"),
        ('mode="track"', "mode: expected fixed, got track"),
        ('projection="orthographic" fovy="1"', "projection: expected perspective, got orthographic"),
        (
            f'{SENSOR} focal="0.004 0.004" principalpixel="100 50"',
            "principalpixel: expected 0 0, the middle of the image, got 100 50",
        ),
        (f'{SENSOR} focalpixel="400 300"', "focalpixel: expected square pixels, so twice the same, got 400 300"),
    ],
)
def test_cameras_of_another_kind_are_refused_by_name(tmp_path: Path, camera: str, message: str) -> None:
    with pytest.raises(ValueError, match=rf"robot\.xml: camera 'eye': {message}"):
        mjcf_robot(written(tmp_path, f"{PLACED} {camera}"), "eye", BODY)


def test_a_field_of_view_may_be_given_by_a_focal_length(tmp_path: Path) -> None:
    camera = f'{PLACED} {SENSOR} focal="0.0048 0.0048" principalpixel="0 0"'
    robot = mjcf_robot(written(tmp_path, camera), "eye", BODY, image_width=60, image_height=30)
    assert robot.fov_deg == pytest.approx(90.0, abs=1e-3)  # twice as wide as high, and 0.5 / 1 high


def test_a_robot_that_does_not_stand_above_the_ground_is_refused_by_its_height(tmp_path: Path) -> None:
    path = written(tmp_path, PLACED)
    path.write_text(path.read_text().replace('pos="0 0 0.3"', 'pos="0 0 -0.12"'))
    with pytest.raises(ValueError, match=r"robot\.xml: expected a robot that stands above z = 0, .* at z = -0\.02 m;"):
        mjcf_robot(path, "eye", BODY)
