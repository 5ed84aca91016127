"""Policies exported as gaits."""

from pathlib import Path

import pytest
import torch
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.building import build_model, build_one_world
from splatrl.configuration import load_config
from splatrl.export.gait import gait_of
from splatrl.motions.legs import FELT, JOINTS
from splatrl.physics.dense import Dense
from splatrl.training import Actor
from splatrl.training.inputs import Input
from splatrl.training.networks import actor_critic
from tests.tiny import tiny_overrides


def test_a_gait_takes_the_policys_most_probable_action(tmp_path: Path) -> None:
    cfg = load_config(tiny_overrides(tmp_path, "strides"))
    env = build_one_world(cfg).env(4)
    torch.manual_seed(0)
    model = build_model(cfg, env)
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape)
    td = env.rollout(3, Actor(model), break_when_any_done=False)[:, -1]
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = Actor(model, judges=False)(td.clone())["action"]
    gait_of(model).save(tmp_path / "gait.npz")
    found = Dense.load(tmp_path / "gait.npz", FELT, JOINTS)(td["felt"])
    assert torch.allclose(found, expected, atol=1e-5) and found.abs().max() > 0.05


def test_a_policy_with_other_inputs_or_outputs_is_refused_as_a_gait() -> None:
    spec = Bounded(-torch.ones(2), torch.ones(2))
    with pytest.raises(ValueError, match="gait: expected a policy that reads only vectors and has no memory"):
        gait_of(actor_critic((8, 12, 3), spec, 1, (4, 4), 16))
    with pytest.raises(ValueError, match="gait: expected 46 inputs and 12 outputs, got 3 and 2"):
        gait_of(actor_critic((8, 12, 3), spec, 1, (4, 4), 16, inputs={"gps": Input("plain", (3,))}))
