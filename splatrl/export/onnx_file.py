"""Writing a policy as an ONNX file, after checking that onnxruntime reproduces PyTorch's outputs."""

import json
import logging
import math
import warnings
from collections.abc import Mapping
from copy import deepcopy
from inspect import getdoc
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.envs.robot import Robot
from splatrl.envs.sensors import Sensor
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.rollouts import acting
from splatrl.export.policy import NEXT, StandalonePolicy
from splatrl.extras import require
from splatrl.files import replacing
from splatrl.motions import Motion

PARITY = 1e-5
"""Largest difference from the policy in PyTorch, in a probability or an action, with which a file is still written."""
POLICY, RUNNER = "policy.onnx", "run_policy.py"
ROBOTS = 8
NO_SENSORS: Mapping[str, Sensor] = {}
_MISSING = ("export", "an ONNX file needs onnx, onnxscript and onnxruntime")


def export_policy(
    model: ActorValueOperator,
    world: World | Worlds,
    folder: Path,
    frames: int = 1000,
    facts: Mapping[str, str] | None = None,
) -> float:
    """Write ``policy.onnx`` into a folder, and ``run_policy.py`` beside it, which runs it on a camera or a video.

    A ``run_policy.py`` that is there already is kept, since it may have been changed to suit a robot.

    The file's metadata states what the policy sees and what its actions mean; see ``metadata``. It is written only if
    onnxruntime, fed with the views of episodes that the policy runs, gives the same outputs as PyTorch.

    Args:
        model: actor and critic.
        world: the world in which the policy was trained.
        folder: the folder to write to; created if it does not exist.
        frames: minimum number of views on which the two runtimes are compared.
        facts: additional metadata.

    Returns:
        The largest difference found.

    Raises:
        ImportError: if the extra ``export`` is not installed.
        ValueError: for a policy that cannot be exported, or a difference above ``PARITY``.
    """
    env = world.env(ROBOTS)
    policy = StandalonePolicy(model, env)
    about = metadata(policy, world.robot, world.task.motion, world.sensors)
    content = onnx_bytes(policy, about | dict(facts or {}))
    found = largest_difference(content, policy, model, env, frames)
    if not found <= PARITY:  # also true for NaN
        raise ValueError(f"{POLICY}: expected outputs within {PARITY} of PyTorch's, got a difference of {found:.1e}")
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / RUNNER).exists():
        with replacing(folder / RUNNER) as stream:
            stream.write(runner())
    with replacing(folder / POLICY) as stream:
        stream.write(content)
    return found


def runner() -> bytes:
    """Return the content of ``run_policy.py`` as this version of splatrl writes it."""
    return Path(__file__).with_name(RUNNER).read_bytes()


def metadata(
    policy: StandalonePolicy, robot: Robot, motion: Motion, sensors: Mapping[str, Sensor] = NO_SENSORS
) -> dict[str, str]:
    """Return the metadata that an ONNX file holds about its policy: strings, with lists and other values as JSON.

    ``fov_deg`` is the horizontal field of view; ``pitch_deg`` is how far the camera looks down, and ``height`` how high
    it is above the ground in metres, both while the body that carries it is level, as where the robot stands;
    ``actions`` are the names of discrete actions; ``controls`` are those of the numbers of a continuous one, as far as
    they have any, and ``low`` and ``high`` its limits; ``step`` is the
    longest distance that an action moves in metres, ``angle_step`` the largest angle that it turns in radians;
    ``left_out`` lists transforms of the simulated camera that a real one does not need.
    """
    height, width = robot.image_height, robot.image_width
    pitch_deg, above = _camera_place(robot)
    facts: dict[str, Any] = {
        "image_width": width,
        "image_height": height,
        "fov_deg": robot.fov_deg,
        "pitch_deg": pitch_deg,
        "height": above,
        "actions": list(motion.action_names),
        "step": motion.step,
        "angle_step": motion.angle_step,
        "left_out": policy.left_out,
        "sensors": {each.name: _about(sensors[each.name]) for each in policy.observed if each.name in sensors},
    }
    if not policy.discrete:
        space = motion.action_spec.space
        facts |= {"controls": list(motion.controls), "low": space.low.tolist(), "high": space.high.tolist()}
    preprocessing = (
        f"pixels: RGB, uint8, [batch, {height}, {width}, 3], horizontal field of view {robot.fov_deg:g} degrees; crop "
        f"the centre of the camera's image to that field of view and aspect ratio, repeat its edges where it shows "
        f"less, and shrink it by area averaging; the network does all other preprocessing"
    )
    return {"preprocessing": preprocessing} | {
        key: value if isinstance(value, str) else json.dumps(value) for key, value in facts.items()
    }


