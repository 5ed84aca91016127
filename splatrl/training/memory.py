"""Memory for a policy: a GRU whose state travels in the TensorDict."""

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Unbounded
from torchrl.envs import InitTracker, TensorDictPrimer, Transform
from torchrl.modules import GRUModule

from splatrl.training.native_gru import remembered, suits

STATE = "recurrent_state"


class Memory(GRUModule):
    """TorchRL's ``GRUModule`` with other evaluations: step by step without synchronising, or compiled on a CPU.

    TorchRL's version synchronises with the host to find where episodes begin, and in learning splits the batch there.
    Here, except on a CPU, the state is cleared where an episode begins, which needs no synchronisation. On a CPU the
    episodes of a batch run side by side.

    Attributes:
        stepwise: whether to learn step by step, with operations of PyTorch alone; None does so except on a CPU.
    """

    stepwise: bool | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Map ``features`` [..., F], or in learning [..., T, F], to ``hidden`` and the next state."""
        given = tensordict[self.in_keys[0]], tensordict[STATE].squeeze(-2), tensordict["is_init"]
        if self.recurrent_mode:
            rows = (each.reshape(-1, *each.shape[-2:]) for each in given)
            hidden = self._through(*rows).view(*given[0].shape[:-1], -1)
        else:
            hidden = self.after(*given)
        return tensordict.set("hidden", hidden).set(("next", STATE), hidden.unsqueeze(-2))

    def _through(self, features: Tensor, state: Tensor, is_init: Tensor) -> Tensor:
        """Return the states after T steps, of which the first begins in a given one: [B, T, ...] each -> [B, T, M]."""
        if features.device.type != "cpu" if self.stepwise is None else self.stepwise:
            now, hidden = state[:, 0], []
            for step in range(features.shape[1]):
                now = self.after(features[:, step], now, is_init[:, step])
                hidden.append(now)
            return torch.stack(hidden, 1)
        first = is_init.squeeze(-1).clone()
        first[:, 0] = True
        begins = first.flatten().nonzero().squeeze(1)
        states = torch.where(is_init, 0.0, state).flatten(0, 1)[begins]
        return self.along(features.flatten(0, 1), begins, states).unflatten(0, features.shape[:2])

    def after(self, features: Tensor, state: Tensor, is_init: Tensor) -> Tensor:
        """Return the state after one step: [..., F], [..., M] and [..., 1] bool -> [..., M]."""
        before, cell = torch.where(is_init, 0.0, state), self.gru
        rows, states = features.reshape(-1, cell.input_size), before.reshape(-1, cell.hidden_size)
        weights = (cell.weight_ih_l0, cell.weight_hh_l0, cell.bias_ih_l0, cell.bias_hh_l0)
        return torch.gru_cell(rows, states, *weights).view(before.shape)

    def along(self, features: Tensor, begins: Tensor, states: Tensor | None = None) -> Tensor:
        """Return the states after the frames of episodes, given one episode after another: [N, F] -> [N, M].

        Args:
            features: [N, F].
            begins: [S] int64, the first frame of each episode, ascending from 0.
            states: [S, M], the state before each episode's first frame, through which no gradient flows; None begins
                with zeros.
        """
        if states is None:
            states = features.new_zeros(len(begins), self.gru.hidden_size)
        if suits(features, self.gru):
            return remembered(features, begins, states, self.gru)
        lengths = begins.diff(append=begins.new_tensor([len(features)]))
        seen = (torch.arange(int(lengths.max()), device=features.device) < lengths.unsqueeze(1)).unsqueeze(-1)
        padded = features.new_zeros(*seen.shape[:2], features.shape[1]).masked_scatter(seen, features)
        thought, _ = self.gru(padded, states.unsqueeze(0))
        return thought.masked_select(seen).unflatten(0, (len(features), -1))


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
