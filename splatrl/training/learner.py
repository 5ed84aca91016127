"""Learning from a batch of frames: advantages, minibatches and gradient steps."""

from collections.abc import Callable, Iterator
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ActorValueOperator, set_recurrent_mode
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

from splatrl.training.heads import distribution
from splatrl.training.loss import STATISTICS, clipped_loss
from splatrl.training.memory import STATE
from splatrl.training.native_step import native_step
from splatrl.training.repeats import first_alike
from splatrl.training.settings import LossSettings, OptimSettings

Capture = Callable[[Callable[[], None]], Callable[[], None]]
"""Makes a call faster that has no arguments and works in place on the same tensors: ``CudaGraph``."""


class Learner:
    """Adam on the clipped loss; a policy without memory learns from single frames, one with memory from sequences.

    The trunk is evaluated once per frame, and both heads read its output. On a CPU, the trunk is evaluated only once
    for identical frames of a minibatch, which changes nothing but the order of sums. Pooled images and the critic's
    values are kept from collection.

    Args:
        model: actor and critic over a shared trunk.
        loss: settings of the loss.
        optim: settings of the optimiser.
        capture: captures gradient steps; None takes them one operation after another, as do compiled losses.
    """

    def __init__(
        self, model: ActorValueOperator, loss: LossSettings, optim: OptimSettings, capture: Capture | None = None
    ):
        self.model, self.loss, self.optim = model, loss, optim
        self.entropy_coeff = loss.entropy_coeff
        self.parameters = list(model.parameters())
        self.optimizer = torch.optim.Adam(self.parameters, lr=optim.lr, eps=optim.eps, fused=True)
        pool, trunk, *memory = model.module[0].module
        self._pool, self._trunk, self._memory = pool.module, trunk.module, memory
        self._reads, self._prepared = list(pool.in_keys), list(pool.out_keys)
        self._measured = torch.compile(self._losses) if optim.compile else self._losses
        self._policy, self._value = model.get_policy_head(), model.get_value_head().module
        parts = self._trunk, self._policy, self._value
        self._native = None if memory or optim.compile else native_step(*parts, optim.max_grad_norm)
        self._captured = CapturedSteps(self, capture) if capture is not None and not optim.compile else None

    def anneal(self, left: float) -> None:
        """Set learning rate and entropy bonus for the point at which a fraction ``left`` of the training remains."""
        if self.optim.anneal_lr:
            for group in self.optimizer.param_groups:
                if isinstance(group["lr"], Tensor):
                    group["lr"].fill_(self.optim.lr * left)  # a captured step reads this tensor
                else:
                    group["lr"] = self.optim.lr * left
        if self.loss.anneal_entropy:
            self.entropy_coeff = self.loss.entropy_coeff * left

    def load_optimizer(self, state: dict[str, Any]) -> None:
        """Continue with the optimiser's state of a checkpoint."""
        self.optimizer.load_state_dict(state)
        if self._captured is not None:
            self._captured = CapturedSteps(self, self._captured.capture)

    def learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a batch of frames [B, T], and return the means of ``STATISTICS`` over its gradient steps."""
        batch["advantage"], batch["value_target"] = self.advantages(batch)
        alike, epochs = self.alike(batch), range(self.loss.ppo_epochs)
        steps = [self.step(frames) for _ in epochs for frames in self.minibatches(batch, alike)]
        return dict(zip(STATISTICS, torch.stack(steps).mean(0).tolist(), strict=True))

    @torch.no_grad()
    def advantages(self, batch: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return generalised advantages and value targets, [B, T, 1] each.

        The value of the next observation is read from the next column. Only where the rollout ends, or an episode was
        truncated and the next column is a new start, is the critic evaluated again, with its memory after that step. A
        batch with a ``next_value`` needs no evaluation.
        """
        value, after = batch["state_value"], batch["next"]
        next_value = batch.get("next_value", None)
        if next_value is None:
            next_value = self._next_values(value, after)
        return vec_generalized_advantage_estimate(
            self.loss.gamma,
            self.loss.gae_lambda,
            value,
            next_value,
            after["reward"] * self.loss.reward_scale,
            after["done"],
            after["terminated"],
        )

    def _next_values(self, value: Tensor, after: TensorDictBase) -> Tensor:
        """Return the critic's values of the observations after each step, [B, T, 1]."""
        next_value = torch.cat([value[:, 1:], value[:, -1:]], 1)
        asked = after["truncated"].squeeze(-1).clone()
        asked[:, -1] = True
        seen = after.select(*self._reads, STATE, "is_init", strict=False)[asked]
        next_value[asked] = self.model.get_value_operator()(seen)["state_value"]
        return next_value

    def alike(self, batch: TensorDictBase) -> Tensor | None:
        """Return, for each frame of a batch [B * T], the first with identical inputs; None if that would not help."""
        fixed = self._memory or self._captured is not None or self.optim.compile  # minibatches must keep their sizes
        if fixed or batch["action"].device.type != "cpu" or not self._is_prepared(batch):
            return None
        return first_alike(*(batch[key].flatten(0, 1) for key in self._prepared))

    def _is_prepared(self, batch: TensorDictBase) -> bool:
        return all(key in batch.keys() for key in self._prepared)  # noqa: SIM118, a TensorDict is no dict

    def minibatches(self, batch: TensorDictBase, alike: Tensor | None = None) -> Iterator[dict[str, Tensor]]:
        """Yield every frame once, in random order: [N, ...] each, or with memory whole rows of the batch, [N, T, ...].

        If a batch lacks the output of the weight-free part, such as ``image``, it is computed here. With ``alike``, a
        minibatch holds identical inputs only once, and ``shown`` [N] is the index of each frame's inputs among them.
        """
        made = self._is_prepared(batch)
        view = self._prepared if made else self._reads
        frames: dict[str, Any] = {key: batch[key] for key in (*view, "action", "action_log_prob")}
        frames |= {key: batch[key].squeeze(-1) for key in ("advantage", "value_target")}
        size = self.loss.mini_batch_size
        if self._memory:
            frames |= {key: batch[key] for key in (STATE, "is_init")}
            size = max(size // batch.shape[1], 1)
        else:
            frames = {key: value.flatten(0, 1) for key, value in frames.items()}
        count, device = len(frames["action"]), frames["action"].device
        for rows in torch.randperm(count, device=device).split(size):
            shown = rows
            if alike is not None:
                shown, of_frame = alike[rows].unique(return_inverse=True)
            some = {key: value.index_select(0, shown if key in view else rows) for key, value in frames.items()}
            if alike is not None:
                some["shown"] = of_frame
            if not made:
                found = self._pool(*(some.pop(key) for key in self._reads))
                some |= zip(self._prepared, found if isinstance(found, tuple) else (found,), strict=True)
            yield some

    def step(self, frames: dict[str, Tensor]) -> Tensor:
        """Take one gradient step on a minibatch.

        Args:
            frames: a minibatch, as ``minibatches`` yields them.

        Returns:
            ``STATISTICS``, [5] float32.
        """
        if self._native is not None and self._native.suits(frames, self.optimizer):
            return self._native.step(frames, self.optimizer, self.loss, self.entropy_coeff)
        if self._captured is not None:
            return self._captured.step(frames)
        return self.descend(frames, self._bonus(frames["action"].device))

    def descend(self, frames: dict[str, Tensor], entropy_coeff: float | Tensor) -> Tensor:
        """Take one gradient step with PyTorch; see ``step``."""
        loss, statistics = self._measured(frames, entropy_coeff)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.parameters, self.optim.max_grad_norm)
        self.optimizer.step()
        return statistics

    def _losses(self, frames: dict[str, Tensor], entropy_coeff: float | Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss of a minibatch, and ``STATISTICS``."""
        hidden = self._hidden(frames)
        policy, value = distribution(self._policy, hidden), self._value(hidden).squeeze(-1)
        return clipped_loss(policy, value, frames, self.loss, entropy_coeff)

    def _bonus(self, device: torch.device) -> float | Tensor:
        """Weight of the entropy bonus; a tensor for compiled code, which would be recompiled for each new number."""
        return torch.full((), self.entropy_coeff, device=device) if self.optim.compile else self.entropy_coeff

    def _hidden(self, frames: dict[str, Tensor]) -> Tensor:
        hidden = self._trunk(*(frames[key] for key in self._prepared))
        if "shown" in frames:
            hidden = hidden.index_select(0, frames["shown"])
        for module in self._memory:
            known = {"features": hidden, **{key: frames[key] for key in (STATE, "is_init")}}
            with set_recurrent_mode(True):
                hidden = module(TensorDict(known, hidden.shape[:2]))["hidden"]
        return hidden


class CapturedSteps:
    """Takes a learner's gradient steps by one call that is captured, for minibatches of the size of the first.

    Minibatches of any other size, such as the rest of a batch, are not captured.

    Args:
        learner: the learner, whose optimiser must keep its state tensors from now on.
        capture: captures a call.
    """

    def __init__(self, learner: Learner, capture: Capture):
        self.learner, self.capture = learner, capture
        device = learner.parameters[0].device
        for group in learner.optimizer.param_groups:
            group["lr"], group["capturable"] = torch.as_tensor(group["lr"], device=device), True
        self._entropy_coeff = torch.zeros((), device=device)
        self._statistics = torch.zeros(len(STATISTICS), device=device)
        self._frames = dict[str, Tensor]()
        self._call = capture(self._descend)

    def step(self, frames: dict[str, Tensor]) -> Tensor:
        """Take one gradient step on a minibatch; see ``Learner.step``."""
        self._entropy_coeff.fill_(self.learner.entropy_coeff)
        if not self._frames:
            self._frames = {key: value.clone() for key, value in frames.items()}
        elif _shapes(frames) != _shapes(self._frames):
            return self.learner.descend(frames, self._entropy_coeff)
        else:
            for key, value in frames.items():
                self._frames[key].copy_(value)
        self._call()
        return self._statistics.clone()

    def _descend(self) -> None:
        self._statistics.copy_(self.learner.descend(self._frames, self._entropy_coeff))


def _shapes(frames: dict[str, Tensor]) -> dict[str, torch.Size]:
    return {key: value.shape for key, value in frames.items()}
