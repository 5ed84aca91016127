"""Times a gradient step of PPO on a GPU, captured in a CUDA graph, with and without ``Convolution``, in turns.

``python benchmarks/gpu_step.py``; with ``--dry-run`` on a CPU, with few frames, where no number is a measurement.
"""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median
from unittest.mock import patch

import torch
from gpu_device import in_turns
from record import print_markdown
from torch import Tensor, nn
from torchrl.data import Categorical

from splatrl.training import LossSettings, OptimSettings, actor_critic
from splatrl.training.convolution import Convolution
from splatrl.training.cuda_graph import CudaGraph
from splatrl.training.learner import Learner

FRAMES, DRY_FRAMES = 4096, 64
"""Frames in a minibatch of ``ppo=many``, and in a dry run."""
ACTIONS, SIDE = 5, 32
STEPS = 20
"""Gradient steps per turn."""
SECONDS = 8.0
LOSS = LossSettings(
    0.9, 0.95, 0.2, 4, FRAMES, critic_coeff=0.5, entropy_coeff=0.01, anneal_entropy=False, reward_scale=0.1
)
OPTIM = OptimSettings(lr=1e-3, eps=1e-5, max_grad_norm=0.5, anneal_lr=False)


def minibatch(count: int, device: torch.device) -> dict[str, Tensor]:
    """Return pooled images of random values, with what the loss reads."""
    generator = torch.Generator().manual_seed(0)
    frames = {
        "image": torch.rand(count, SIDE, SIDE, 3, generator=generator) - 0.5,
        "action": torch.randint(ACTIONS, (count,), generator=generator),
        "action_log_prob": torch.full((count,), -1.6),
        "advantage": torch.randn(count, generator=generator),
        "value_target": torch.randn(count, generator=generator),
    }
    return {key: value.to(device) for key, value in frames.items()}


@contextmanager
def with_cudnn() -> Iterator[None]:
    """Let cuDNN differentiate convolutions within the ``with`` block."""
    with patch.object(Convolution, "forward", nn.Conv2d.forward):
        yield


def steps(device: torch.device, frames: dict[str, Tensor]) -> Callable[[], None]:
    """Return a call that takes some gradient steps, captured if the device is a GPU."""
    torch.manual_seed(0)
    model = actor_critic((2 * SIDE, 2 * SIDE, 3), Categorical(ACTIONS), 2).to(device)
    learner = Learner(model, LOSS, OPTIM, CudaGraph if device.type == "cuda" else None)

    def call() -> None:
        for _ in range(STEPS):
            learner.step(frames)

    call()  # is captured here
    return call


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dry-run", action="store_true")
    dry = parser.parse_args().dry_run
    device = torch.device("cpu" if dry else "cuda")
    frames = minibatch(DRY_FRAMES if dry else FRAMES, device)
    product = steps(device, frames)
    with with_cudnn():
        cudnn = steps(device, frames)
    found = in_turns({"cuDNN's": cudnn, "a product of matrices": product}, device, 0.2 if dry else SECONDS)
    rows = [[name, f"{1e3 * median(times) / STEPS:.3f}"] for name, times in found.items()]
    print_markdown(("weight gradient", "ms per step"), rows)


if __name__ == "__main__":
    main()
