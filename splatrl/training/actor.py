"""Acting with a model on plain tensors, at a fraction of the cost of TensorDicts."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torch.distributions import Distribution
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import ActorValueOperator

from splatrl.training.heads import distribution
from splatrl.training.memory import STATE


class Actor:
    """Writes what ``model(td)`` writes: the prepared inputs, ``action``, ``action_log_prob`` and ``state_value``.

    A model with memory also writes its next ``recurrent_state``. The actor draws the same actions from the same
    generator, and follows TorchRL's ``set_exploration_type``. If that is neither random nor deterministic, any model
    acts through TensorDicts.

    Args:
        model: actor and critic over a shared trunk.
        judges: whether to evaluate the critic as well.
    """

    def __init__(self, model: ActorValueOperator, judges: bool = True):
        pool, trunk, *self._memory = model.module[0].module
        self._whole = model if judges else model.get_policy_operator()
        self._judges = judges
        self._pool, self._trunk = pool.module, trunk.module
        self._reads, self._prepared = list(pool.in_keys), list(pool.out_keys)
        self._policy, self._value = model.get_policy_head(), model.get_value_head().module

    @torch.no_grad()
    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        """Act on observations [B], and return them with what the model writes."""
        kind = exploration_type() or ExplorationType.RANDOM
        if kind not in (ExplorationType.RANDOM, ExplorationType.DETERMINISTIC):
            return self._whole(td)
        found = self._pool(*(td.get(key) for key in self._reads))
        prepared = found if isinstance(found, tuple) else (found,)
        written: dict[NestedKey, Tensor] = dict(zip(self._prepared, prepared, strict=True))
        hidden = self._trunk(*prepared)
        for module in self._memory:
            hidden = module.after(hidden, td.get(STATE).squeeze(-2), td.get("is_init"))
            written["next", STATE] = hidden.unsqueeze(-2)
        policy = distribution(self._policy, hidden)
        written["action"] = action = _chosen(policy, kind)
        written["action_log_prob"] = policy.log_prob(action)
        if self._judges:
            written["state_value"] = self._value(hidden)
        for key, value in written.items():
            td.set(key, value)
        return td


def _chosen(policy: Distribution, kind: ExplorationType) -> Tensor:
    """Choose actions as TorchRL's ``ProbabilisticTensorDictModule`` does."""
    if kind == ExplorationType.DETERMINISTIC:
        return policy.deterministic_sample  # type: ignore[attr-defined]
    return policy.rsample() if policy.has_rsample else policy.sample()
