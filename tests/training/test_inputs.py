"""Policy networks that read several inputs."""

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Categorical, Composite, Unbounded

from splatrl.training import PPO, Input, LossSettings, OptimSettings, actor_critic, inputs_of
from splatrl.training.inputs import Prepare
from tests.envs.sensors.test_sensors import sensing_env

ACTIONS = Categorical(4, shape=())
IMAGES = {"pixels": Input("image", (16, 24, 3)), "depth": Input("image", (16, 24, 1))}
VECTORS = {"goal": Input("polar", (2,)), "compass": Input("angle", (1,)), "lidar": Input("plain", (5,))}


def observed(batch: int) -> TensorDict:
    torch.manual_seed(0)
    return TensorDict(
        {
            "pixels": torch.randint(0, 256, (batch, 16, 24, 3), dtype=torch.uint8),
            "depth": torch.rand(batch, 16, 24, 1),
            "goal": torch.rand(batch, 2),
            "compass": torch.rand(batch, 1),
            "lidar": torch.rand(batch, 5),
        },
        [batch],
    )


def test_images_are_joined_as_channels_and_vectors_are_encoded() -> None:
    td = observed(2)
    image, vector = Prepare(IMAGES | VECTORS, 1)(*(td[key] for key in IMAGES | VECTORS))
    assert image.shape == (2, 16, 24, 4) and vector.shape == (2, 3 + 2 + 5)
    torch.testing.assert_close(image[..., 3:], td["depth"] - 0.5)
    torch.testing.assert_close(image[..., :3], td["pixels"] / 255.0 - 0.5)
    rho, phi = td["goal"][0].tolist()
    turn = float(td["compass"][0])
    encoded = [math.log1p(rho), math.cos(phi), math.sin(phi), math.cos(turn), math.sin(turn), *td["lidar"][0].tolist()]
    torch.testing.assert_close(vector[0], torch.tensor(encoded))
    assert sum(one.size for one in VECTORS.values()) == 10


@pytest.mark.parametrize("inputs", [IMAGES | VECTORS, IMAGES, VECTORS], ids=["both", "images", "vectors"])
@pytest.mark.parametrize("memory", [0, 8])
def test_a_policy_depends_on_each_of_its_inputs_and_on_nothing_else(inputs, memory) -> None:
    torch.manual_seed(1)
    model = actor_critic((16, 24, 3), ACTIONS, pool=1, features=16, memory=memory, inputs=inputs)
    td = observed(2)
    if memory:
        td["recurrent_state"], td["is_init"] = torch.zeros(2, 1, memory), torch.ones(2, 1, dtype=torch.bool)
    value = model(td.clone())["state_value"]
    assert value.shape == (2, 1)
    for key in IMAGES | VECTORS:
        other = td.clone()
        other[key] = other[key].flip(0)
        assert torch.equal(model(other)["state_value"], value) is (key not in inputs), key


def test_empty_inputs_leave_the_parameters_of_a_pixel_policy_unchanged() -> None:
    torch.manual_seed(0)
    plain = actor_critic((16, 24, 3), ACTIONS, pool=1)
    torch.manual_seed(0)
    none = actor_critic((16, 24, 3), ACTIONS, pool=1, inputs={})
    assert list(plain.state_dict()) == list(none.state_dict())
    assert all(torch.equal(one, none.state_dict()[key]) for key, one in plain.state_dict().items())


@pytest.mark.parametrize("on_device", [False, True])
def test_ppo_learns_from_several_inputs_with_either_collector(on_device) -> None:
    env = sensing_env((4,))
    inputs = inputs_of(
        {"depth": "image", "lidar": "plain", "compass": "angle", "contact": "plain"}, env.observation_spec
    )
    torch.manual_seed(0)
    model = actor_critic(env.observation_spec["pixels"].shape[1:], env.action_spec, 1, features=16, inputs=inputs)
    loss = LossSettings(0.9, 0.9, 0.2, 2, 16, 0.5, 0.01, True, 0.1)
    ppo = PPO(env, model, loss, OptimSettings(1e-3, 1e-5, 0.5, True, False), 32, 64, on_device=on_device)
    before = [parameter.clone() for parameter in model.parameters()]
    report = ppo.iterate()
    assert math.isfinite(report["loss_critic"])
    assert all((old != new).any() for old, new in zip(before, model.parameters(), strict=True))


@pytest.mark.parametrize(
    ("named", "match"),
    [
        ({"pixels": "picture"}, r"inputs.pixels: expected one of image, plain, angle, polar, got picture"),
        ({"sonar": "plain"}, r"inputs.sonar: expected an observation, found none"),
        ({"lidar": "image"}, r"inputs.lidar: expected a shape that suits image encoding, got \[5\]"),
        ({"lidar": "polar"}, r"inputs.lidar: expected a shape that suits polar encoding"),
        ({"pixels": "image", "small": "image"}, r"inputs: expected images of the same size"),
    ],
)
def test_missing_or_unsuitable_inputs_are_refused(named, match) -> None:
    shapes = {"pixels": (16, 24, 3), "small": (8, 8, 1), "lidar": (5,)}
    spec = Composite({key: Unbounded(shape=(2, *shape)) for key, shape in shapes.items()}, shape=[2])
    with pytest.raises(ValueError, match=match):
        inputs_of(named, spec)
