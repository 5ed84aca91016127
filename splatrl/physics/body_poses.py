"""Where a robot and its things are in a state: the bodies that carry the camera, are drawn, or are solid."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from splatrl.geometry import invert_rigid
from splatrl.physics.kinematics import Kinematics
from splatrl.physics.robot_world import RobotWorld
from splatrl.physics.solids import Solids
from splatrl.renderers.parts import Parts


class BodyPoses:
    """Places the bodies of states.

    Args:
        models: the bank of models that states obey.
        world: the robot among its things.
        camera: name of the robot's camera.
        shown: names of the bodies that are drawn.

    Raises:
        ValueError: for an unknown camera or body.
    """

    def __init__(self, models: Sequence[Any], world: RobotWorld, camera: str, shown: Sequence[str]):
        self.kinematics = Kinematics(models, [world.body_of_camera(camera), *shown])
        self.solids = Solids(models, list(world.things.values()))

    def carrier(self, state: Tensor) -> Tensor:
        """Return the poses of the body that carries the camera: [B, n] -> [B, 4, 4] float32."""
        place, turn = self.kinematics(state)
        return self.kinematics.as_poses(place[:, :1], turn[:, :1]).squeeze(1)

    def first_to_carrier(self, state: Tensor) -> Tensor:
        """Return where first bodies are in the frame of those that carry the camera: [B, n] -> [B, 4, 4] float32."""
        layout = self.kinematics.layout
        first = self.kinematics.as_poses(state[:, layout.position], state[:, layout.orientation])
        return invert_rigid(self.carrier(state)) @ first

    def parts(self, state: Tensor, first: int) -> Parts:
        """Return the parts to draw, the scene and the moving bodies where they are: [B, n] -> [B, 1 + M] parts.

        Args:
            state: [B, n] states.
            first: index among the renderer's models of the first of the bodies'.
        """
        place, turn = self.kinematics(state)
        moving = self.kinematics.as_poses(place[:, 1:], turn[:, 1:])
        scene = torch.eye(4, device=state.device).expand(len(state), 1, 4, 4)
        numbers = torch.arange(first, first + moving.shape[1], device=state.device)
        model = torch.cat([torch.zeros_like(numbers[:1]), numbers]).expand(len(state), -1)
        return Parts(model, torch.cat([scene, moving], 1))

    def ranges(self, state: Tensor, body_to_world: Tensor, beams: Tensor, reach: float) -> Tensor:
        """Return how far beams go before they enter a thing's solid geoms; see ``Motion``."""
        return self.solids.ranges(state, body_to_world, beams, reach)
