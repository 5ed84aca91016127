"""The robot: its body and the camera it carries."""

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from splatrl.bodies import Body
from splatrl.cameras import MOST_PIXELS, Cameras, intrinsics
from splatrl.geometry import CAMERA_TO_BODY, axis_rotations, rigid
from splatrl.values import require_number


@dataclass(frozen=True)
class Robot:
    """A body with a camera, either at its centre, looking along the body's +x, or mounted elsewhere on it.

    Attributes:
        body: collision shape, in the body frame.
        height: height of the body's centre, and of a camera placed there, above z = 0, metres.
        pitch_deg: downward pitch of a camera at the centre, degrees.
        fov_deg: horizontal field of view, degrees in (0, 180).
        image_width: width of the image, pixels.
        image_height: height of the image, pixels.
        mount: rows of ``camera_to_body``, 4 × 4, for a camera that is not at the centre; None places it at the centre,
            with ``pitch_deg``.
    """

    body: Body
    height: float
    pitch_deg: float = 0.0
    fov_deg: float = 90.0
    image_width: int = 64
    image_height: int = 64
    mount: tuple[tuple[float, ...], ...] | None = None
    camera_to_body: Tensor = field(init=False, repr=False, compare=False)  # [4, 4]
    K: Tensor = field(init=False, repr=False, compare=False)  # [3, 3]
    _placed: dict[torch.device, tuple[Tensor, Tensor]] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    def __post_init__(self) -> None:
        if not isinstance(self.body, Body):
            raise ValueError(f"robot.body: expected a Box, Sphere or Capsule, got {self.body!r:.80}")
        require_number("robot.height", self.height, -1e6, 1e6)
        require_number("robot.pitch_deg", self.pitch_deg, -180, 180)
        require_number("robot.fov_deg", self.fov_deg, 1, 179)
        for name in ("image_width", "image_height"):
            require_number(f"robot.{name}", getattr(self, name), 1, MOST_PIXELS, whole=True)
        down = axis_rotations(1, torch.tensor(math.radians(self.pitch_deg), dtype=torch.float32))
        centred = rigid(down, down.new_zeros(3)) @ CAMERA_TO_BODY
        mounted = centred if self.mount is None else torch.tensor(self.mount, dtype=torch.float32)
        object.__setattr__(self, "camera_to_body", mounted)
        K = intrinsics(math.radians(self.fov_deg), self.image_width, self.image_height)
        object.__setattr__(self, "K", K)

    def cameras(self, body_to_world: Tensor, camera_offset: Tensor | None = None) -> Cameras:
        """Return the ego cameras of robots at given poses.

        Args:
            body_to_world: [B, 4, 4] float32, metres.
            camera_offset: [B, 6] float32, moves the camera but not the robot: metres along world x, y and z, then
                radians about the camera's own right, forward and down axes, in the order pitch, roll, yaw.

        Returns:
            B cameras on the device of ``body_to_world``.
        """
        camera_to_body, K = self._camera_on(body_to_world.device)
        camera_to_world = body_to_world @ camera_to_body
        if camera_offset is not None:
            pitch, roll, yaw = camera_offset[:, 3:].unbind(-1)
            turn = axis_rotations(0, pitch) @ axis_rotations(2, roll) @ axis_rotations(1, yaw)
            rotation = camera_to_world[:, :3, :3] @ turn
            camera_to_world = rigid(rotation, camera_to_world[:, :3, 3] + camera_offset[:, :3])
        return Cameras(camera_to_world, K, self.image_width, self.image_height)

    def _camera_on(self, device: torch.device) -> tuple[Tensor, Tensor]:
        """Return ``camera_to_body`` and ``K`` on a device; cached, since each copy would block the host."""
        if device not in self._placed:
            self._placed[device] = self.camera_to_body.to(device), self.K.to(device)
        return self._placed[device]
