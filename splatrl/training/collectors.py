"""Collectors of frames: one whose rollout the host drives, and one that never synchronises with the host."""

from collections.abc import Callable, Sequence
from typing import Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.envs.nesting import layers
from splatrl.envs.restart import restart
from splatrl.training.cuda_graph import CudaGraph
from splatrl.training.memory import STATE

CHOSEN = ("action", "action_log_prob", "state_value")
"""Keys that the model writes."""
ENDS = ("reward", "done", "terminated", "truncated", "outcome", "goals", "success", "episode_return", "step_count")
"""Keys of a step's result that learning and reports read, besides ``collisions`` of tasks that count them."""


class Collector(Protocol):
    """Collects batches, each of which begins where the last one stopped.

    Attributes:
        carried: the state from which the next batch starts; all that a checkpoint has to store.
    """

    @property
    def carried(self) -> TensorDictBase:
        """The state from which the next batch starts."""
        ...

    @carried.setter
    def carried(self, value: TensorDictBase) -> None: ...

    def collect(self) -> TensorDictBase:
        """Collect the next frames, [B, T]: the observations, actions and results of each robot."""
        ...


class HostCollector:
    """TorchRL's rollout, in which the host checks after each step which robots are done, and stacks the steps.

    Args:
        env: batched env.
        actor: writes actions; an ``Actor`` does so on plain tensors, because TensorDicts would take half the time of a
            rollout on a CPU.
        steps: T, the length of each batch.
    """

    def __init__(self, env: EnvBase, actor: Callable[[TensorDictBase], TensorDictBase], steps: int):
        self.env, self.actor, self.steps = env, actor, steps
        self.carried = env.reset()

    @torch.no_grad()
    def collect(self) -> TensorDictBase:
        """Collect the next frames, [B, T]."""
        options = {"auto_reset": False, "tensordict": self.carried, "break_when_any_done": False}
        batch = self.env.rollout(self.steps, self.actor, **options)
        self.carried = self.env.step_mdp(batch[:, -1].clone())  # the next rollout resets the robots that are done
        return batch


class DeviceCollector:
    """A rollout that stays on the device: policy, step and automatic reset write in place and never synchronise.

    Episodes are those of a ``HostCollector`` that resets in every step, whether any episode ended or not. The batch
    holds what learning and reports read, in tensors that the next batch overwrites: the model's observations or what
    its weight-free part made of them (such as pooled images), whichever takes less memory, ``CHOSEN``, ``ENDS`` under
    ``"next"``, and ``next_value``, the critic's value of the observation after the step and before the reset.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        model: actor and critic.
        steps: T, the length of each batch.
        capture: wraps the function that takes a step, for instance in a CUDA graph; None calls it directly.
        begin: the state from which the first batch starts; None resets the env.
    """

    def __init__(
        self,
        env: EnvBase,
        model: ActorValueOperator,
        steps: int,
        capture: Callable[[Callable[[], None]], Callable[[], None]] | None = None,
        begin: TensorDictBase | None = None,
    ):
        self.env, self.model, self.critic, self.steps = env, model, model.get_value_operator(), steps
        prepare = model.module[0].module[0]
        self._reads, self._prepared = tuple(prepare.in_keys), tuple(prepare.out_keys)
        self._now = (env.reset() if begin is None else begin).clone()
        self._batch = TensorDict(batch_size=[*env.batch_size, steps], device=env.device)
        self._column = torch.zeros(1, dtype=torch.int64, device=env.device)
        self._advance = self._step if capture is None else capture(self._step)

    @property
    def carried(self) -> TensorDictBase:
        """The state from which the next batch starts."""
        return self._now.clone()

    @carried.setter
    def carried(self, value: TensorDictBase) -> None:
        for key, tensor in self._now.items():
            tensor.copy_(value[key])

    @torch.no_grad()
    def collect(self) -> TensorDictBase:
        """Collect the next frames, [B, T], which are valid until the next call."""
        self._column.zero_()
        for _ in range(self.steps):
            self._advance()
        return self._batch.copy()

    def _step(self) -> None:
        """Fill one column of the batch, and set the state from which the next column starts."""
        acted = self.env.step(self.model(self._now.copy()))
        after = acted["next"]
        seen = after.select(*self._reads, STATE, "is_init", strict=False)
        acted["next_value"] = self.critic(seen)["state_value"]
        small = _size(acted, self._prepared) <= _size(acted, self._reads)
        for key in (*(self._prepared if small else self._reads), STATE, "is_init", *CHOSEN, "next_value"):
            if acted.get(key, None) is not None:
                self._note(key, acted[key])
        for key in (*ENDS, "collisions"):
            if (value := after.get(key, None)) is not None:
                self._note(("next", key), value)
        begun = restart(self.env, after)
        for key, tensor in self._now.items():
            tensor.copy_(begun[key])
        self._column.add_(1)

    def _note(self, key: str | tuple[str, str], value: Tensor) -> None:
        """Write values [B, ...] into the current column, whose index exists only on the device."""
        if self._batch.get(key, None) is None:
            self._batch.set(key, value.new_zeros(*self._batch.batch_size, *value.shape[1:]))
        self._batch.get(key).index_copy_(1, self._column, value.unsqueeze(1))


def _size(td: TensorDictBase, keys: Sequence[str]) -> int:
    """Return the number of bytes of some entries."""
    return sum(td[key].nbytes for key in keys)


def device_collector(env: EnvBase, model: ActorValueOperator, steps: int, cuda_graph: bool | None) -> DeviceCollector:
    """Make a collector on the env's device, whose steps are captured in a CUDA graph if possible.

    Args:
        env: a ``SplatEnv``, bare or under transforms.
        model: actor and critic.
        steps: T, the length of each batch.
        cuda_graph: whether to capture; None does so if renderer and checker can be captured.

    Raises:
        ValueError: for ``cuda_graph=True`` if the steps cannot be captured.
    """
    base = layers(env)[0]
    possible = env.device.type == "cuda" and base.capturable
    if cuda_graph and not possible:
        raise ValueError(
            "collector.cuda_graph: expected an env on a CUDA device with CudaRenderer and CudaChecker (or no checker), "
            f"got {type(base.drawing.renderer).__name__} and {type(base.checker).__name__} on {env.device}"
        )
    if cuda_graph is False or not possible:
        return DeviceCollector(env, model, steps)
    return DeviceCollector(env, model, steps, lambda step: CudaGraph(step, [base.generator]))
