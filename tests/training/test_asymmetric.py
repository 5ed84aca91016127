"""Asymmetric actor-critic: the critic receives more observations than the actor."""

from collections.abc import Mapping

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Categorical
from torchrl.modules import ActorValueOperator

from splatrl.training.actor import Actor
from splatrl.training.asymmetric import actors_trunk
from splatrl.training.inputs import Input
from splatrl.training.learner import Learner
from splatrl.training.networks import actor_critic
from splatrl.training.settings import LossSettings, OptimSettings

SPEC = Bounded(-torch.ones(2), torch.ones(2))
TOLD: Mapping[str, Input] = {"ball": Input("plain", (3,)), "yaw": Input("angle", (1,))}


def model(inputs: Mapping[str, Input] | None = None, told: Mapping[str, Input] = TOLD) -> ActorValueOperator:
    torch.manual_seed(0)
    return actor_critic((8, 12, 3), SPEC, 1, (4, 4), 16, inputs=inputs, critic_inputs=told)


def seen(count: int = 5) -> TensorDict:
    draw = torch.Generator().manual_seed(0)
    pixels = torch.randint(256, (count, 8, 12, 3), generator=draw, dtype=torch.uint8)
    vectors = {"ball": torch.randn(count, 3, generator=draw), "yaw": torch.randn(count, 1, generator=draw)}
    return TensorDict({"pixels": pixels, **vectors, "felt": torch.randn(count, 4, generator=draw)}, [count])


@pytest.mark.parametrize("inputs", [None, {"felt": Input("plain", (4,))}])
def test_the_critic_depends_on_its_extra_inputs_and_the_actor_does_not(inputs: Mapping[str, Input] | None) -> None:
    net, td = model(inputs), seen()
    for layer in net.get_value_head().parameters():
        layer.data.normal_(generator=torch.Generator().manual_seed(1))
    other = td.clone().set("ball", td["ball"] + 1.0)
    first, second = net(td.clone()), net(other)
    assert torch.equal(first["loc"], second["loc"]) and torch.equal(first["scale"], second["scale"])
    assert not torch.allclose(first["state_value"], second["state_value"])
    turned = net(td.clone().set("yaw", td["yaw"] + 6.283185307))
    assert torch.allclose(turned["state_value"], first["state_value"], atol=1e-4)  # a full turn changes nothing


def test_without_the_critic_the_actor_acts_the_same_and_reads_fewer_inputs() -> None:
    net, td = model(), seen()
    trunk = actors_trunk(net)
    assert list(trunk.in_keys) == ["pixels"]
    hidden = trunk(td.select("pixels").clone())
    assert torch.equal(net.get_policy_head()(hidden)["loc"], net(td.clone())["loc"])
    plain = actor_critic((8, 12, 3), SPEC, 1, (4, 4), 16)
    assert actors_trunk(plain) is plain.module[0]


def test_critic_inputs_do_not_change_the_initial_weights_of_the_actor() -> None:
    torch.manual_seed(0)
    plain = actor_critic((8, 12, 3), SPEC, 1, (4, 4), 16)
    for own, other in zip(plain.module[0].parameters(), actors_trunk(model()).parameters(), strict=True):
        assert torch.equal(own, other)


def test_an_asymmetric_policy_acts_and_learns_on_plain_tensors() -> None:
    net = model()
    loss = LossSettings(0.9, 0.9, 0.2, 1, 8, 0.5, 0.0, False, 1.0)
    learner = Learner(net, loss, OptimSettings(1e-2, 1e-5, 1.0, False))
    td = Actor(net)(seen(8))
    before = [each.detach().clone() for each in net.parameters()]
    after = {"reward": td["ball"][:, :1], "done": torch.ones(8, 1).bool(), "terminated": torch.ones(8, 1).bool()}
    after["truncated"] = torch.zeros(8, 1).bool()
    batch = td.clone().set("next", TensorDict({**seen(8), **after}, [8])).unsqueeze(1)
    learner.learn(batch)
    assert all(not torch.equal(a, b) for a, b in zip(before, net.parameters(), strict=True))


@pytest.mark.parametrize(
    ("told", "memory", "message"),
    [
        ({"pixels": Input("image", (8, 12, 3))}, 0, "expected observations that the actor does not read, got pixels"),
        ({"depth": Input("image", (8, 12, 1))}, 0, r"critic_inputs\.depth: expected plain, angle or polar, got image"),
        ({"ball": Input("plain", (3,))}, 8, "critic_inputs: expected none for a policy with memory, got ball"),
    ],
)
def test_invalid_critic_inputs_are_refused(told: Mapping[str, Input], memory: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        actor_critic((8, 12, 3), SPEC, 1, (4, 4), 16, memory, critic_inputs=told)


def test_discrete_actions_work_with_critic_inputs_too() -> None:
    net = actor_critic((8, 12, 3), Categorical(5), 1, (4, 4), 16, critic_inputs=TOLD)
    assert net(seen())["logits"].shape == (5, 5)