def _camera_place(robot: Robot) -> tuple[float, float]:
    """Return how far a standing robot's camera looks down, degrees, and how high it is above the ground, metres."""
    if robot.mount is None:
        return robot.pitch_deg, robot.height
    ahead, left, up = robot.camera_to_body[:3, 2].tolist()  # the optical axis
    pitch_deg = math.degrees(math.atan2(-up, math.hypot(ahead, left)))
    return round(pitch_deg, 4), round(robot.height + float(robot.camera_to_body[2, 3]), 6)  # without noise of float32


def _about(sensor: Sensor) -> dict[str, Any]:
    """Return the first paragraph of a sensor's docstring, and its settings."""
    words = " ".join((getdoc(type(sensor)) or "").partition("\n\n")[0].split())
    return {"is": words, **{key: value for key, value in vars(sensor).items() if _plain(value)}}


def _plain(value: object) -> bool:
    """Return whether a value is a number, a word or a tuple of those."""
    return all(map(_plain, value)) if isinstance(value, tuple) else isinstance(value, (bool, int, float, str))


def onnx_bytes(policy: StandalonePolicy, facts: Mapping[str, str]) -> bytes:
    """Return the contents of an ONNX file: the policy for any batch size, with metadata.

    Raises:
        ImportError: if the extra ``export`` is not installed.
    """
    onnx = require("onnx", *_MISSING)
    require("onnxscript", *_MISSING)  # PyTorch's exporter imports it
    example = policy.example(2)
    batch = torch.export.Dim("batch")
    shapes = (tuple({0: batch} for _ in example),)  # one entry for the variadic argument
    with _quietly():
        program = torch.onnx.export(
            policy,
            example,
            input_names=policy.inputs,
            output_names=policy.outputs,
            dynamic_shapes=shapes,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    proto = program.model_proto
    onnx.helper.set_model_props(proto, dict(facts))
    onnx.checker.check_model(proto, full_check=True)
    return proto.SerializeToString(deterministic=True)


class _quietly(warnings.catch_warnings):
    """Silence warnings of PyTorch's exporter within a block: they concern torchvision and its own deprecated names."""

    def __enter__(self) -> None:
        super().__enter__()
        warnings.simplefilter("ignore")
        self._level = logging.getLogger("torch.onnx").level
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)

    def __exit__(self, *error: Any) -> None:
        logging.getLogger("torch.onnx").setLevel(self._level)
        super().__exit__(*error)


def largest_difference(
    content: bytes, policy: StandalonePolicy, model: ActorValueOperator, env: EnvBase, frames: int
) -> float:
    """Return the largest difference between onnxruntime and PyTorch, in probabilities or in continuous actions.

    PyTorch acts in the env, which stacks views and carries recurrent states for it; onnxruntime receives the same views
    one at a time, and its states are fed back from its own outputs.

    Args:
        content: contents of an ONNX file.
        policy: the policy that was exported to it.
        model: actor and critic.
        env: the env in which the model acts.
        frames: minimum number of views to compare.

    Returns:
        The difference; NaN if onnxruntime returned a value that is not finite.

    Raises:
        ImportError: if the extra ``export`` is not installed.
    """
    onnxruntime = require("onnxruntime", *_MISSING)
    steps = -(-frames // env.numel())
    operator, head = model.get_policy_operator(), deepcopy(model.get_policy_head()).cpu()
    with acting(sampled=True, seed=0, device=env.device):
        env.set_seed(0)
        batch = env.rollout(steps, operator, break_when_any_done=False).cpu()
    session = onnxruntime.InferenceSession(content)
    given = dict(zip(policy.inputs, (each.numpy() for each in policy.example(env.numel())), strict=True))
    worst = 0.0
    for step in range(steps):
        for each in policy.observed:
            seen = batch[each.name][:, step]
            view = seen[..., -each.shape[-1] :] if each.name in policy.stacks else seen
            given[each.name] = view.contiguous().numpy()
        if policy.states and step:
            given["begin"] = batch["next", "done"][:, step - 1, 0].numpy()
        answer = dict(zip(policy.outputs, session.run(None, given), strict=True))
        given |= {state.name: answer[NEXT + state.name] for state in policy.states}
        for name, expected in _expected(batch[:, step], head).items():
            worst = max(worst, float(np.abs(answer[name] - expected).max(initial=0.0)))
            if not np.isfinite(answer[name]).all():
                return float("nan")
    return worst


def _expected(acted: TensorDictBase, head: ProbabilisticTensorDictSequential) -> dict[str, Any]:
    """Return PyTorch's outputs for a step's views, under the ONNX file's output names."""
    if "logits" in acted.keys():  # noqa: SIM118, a TensorDict is no dict
        return {"probabilities": acted["logits"].softmax(-1).numpy()}
    chosen = head.module[1].get_dist(acted).deterministic_sample
    return {"loc": acted["loc"].numpy(), "scale": acted["scale"].numpy(), "action": chosen.numpy()}
