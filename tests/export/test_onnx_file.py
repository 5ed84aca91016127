"""Policies exported to ONNX: onnxruntime computes what PyTorch does, and the file describes itself."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.envs import RewardScaling, Transform
from torchrl.modules import ActorValueOperator

from splatrl.bodies import Sphere
from splatrl.building import build_model, build_world
from splatrl.configuration import load_config
from splatrl.envs.mjcf_robot import mjcf_robot
from splatrl.envs.robot import Robot
from splatrl.envs.world import World
from splatrl.export import StandalonePolicy, export_policy
from splatrl.export.onnx_file import largest_difference, metadata, onnx_bytes
from tests.tiny import tiny_overrides

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra export")
pytest.importorskip("onnxscript", reason="needs the extra export")

pytestmark = pytest.mark.usefixtures("translated_once")

UP_LEFT = ((1.0, 0.0, 0.0, 0.1), (0.0, 0.5, 0.866, 0.0), (0.0, -0.866, 0.5, 0.2), (0.0, 0.0, 0.0, 1.0))
"""Mount of a camera that looks to the left and 30° up, 20 cm above the centre."""
SHAKEN = ["transforms/pose_noise=unsteady", "transforms/appearance=varied"]
KINDS: dict[str, list[str]] = {
    "drive": ["task=drive", "memory=gru", "task.motion.spacing=0.25", *SHAKEN],
    "sensors": [
        "task=pointnav",
        "sensors=[rgb,depth,lidar,contact,pointgoal]",
        "sensors.lidar.field_deg=180",
        "sensors.lidar.elevation_deg=-5",
        "memory=stack",
        "network.memory=24",
        "transforms.stack.in_keys=[pixels,depth]",
    ],
    "blind": ["task=pointnav", "sensors=[pointgoal]"],
    "compared": ["task=imagenav", "network.fusion=correlation"],
}
OBSERVED = {
    "sensors": ["pixels", "depth", "lidar", "contact", "pointgoal_with_gps_compass"],
    "blind": ["pointgoal_with_gps_compass"],
    "compared": ["pixels", "imagegoal"],
}

REMEMBERED = {"drive": ["recurrent_state"], "sensors": ["frames", "depth_frames", "recurrent_state"]}


def trained(folder: Path, *overrides: str) -> tuple[World, ActorValueOperator]:
    """Build a world, and a policy whose random weights are large enough for its actions to differ."""
    task = overrides[0].partition("=")[2]
    cfg = load_config([*tiny_overrides(folder, task), *overrides])
    world = build_world(cfg)
    torch.manual_seed(0)
    model = build_model(cfg, world.env(1))
    with torch.no_grad():
        for parameter in model.get_policy_head().parameters():
            parameter.add_(torch.randn_like(parameter) * 0.3)
    return world, model


Exported = tuple[World, ActorValueOperator, Path, float]
"""A world, a policy, the folder it was written to, and the largest difference that was found."""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Exported]:
    """Return a function that exports the policy of a kind, once."""

    @cache
    def export(kind: str) -> Exported:
        folder = tmp_path_factory.mktemp(kind)
        world, model = trained(folder, *KINDS[kind])
        found = export_policy(model, world, folder / "out", frames=200, facts={"scene": "room"})
        return world, model, folder / "out", found

    return export


@pytest.mark.parametrize("kind", ["drive", "sensors", "blind", pytest.param("compared", marks=pytest.mark.slow)])
def test_onnxruntime_computes_what_pytorch_does(kind: str, exported: Callable[[str], Exported]) -> None:
    world, _, folder, found = exported(kind)
    assert found <= 1e-5
    assert {path.name for path in folder.iterdir()} == {"policy.onnx", "run_policy.py"}
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    remembered = REMEMBERED.get(kind, [])
    observed = OBSERVED.get(kind, ["pixels"])
    assert [each.name for each in session.get_inputs()] == [*observed, *(["begin"] if remembered else []), *remembered]
    about = ["loc", "scale"] if kind == "drive" else ["probabilities"]
    outputs = [each.name for each in session.get_outputs()]
    assert outputs == ["action", *about, *(f"next_{name}" for name in remembered)]
    assert session.get_inputs()[0].shape[1:] == ([2] if kind == "blind" else [12, 16, 3])
    facts = session.get_modelmeta().custom_metadata_map
    assert (facts["image_width"], facts["image_height"], facts["scene"]) == ("16", "12", "room")
    assert float(facts["fov_deg"]) == 90.0 and "horizontal field of view 90 degrees" in facts["preprocessing"]
    assert json.loads(facts["actions"]) == list(world.task.motion.action_names)
    assert json.loads(facts["left_out"]) == (["PoseNoise", "Appearance"] if kind == "drive" else [])
    assert ("low" in facts) == (kind == "drive")
    if kind == "drive":
        assert json.loads(facts["controls"]) == ["forward (m/s)", "turn (rad/s)"]
    sensors = json.loads(facts["sensors"])
    assert list(sensors) == [name for name in observed if name != "pixels"]
    if kind == "sensors":
        assert sensors["depth"]["farthest"] == 10.0
        lidar = sensors["lidar"]
        assert lidar.pop("is").startswith("A planar scan")
        assert lidar == {"beams": 64, "field_deg": 180.0, "elevation_deg": -5.0, "reach": 10.0}


@pytest.mark.parametrize(
    ("robot", "pitch_deg", "above"),
    [
        (mjcf_robot("quadruped", "eye", Sphere(0.1)), 10.0, 0.342),  # 10° down, 5 cm above the centre of the torso
        (Robot(Sphere(0.1), 0.4, mount=UP_LEFT), -30.0, 0.6),
        (Robot(Sphere(0.1), 0.4, pitch_deg=15.0), 15.0, 0.4),
    ],
)
def test_the_metadata_say_where_the_camera_is_and_where_it_looks(
    robot: Robot, pitch_deg: float, above: float, exported: Callable[[str], Exported]
) -> None:
    world, model, _, _ = exported("blind")
    facts = metadata(StandalonePolicy(model, world.env(1)), robot, world.task.motion)
    found = float(facts["pitch_deg"]), float(facts["height"])
    assert found == pytest.approx((pitch_deg, above), abs=0.01)  # the MJCF rounds the axes of its camera


def test_actions_depend_on_what_is_seen_and_remembered(exported: Callable[[str], Exported]) -> None:
    world, model, folder, _ = exported("sensors")
    policy = StandalonePolicy(model, world.env(1))
    session = onnxruntime.InferenceSession(folder / "policy.onnx")
    given = {name: value.numpy() for name, value in zip(policy.inputs, policy.example(2), strict=True)}
    given["pixels"] = np.random.default_rng(0).integers(0, 256, given["pixels"].shape, np.uint8)

    def acted(**changes: np.ndarray) -> np.ndarray:
        return session.run(["probabilities"], given | changes)[0]

    first = acted()
    assert np.abs(acted(pixels=given["pixels"][::-1].copy()) - first).max() > 1e-3
    for name in ("frames", "recurrent_state"):
        other = np.full_like(given[name], 60)
        assert np.array_equal(acted(**{name: other}), first), "nothing is remembered from before the beginning"
        later = np.zeros(2, bool)
        assert np.abs(acted(begin=later, **{name: other}) - acted(begin=later)).max() > 1e-3


def test_a_policy_whose_export_differs_is_not_written(
    tmp_path: Path, exported: Callable[[str], Exported], monkeypatch: pytest.MonkeyPatch
) -> None:
    world, model, folder, _ = exported("sensors")
    other = trained(tmp_path, *KINDS["sensors"])[1]
    with torch.no_grad():
        next(other.get_policy_head().parameters()).mul_(1.001)
    env = world.env(8)
    policy, content = StandalonePolicy(model, env), (folder / "policy.onnx").read_bytes()
    assert largest_difference(content, policy, model, env, 40) < 1e-5
    assert 1e-5 < largest_difference(content, policy, other, env, 40) < 0.1
    monkeypatch.setattr("splatrl.export.onnx_file.onnx_bytes", lambda policy, facts: content)
    with pytest.raises(ValueError, match=r"policy\.onnx: expected outputs within 1e-05 of PyTorch's"):
        export_policy(other, world, tmp_path / "out", frames=40)
    assert not (tmp_path / "out").exists()


def test_a_transform_that_is_not_only_part_of_the_simulation_cannot_be_left_out(tmp_path: Path) -> None:
    world, model = trained(tmp_path, "task=grid")

    def transforms() -> list[Transform]:
        return [RewardScaling(0.0, 0.5)]

    scaled = replace(world, make_transforms=partial(transforms))
    with pytest.raises(ValueError, match=r"transforms: expected only those .* \(Appearance, .*FrameStack.*RewardScal"):
        export_policy(model, scaled, tmp_path / "out")


def test_the_same_policy_gives_the_same_bytes(exported: Callable[[str], Exported]) -> None:
    world, model, folder, _ = exported("blind")
    policy = StandalonePolicy(model, world.env(1))
    facts = metadata(policy, world.robot, world.task.motion, world.sensors) | {"scene": "room"}
    assert onnx_bytes(policy, facts) == (folder / "policy.onnx").read_bytes()
