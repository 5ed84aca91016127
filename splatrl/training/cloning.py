"""Behaviour cloning (Pomerleau 1989): a policy learns to imitate demonstrations before it learns from reward."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.distributions import Distribution
from torch.nn.functional import smooth_l1_loss
from torchrl.modules import ActorValueOperator

from splatrl.training.distributions import Choice
from splatrl.training.heads import distribution
from splatrl.values import require_number
from splatrl.waits import Bar


@dataclass(frozen=True)
class CloningSettings:
    """Settings of behaviour cloning.

    Attributes:
        epochs: passes over the demonstrations.
        mini_batch_size: frames per gradient step.
        lr: learning rate of Adam.
        critic_coeff: weight of the loss of the critic, which learns the demonstrations' discounted returns.
        power: exponent of the distance in the loss of continuous actions. In states that look alike, 2 teaches the mean
            of the right actions and 1 their median: if half of them turn left and half turn right, the policy turns.

    Raises:
        ValueError: if a value is out of range; the message names it.
    """

    epochs: int
    mini_batch_size: int
    lr: float
    critic_coeff: float
    power: float = 2.0

    def __post_init__(self) -> None:
        for name in ("epochs", "mini_batch_size"):
            require_number(f"cloning.{name}", getattr(self, name), 1, whole=True)
        for name in ("lr", "critic_coeff"):
            require_number(f"cloning.{name}", getattr(self, name), 0.0)
        require_number("cloning.power", self.power, 1.0, 2.0)


class Cloner:
    """Fits a policy to right actions with Adam: by cross entropy, or by squared distance where actions are continuous.

    The distance is that of the policy's mode, in units of half an action's range; ``CloningSettings.power`` may be
    other than two. The standard deviation of continuous actions learns to equal the mean error of the mode, so that a
    policy that knows what to do does not act at random. A policy with memory learns from whole episodes. The optimiser
    keeps its moments from one ``fit`` to the next.

    Args:
        model: actor and critic over a shared trunk.
        settings: see ``CloningSettings``.

    Attributes:
        reads: keys that the policy reads.
    """

    def __init__(self, model: ActorValueOperator, settings: CloningSettings):
        self.settings, self.parameters = settings, list(model.parameters())
        self.optimizer = torch.optim.Adam(self.parameters, lr=settings.lr, fused=True)
        prepare, trunk, *memory = model.module[0].module
        self.reads = tuple(str(key) for key in prepare.in_keys)
        self._prepare, self._trunk, self._memory = prepare.module, trunk.module, memory
        self._policy, self._value = model.get_policy_head(), model.get_value_head().module
        self._device = self.parameters[0].device

    def fit(self, shown: Mapping[str, Tensor], epochs: int | None = None, anneal: bool = False) -> float:
        """Learn from frames, and return the mean imitation loss of the last pass; see ``passes``."""
        return list(self.passes(shown, self.settings.epochs if epochs is None else epochs, anneal))[-1]

    def passes(self, shown: Mapping[str, Tensor], epochs: int, anneal: bool = False, done: int = 0) -> Iterator[float]:
        """Learn from frames, and yield the mean imitation loss of each pass.

        Args:
            shown: N frames of episodes, in order: the observations that the policy ``reads``, [N, ...] each, such as
                ``pixels`` [N, H, W, C] uint8; ``target`` [N, D] float32, see ``imitation``; ``value_target`` [N]
                float32; ``frame`` [N] int64, 0 where episodes begin.
            epochs: passes over the frames.
            anneal: whether the learning rate falls linearly to zero over these passes.
            done: number of these passes that have been made already.

        Raises:
            ValueError: for frames that begin within an episode, of which a memory lacks what came before.
        """
        if self._memory and int(shown["frame"][0]) != 0:
            raise ValueError(f"frame: expected 0 first, where an episode begins, got {int(shown['frame'][0])}")
        count = len(shown["target"])
        bars = {"total": epochs * count, "initial": done * count, "desc": "imitate", "unit": "frame"}
        with Bar(**bars, leave=False) as bar:
            for number in range(done, epochs):
                for group in self.optimizer.param_groups:
                    group["lr"] = self.settings.lr * (1.0 - number / epochs if anneal else 1.0)
                losses = list[Tensor]()
                for frames in self._minibatches(shown):
                    losses.append(self._step(frames) * len(frames["target"]))
                    bar.update(len(frames["target"]))
                yield float(torch.stack(losses).sum()) / count

    def _minibatches(self, shown: Mapping[str, Tensor]) -> Iterator[dict[str, Tensor]]:
        """Yield every frame once, in random order; with memory, every episode once, one or more per minibatch."""
        size, begins = self.settings.mini_batch_size, (shown["frame"] == 0).nonzero().squeeze(1).cpu()
        rows: list[Tensor] = list(torch.arange(len(shown["frame"])).tensor_split(begins[1:]))
        if self._memory:
            order, chosen, count = torch.randperm(len(rows)).tolist(), list[Tensor](), 0
            for number in order:
                chosen.append(rows[number])
                count += len(rows[number])
                if count >= size or number == order[-1]:
                    yield self._some(shown, torch.cat(chosen))
                    chosen, count = [], 0
            return
        for some in torch.randperm(len(shown["frame"])).split(size):
            yield self._some(shown, some)

    def _some(self, shown: Mapping[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
        rows = rows.to(shown["frame"].device)
        return {key: value[rows].to(self._device) for key, value in shown.items()}

    def _step(self, frames: dict[str, Tensor]) -> Tensor:
        prepared = self._prepare(*(frames[key] for key in self.reads))
        given = prepared if isinstance(prepared, tuple) else (prepared,)
        hidden = self._hidden(self._trunk(*given), frames["frame"])
        policy = distribution(self._policy, hidden)
        loss = imitation(policy, frames["target"], self.settings.power)
        critic = smooth_l1_loss(self._value(hidden).squeeze(-1), frames["value_target"])
        self.optimizer.zero_grad()
        (loss + width(policy, frames["target"]) + self.settings.critic_coeff * critic).backward()
        nn.utils.clip_grad_norm_(self.parameters, 1.0)
        self.optimizer.step()
        return loss.detach()

    def _hidden(self, hidden: Tensor, frame: Tensor) -> Tensor:
        """Return what the heads read: features that have passed through the memory, if any, episode by episode."""
        for module in self._memory:
            hidden = module.along(hidden, (frame == 0).nonzero().squeeze(1))
        return hidden


def imitation(policy: Distribution, target: Tensor, power: float = 2.0) -> Tensor:
    """Return the imitation loss of a policy, averaged over frames: [] float32; see ``Cloner``.

    Args:
        policy: distribution of actions in each frame, [N].
        target: [N, A] float32, probabilities of the A discrete actions, which sum to 1; or [N, D] float32, the right
            action if actions are continuous. NaN in frames whose right action is unknown, which do not count.
        power: see ``CloningSettings``.
    """
    if isinstance(policy, Choice):
        each = -(policy.logits * target.nan_to_num()).sum(-1)
    else:
        each = _off(policy, target).abs().pow(power).mean(-1)
    return _mean(each, target)


def width(policy: Distribution, target: Tensor) -> Tensor:
    """Return the mean squared difference between standard deviations and the errors of the mode: [] float32.

    Standard deviations are those before the tanh, which in the middle of a range are in units of half the range.
    Gradients reach only them and not the mode. Discrete actions have no standard deviation, which gives 0.

    Args:
        policy: see ``imitation``.
        target: see ``imitation``.
    """
    if isinstance(policy, Choice):
        return torch.zeros((), device=target.device)
    off = _off(policy, target).detach().abs()
    return _mean((policy.scale - off).square().mean(-1), target)  # type: ignore[attr-defined]


def _off(policy: Distribution, target: Tensor) -> Tensor:
    """Errors of the modes, in units of half the actions' ranges: [N, D]; 0 where the right action is unknown."""
    reach = (policy.high - policy.low) / 2.0  # type: ignore[attr-defined]
    return ((policy.deterministic_sample - target) / reach).nan_to_num()  # type: ignore[attr-defined]


def _mean(each: Tensor, target: Tensor) -> Tensor:
    """Mean over the frames [N] whose right action is known."""
    known = ~target.isnan().any(-1)
    return torch.where(known, each, 0.0).sum() / known.sum().clamp_min(1)
