"""Settings of learning, with the names that TorchRL's examples use."""

from dataclasses import dataclass

from splatrl.values import require_number


@dataclass(frozen=True)
class LossSettings:
    """Settings of the loss.

    Attributes:
        gamma: discount factor.
        gae_lambda: λ of generalised advantage estimation.
        clip_epsilon: how far the probability ratio may depart from 1.
        ppo_epochs: passes over each batch.
        mini_batch_size: frames per gradient step.
        critic_coeff: weight of the value loss.
        entropy_coeff: weight of the entropy bonus at the start.
        anneal_entropy: whether that weight falls linearly to zero by the end of training.
        reward_scale: factor on the rewards that learning reads, and nowhere else.

    Raises:
        ValueError: if a value is out of range; the message names it.
    """

    gamma: float
    gae_lambda: float
    clip_epsilon: float
    ppo_epochs: int
    mini_batch_size: int
    critic_coeff: float
    entropy_coeff: float
    anneal_entropy: bool
    reward_scale: float

    def __post_init__(self) -> None:
        for name in ("gamma", "gae_lambda"):
            require_number(f"loss.{name}", getattr(self, name), 0.0, 1.0)
        for name in ("clip_epsilon", "critic_coeff", "entropy_coeff", "reward_scale"):
            require_number(f"loss.{name}", getattr(self, name), 0.0)
        for name in ("ppo_epochs", "mini_batch_size"):
            require_number(f"loss.{name}", getattr(self, name), 1, whole=True)


@dataclass(frozen=True)
class OptimSettings:
    """Settings of Adam.

    Attributes:
        lr: learning rate at the start.
        eps: Adam's epsilon.
        max_grad_norm: norm to which gradients are clipped.
        anneal_lr: whether the rate falls linearly to zero by the end of training.
        compile: whether the loss of a minibatch is compiled (``torch.compile``), which takes about a minute at first.

    Raises:
        ValueError: if a value is out of range; the message names it.
    """

    lr: float
    eps: float
    max_grad_norm: float
    anneal_lr: bool
    compile: bool = False

    def __post_init__(self) -> None:
        for name in ("lr", "eps", "max_grad_norm"):
            require_number(f"optim.{name}", getattr(self, name), 0.0)
