"""Specs of an env's inputs and outputs."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torchrl.data import Bounded, Categorical, Composite, TensorSpec, Unbounded

from splatrl.envs.rules import DRAW
from splatrl.envs.senses import Senses
from splatrl.envs.sensors.base import check_sensors
from splatrl.envs.tasks.base import Outcome, Task

RESERVED = {"pixels", "state", "scene", "step_count", "episode_return", "level", "outcome", "goals", "success"}
RESERVED |= {"free_fraction", "action", "reward", "done", "terminated", "truncated"}
RESERVED |= {"camera_offset", "appearance", "weather", DRAW}  # keys of transforms
"""Keys of the env and its transforms, which neither a task's memory nor a sensor may use."""


class Specs(NamedTuple):
    """Specs of a batch of robots.

    Attributes:
        observation: all outputs other than reward and done flags, including those carried from step to step.
        state: inputs of a step other than the action.
        action, reward, done: as in TorchRL.
    """

    observation: Composite
    state: Composite
    action: Composite
    reward: Composite
    done: Composite


def env_specs(task: Task, senses: Senses, scenes: int, batch_size: torch.Size, device: torch.device | None) -> Specs:
    """Build the specs of an env for a task; ``SplatEnv`` documents the keys.

    Args:
        task: the robots' task.
        senses: the robots' camera and sensors.
        scenes: number of scenes.
        batch_size: [B].
        device: device of the env's tensors.

    Raises:
        ValueError: for a sensor or a task memory that uses one of the env's keys, or a sensor with nothing to read.
    """
    check_sensors(senses.sensors, task)
    remembered, motion, robot = task.memory_spec, task.motion, senses.robot
    if taken := {*senses.sensors} & (RESERVED | {*remembered}):
        raise ValueError(f"sensors: expected keys that env and task do not use, got {', '.join(sorted(taken))}")
    if taken := {*remembered} & RESERVED:
        raise ValueError(f"task.memory_spec: expected keys that the env does not use, got {', '.join(sorted(taken))}")
    count = Unbounded(shape=(1,), dtype=torch.int64)
    number = Unbounded(shape=(1,), dtype=torch.float32)
    flag = Categorical(2, shape=(1,), dtype=torch.bool)
    carried: dict[str, TensorSpec] = {
        "state": motion.state_spec,
        "step_count": count,
        "episode_return": number,
        "level": count,
        "goals": count,
        **remembered,
        **senses.memory_spec(),
    }
    if scenes > 1:
        carried["scene"] = Categorical(scenes, shape=(1,), dtype=torch.int64)
    shown: dict[str, TensorSpec] = {
        "pixels": Bounded(0, 255, shape=(robot.image_height, robot.image_width, 3), dtype=torch.uint8),
        "outcome": Categorical(len(Outcome), shape=(1,), dtype=torch.int64),
        "success": flag,
        "free_fraction": Bounded(0.0, 1.0, shape=(1,), dtype=torch.float32),
        **senses.drawing.specs,
        **{key: sensor.spec(robot) for key, sensor in senses.sensors.items()},
    }

    def batched(specs: Mapping[str, TensorSpec]) -> Composite:
        own = {key: spec.clone().expand(*batch_size, *spec.shape) for key, spec in specs.items()}
        return Composite(own, shape=batch_size).to(device)

    return Specs(
        observation=batched(shown | carried),
        state=batched(carried),  # read by a step, so fake inputs must contain it
        action=batched({"action": motion.action_spec}),
        reward=batched({"reward": number}),
        done=batched(dict.fromkeys(("done", "terminated", "truncated"), flag)),
    )
