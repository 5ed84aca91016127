"""An ``Actor``, which works on plain tensors, acts as its model does through TensorDicts."""

import pytest
import torch
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.training import Actor, actor_critic
from splatrl.training.memory import STATE
from tests.tiny import tiny_env
from tests.training.test_memory import remembering
from tests.training.toys import Match

ENVS = {"discrete": lambda: tiny_env([5]), "continuous": lambda: Match(5)}
KINDS = (ExplorationType.RANDOM, ExplorationType.DETERMINISTIC)


@pytest.mark.parametrize("judges", [True, False])
@pytest.mark.parametrize(
    ("name", "kind"),
    [*((name, kind) for name in ENVS for kind in KINDS), ("discrete", ExplorationType.MODE)],
)
def test_an_actor_writes_what_its_model_writes(name: str, kind: ExplorationType, judges: bool) -> None:
    env: EnvBase = ENVS[name]()
    torch.manual_seed(0)
    model = actor_critic(env.observation_spec["pixels"].shape[1:], env.action_spec, 1, (16, 16), 32)
    seen = env.reset()
    with set_exploration_type(kind), torch.no_grad():
        torch.manual_seed(1)
        found = Actor(model, judges)(seen.copy())
        torch.manual_seed(1)
        expected = model(seen.copy())
    assert ("state_value" in found.keys()) == judges  # noqa: SIM118, a TensorDict is no dict
    for key in ("image", "action", "action_log_prob", "state_value")[: 4 if judges else 3]:
        assert torch.equal(found[key], expected[key]), key
    assert not found["action_log_prob"].requires_grad


@pytest.mark.parametrize("memory", [16, 6])  # compiled, and in PyTorch
@pytest.mark.parametrize("kind", KINDS)
def test_an_actor_remembers_what_its_model_remembers(kind: ExplorationType, memory: int) -> None:
    env = remembering(tiny_env([5]), memory)
    torch.manual_seed(0)
    shape = env.observation_spec["pixels"].shape[1:]
    model = actor_critic(shape, env.action_spec, 1, (16, 16), 32, memory=memory)
    actor, seen = Actor(model), env.reset()
    seen[STATE], seen["is_init"] = torch.randn(5, 1, memory), torch.tensor([[True], [False]] * 2 + [[False]])
    with set_exploration_type(kind), torch.no_grad():
        torch.manual_seed(1)
        found = actor(seen.copy())
        torch.manual_seed(1)
        expected = model(seen.copy())
    for key in ("image", "action", "action_log_prob", "state_value", ("next", STATE)):
        assert torch.equal(found[key], expected[key]), key
    assert "hidden" not in found.keys()  # noqa: SIM118, which is in the next state already
