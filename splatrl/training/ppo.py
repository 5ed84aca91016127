"""Proximal policy optimisation (Schulman et al. 2017) on one batched env, resumable byte for byte."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.envs.nesting import check_layers, raise_faults, set_state, state_of
from splatrl.envs.tasks import Outcome
from splatrl.training.actor import Actor
from splatrl.training.collectors import Collector, HostCollector, device_collector
from splatrl.training.cuda_graph import CudaGraph
from splatrl.training.learner import Learner
from splatrl.training.settings import LossSettings, OptimSettings
from splatrl.values import require_number


def check_frames(frames_per_batch: int, total_frames: int, num_envs: int) -> None:
    """Refuse batches that the robots cannot share evenly, and a frame budget without room for one batch.

    Args:
        frames_per_batch: frames between updates.
        total_frames: frames that the whole training may use.
        num_envs: number of robots.

    Raises:
        ValueError: names the key, what it may be and what was given.
    """
    for name, frames in (("frames_per_batch", frames_per_batch), ("total_frames", total_frames)):
        require_number(f"collector.{name}", frames, 1, whole=True)
    if frames_per_batch % num_envs:
        raise ValueError(
            f"collector.frames_per_batch: expected a multiple of env.num_envs = {num_envs}, got {frames_per_batch}"
        )
    if total_frames < frames_per_batch:
        raise ValueError(
            f"collector.total_frames: expected at least frames_per_batch = {frames_per_batch}, got {total_frames}"
        )


class PPO:
    """Collects batches of frames and learns from them; training can be stopped and resumed after any batch.

    Args:
        env: batched env with ``pixels``, ``outcome`` and ``level``, transformed or not; for a model with memory it
            needs ``memory_transforms``.
        model: actor and critic over a shared trunk.
        loss: settings of the loss.
        optim: settings of the optimiser.
        frames_per_batch: frames between updates, a multiple of the env's batch size.
        total_frames: frames that the whole training may use; the last batch ends at or before this number.
        cuda_graph: whether the steps of a rollout and of learning on a GPU are each captured in a CUDA graph; None
            captures those of a rollout if renderer and checker can be captured, and those of learning. A compiled loss
            learns without a graph.
        on_device: whether rollouts stay on the device (``DeviceCollector``); None keeps them there except on a CPU.

    Raises:
        ValueError: if ``frames_per_batch`` is not a multiple of the env's batch size, ``total_frames`` is less than one
            batch, or a graph is asked for but cannot be captured.
    """

    def __init__(
        self,
        env: EnvBase,
        model: ActorValueOperator,
        loss: LossSettings,
        optim: OptimSettings,
        frames_per_batch: int,
        total_frames: int,
        cuda_graph: bool | None = None,
        on_device: bool | None = None,
    ):
        check_frames(frames_per_batch, total_frames, env.numel())
        check_layers(env)
        self.env, self.model = env, model
        self.frames_per_batch, self.total_frames = frames_per_batch, total_frames
        self.frames = 0
        self.device = env.device or torch.device("cpu")
        captured = self.device.type == "cuda" and cuda_graph is not False
        self.learner = Learner(model, loss, optim, CudaGraph if captured else None)
        steps = frames_per_batch // env.numel()
        self.collector: Collector
        if on_device is None:
            on_device = self.device.type != "cpu"
        if on_device or cuda_graph:
            self.collector = device_collector(env, model, steps, cuda_graph)
        else:
            self.collector = HostCollector(env, Actor(model), steps)

    @property
    def finished(self) -> bool:
        """Whether another batch would exceed ``total_frames``."""
        return self.frames + self.frames_per_batch > self.total_frames

    def iterate(self) -> dict[str, float]:
        """Collect one batch and learn from it.

        Returns:
            Frames so far; the number, success rate, mean number of goals, collision rate, mean return and mean length
            of the episodes that ended (NaN if none did); and the losses.
        """
        self.learner.anneal(1.0 - self.frames / self.total_frames)
        batch = self.collect()
        self.frames += batch.numel()
        report = _episodes(batch) | self.learner.learn(batch)
        report["frames"] = self.frames
        return report

    def collect(self) -> TensorDictBase:
        """Collect the next frames, [B, T]: the observations, actions and results of each robot.

        Raises:
            ValueError: if renderer or checker refused their input, which they note on the device.
        """
        batch = self.collector.collect()
        raise_faults(self.env)
        return batch

    def state_dict(self) -> dict[str, Any]:
        """Return all that the rest of the training depends on, as tensors and plain values."""
        return {
            "device": self.device.type,
            "frames": self.frames,
            "model": self.model.state_dict(),
            "optimizer": self.learner.optimizer.state_dict(),
            **state_of(self.env),
            "carried": self.collector.carried.to_dict(),
            "torch_rng": torch.get_rng_state(),
            "device_rng": torch.cuda.get_rng_state(self.device) if self.device.type == "cuda" else None,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a ``state_dict()`` of the same configuration.

        Raises:
            ValueError: for a state from another kind of device, whose random numbers cannot be continued here, or of
                another number of robots.
        """
        made_on = state.get("device", "cpu")
        if made_on != self.device.type:
            raise ValueError(f"device: expected {made_on}, on which the checkpoint was made, got {self.device.type}")
        if (robots := len(state["carried"]["done"])) != self.env.numel():
            raise ValueError(
                f"env.num_envs: expected {robots}, with which the training began, got {self.env.numel()}; a training "
                "keeps its number of robots"
            )
        self.frames = state["frames"]
        self.model.load_state_dict(state["model"])
        self.learner.load_optimizer(state["optimizer"])
        set_state(self.env, state)
        carried = self.env.fake_tensordict().exclude("next", "action")
        if missing := sorted(key for key in carried.keys() if key not in state["carried"]):  # noqa: SIM118
            raise RuntimeError(f"found no {', '.join(missing)} in the checkpoint")
        self.collector.carried = carried.empty().update(state["carried"])
        torch.set_rng_state(state["torch_rng"].cpu())
        if self.device.type == "cuda":
            torch.cuda.set_rng_state(state["device_rng"].cpu(), self.device)


def _episodes(batch: TensorDictBase) -> dict[str, float]:
    ended = batch["next"][batch["next", "done"].squeeze(-1)]
    counted = ended.get("collisions", None)  # by tasks whose episodes a collision does not end
    collided = ended["outcome"] == Outcome.COLLISION if counted is None else counted > 0
    return {
        "episodes": len(ended),
        "success": ended["success"].float().mean().item(),
        "goals": ended["goals"].float().mean().item(),
        "collision": collided.float().mean().item(),
        "return": ended["episode_return"].mean().item(),
        "length": ended["step_count"].float().mean().item(),
    }
