"""View matching: a trunk that reads a view and a goal's image learns the relative pose between the two.

Pairs cost nothing beyond the views themselves: any two views of a scene form a pair whose relative pose is known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.envs.sensors import ImageGoal
from splatrl.geometry import along_heading
from splatrl.training.device_memory import with_room
from splatrl.training.heads import orthogonal
from splatrl.values import require_number
from splatrl.waits import Bar

READS = ("pixels", ImageGoal.KEY)


@dataclass(frozen=True)
class MatchingSettings:
    """Settings of learning from pairs of views.

    Attributes:
        frames: episodes to begin, in which no robot acts; each gives a robot's view and its goal's image. 0 is off.
        pairs: number of pairs of views to draw, each from one scene.
        mini_batch_size: pairs per gradient step.
        lr: learning rate of Adam, which falls linearly to zero.

    Raises:
        ValueError: if a value is out of range; the message names it.
    """

    frames: int
    pairs: int
    mini_batch_size: int
    lr: float

    def __post_init__(self) -> None:
        require_number("matching.frames", self.frames, 0, whole=True)
        for name in ("pairs", "mini_batch_size"):
            require_number(f"matching.{name}", getattr(self, name), 1, whole=True)
        require_number("matching.lr", self.lr, 0.0)


class Views(NamedTuple):
    """N views of some scenes.

    Attributes:
        image: [N, H, W, 3] uint8, on the env's device if it has room (``with_room``), the others on the CPU.
        planar: [N, 3] float32, x and y in metres and yaw in radians.
        around: [N] int64, rows of the views, sorted by scene and within each scene by heading.
        first: [N] int64, for each position in this order, the position at which its scene begins.
        among: [N] int64, for each position in this order, the number of views of its scene.
    """

    image: Tensor
    planar: Tensor
    around: Tensor
    first: Tensor
    among: Tensor


def views(env: EnvBase, frames: int) -> Views:
    """Collect robots' views and the images of their goals at the start of episodes.

    Args:
        env: batched env of B robots, in which robots observe ``READS``.
        frames: number of episodes, a multiple of B; there are twice as many views.
    """
    shape = (2, frames, *env.observation_spec[ImageGoal.KEY].shape[1:])
    image = torch.empty(shape, dtype=torch.uint8, device=with_room(env.device, math.prod(shape)))
    planar, scene = torch.empty(2, frames, 3), torch.zeros(2, frames, dtype=torch.int64)
    batches = torch.arange(frames).split(env.numel())
    for rows in Bar(batches, desc="collect views", unit="batch", leave=False):
        begun = env.reset()
        for number, key in enumerate(READS):
            image[number, rows] = begun[key].to(image.device)
        planar[0, rows], planar[1, rows] = env.task.motion.planar(begun["state"]).float().cpu(), begun["goal"].cpu()
        if (own := begun.get("scene", None)) is not None:
            scene[:, rows] = own.squeeze(1).cpu()
    return views_of(image.flatten(0, 1), planar.flatten(0, 1), scene.flatten())


def views_of(image: Tensor, planar: Tensor, scene: Tensor) -> Views:
    """Make ``Views`` of images and poses [N, ...], given the scene of each, [N] int64."""
    around = (scene * math.tau + planar[:, 2] % math.tau).argsort(stable=True)
    counts = scene.bincount()
    first, own = counts.cumsum(0) - counts, scene[around]
    return Views(image, planar, around, first[own], counts[own])


def check_reads(keys: Sequence[str]) -> None:
    """Refuse a policy that reads anything but a view and a goal's image, with a ValueError."""
    if tuple(keys) != READS:
        raise ValueError(
            f"matching.frames: expected 0, or a policy that reads only {' and '.join(READS)}, got one that reads "
            f"{', '.join(keys)}"
        )


class Matcher:
    """Trains a trunk with Adam to tell from where one of two views was seen, in the frame of the other view's robot.

    A linear layer predicts the position, in metres, and the cosine and sine of the turn from the trunk's features; it
    is discarded afterwards.

    Args:
        model: actor and critic over a shared trunk, which reads ``READS``.
        settings: see ``MatchingSettings``.

    Raises:
        ValueError: for a model that reads anything else.
    """

    def __init__(self, model: ActorValueOperator, settings: MatchingSettings):
        prepare, trunk, *_ = model.module[0].module
        check_reads(prepare.in_keys)
        self.settings, self._prepare, self._trunk = settings, prepare.module, trunk.module
        self._device = next(trunk.parameters()).device

    def fit(self, shown: Views) -> float:
        """Learn from pairs of views, and return the mean loss over the last tenth of the steps."""
        size, losses = self.settings.mini_batch_size, list[Tensor]()
        head = orthogonal(nn.Linear(len(self._features(shown, *drawn(shown, 1))[0]), 4), 1.0).to(self._device)
        parameters = [*self._trunk.parameters(), *head.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=self.settings.lr)
        steps = math.ceil(self.settings.pairs / size)
        bar = Bar(range(steps), desc="match views", unit="batch", leave=False)
        for step in bar:
            for group in optimizer.param_groups:
                group["lr"] = self.settings.lr * (1.0 - step / steps)
            here, there = drawn(shown, size)
            told = head(self._features(shown, here, there))
            loss = smooth_l1_loss(told, seen_from(shown.planar[here], shown.planar[there]).to(self._device))
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 1.0)
            optimizer.step()
            losses.append(loss.detach())
        return float(torch.stack(losses[-math.ceil(steps / 10) :]).mean())

    def _features(self, shown: Views, here: Tensor, there: Tensor) -> Tensor:
        prepared = self._prepare(shown.image[here].to(self._device), shown.image[there].to(self._device))
        return self._trunk(*prepared)


def drawn(shown: Views, count: int) -> tuple[Tensor, Tensor]:
    """Draw pairs of views: rows of both, [count] int64 each. The closer two headings are, the likelier is the pair."""
    here = torch.randint(len(shown.around), (count,))
    first, among = shown.first[here], shown.among[here]
    away = 0.5 * among * (2.0 * torch.rand(count) - 1.0) ** 3
    there = first + (here - first + (away.sign() * away.abs().ceil()).long()) % among
    return shown.around[here], shown.around[there]


def seen_from(here: Tensor, there: Tensor) -> Tensor:
    """Express ``there`` in the frames of ``here``: [N, 3] each -> [N, 4], x and y in metres, cosine and sine of yaw."""
    turn = (there[:, 2] - here[:, 2]).unsqueeze(1)
    return torch.cat([along_heading(there[:, :2] - here[:, :2], here[:, 2]), turn.cos(), turn.sin()], 1)
