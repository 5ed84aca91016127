"""Memory for a policy: a GRU whose state travels in the TensorDict."""

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Unbounded
from torchrl.envs import InitTracker, TensorDictPrimer, Transform
from torchrl.modules import GRUModule

STATE = "recurrent_state"


class Memory(GRUModule):
    """TorchRL's ``GRUModule``, evaluated step by step except on a CPU.

    TorchRL's version synchronises with the host to find where episodes begin, and in learning splits the batch there.
    Here the state is cleared where an episode begins, which needs no synchronisation.

    Attributes:
        stepwise: whether to evaluate step by step; None does so except on a CPU.
    """

    stepwise: bool | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Map ``features`` [B, F], or in learning [B, T, F], to ``hidden`` and the next state."""
        features, is_init = tensordict[self.in_keys[0]], tensordict["is_init"]
        stepwise = features.device.type != "cpu" if self.stepwise is None else self.stepwise
        if not stepwise:
            return super().forward(tensordict)
        if not self.recurrent_mode:
            state = self._after(features, tensordict[STATE].squeeze(-2), is_init)
            return tensordict.set("hidden", state).set(("next", STATE), state.unsqueeze(-2))
        state, hidden = tensordict[STATE][:, 0].squeeze(-2), []
        for step in range(features.shape[1]):
            state = self._after(features[:, step], state, is_init[:, step])
            hidden.append(state)
        stacked = torch.stack(hidden, 1)
        return tensordict.set("hidden", stacked).set(("next", STATE), stacked.unsqueeze(-2))

    def _after(self, features: Tensor, state: Tensor, is_init: Tensor) -> Tensor:
        """Return the state after one step: [B, F], [B, M] and [B, 1] bool -> [B, M]."""
        cell = self.gru
        weights = (cell.weight_ih_l0, cell.weight_hh_l0, cell.bias_ih_l0, cell.bias_hh_l0)
        return torch.gru_cell(features, torch.where(is_init, 0.0, state), *weights)


class RecurrentReset(TensorDictPrimer):
    """TorchRL's primer with zeros, but without synchronising to find out whether any row is reset."""

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        batch = tensordict_reset.batch_size
        for key, spec in self.primers.items(True, True):
            shape = spec.shape[-2:]
            tensordict_reset.set(key, torch.zeros(*batch, *shape, dtype=spec.dtype, device=tensordict_reset.device))
        return tensordict_reset


def gru(features: int, memory: int) -> Memory:
    """Make a GRU that maps ``features`` and ``recurrent_state`` to ``hidden`` and the next ``recurrent_state``.

    Args:
        features: size of the input.
        memory: size of state and output.
    """
    module = Memory(features, memory, in_keys=["features", STATE], out_keys=["hidden", ("next", STATE)])
    for name, parameter in module.gru.named_parameters():
        if name.startswith("weight"):
            nn.init.orthogonal_(parameter)
        else:
            nn.init.constant_(parameter, 0.0)
    return module


def memory_transforms(memory: int) -> list[Transform]:
    """Return the transforms that an env needs for ``actor_critic(..., memory=memory)``, to be applied after all others.

    They carry ``recurrent_state`` [B, 1, memory] float32 from step to step, zero it where episodes begin, and mark
    these steps in ``is_init``.

    Args:
        memory: size of the state; 0 needs no transforms.
    """
    if not memory:
        return []
    return [InitTracker(), RecurrentReset({STATE: Unbounded(shape=(1, memory))}, expand_specs=True)]
