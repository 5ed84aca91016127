"""Proximal policy optimisation (Schulman et al. 2017) on one batched env, resumable to the byte."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.modules import ActorValueOperator

from splatrl.envs.tasks import Outcome
from splatrl.training.learner import Learner
from splatrl.training.settings import LossSettings, OptimSettings


class PPO:
    """Collects a batch of frames, learns from it, and can be stopped and gone on with at any batch.

    Args:
        env: batched, with ``pixels``, ``outcome`` and ``level``, transformed or not; for a model with memory it has
            its ``memory_transforms``.
        model: actor and critic over a shared trunk.
        loss: settings of the loss.
        optim: settings of the optimiser.
        frames_per_batch: frames between updates, a multiple of the env's batch.
        total_frames: frames that the whole training may use; the last batch ends at or before them.

    Raises:
        ValueError: for batch sizes that do not divide, or a total below one batch.
    """

    def __init__(
        self,
        env: EnvBase,
        model: ActorValueOperator,
        loss: LossSettings,
        optim: OptimSettings,
        frames_per_batch: int,
        total_frames: int,
    ):
        if frames_per_batch % env.numel():
            raise ValueError(
                f"collector.frames_per_batch: expected a multiple of env.num_envs = {env.numel()}, "
                f"got {frames_per_batch}"
            )
        if total_frames < frames_per_batch:
            raise ValueError(
                f"collector.total_frames: expected at least frames_per_batch = {frames_per_batch}, got {total_frames}"
            )
        self.env, self.model, self.learner = env, model, Learner(model, loss, optim)
        self.frames_per_batch, self.total_frames = frames_per_batch, total_frames
        self.frames = 0
        self.carried = env.reset()  # what the next batch starts from

    @property
    def finished(self) -> bool:
        """Whether another batch would go beyond ``total_frames``."""
        return self.frames + self.frames_per_batch > self.total_frames

    def iterate(self) -> dict[str, float]:
        """Collect one batch and learn from it.

        Returns:
            What happened: frames, episodes, success, collisions, mean return and length of the episodes that ended
            (NaN when none did), and the losses.
        """
        self.learner.anneal(1.0 - self.frames / self.total_frames)
        batch = self.collect()
        self.frames += batch.numel()
        report = _episodes(batch) | self.learner.learn(batch)
        report["frames"] = self.frames
        return report

    def collect(self) -> TensorDictBase:
        """The next frames, [B, T]: what each robot saw, did and met."""
        with torch.no_grad():
            batch = self.env.rollout(
                self.frames_per_batch // self.env.numel(),
                self.model,
                auto_reset=False,
                tensordict=self.carried,
                break_when_any_done=False,
            )
            self.carried = self.env.step_mdp(batch[:, -1].clone())  # the next rollout resets what is done
        return batch

    def state_dict(self) -> dict[str, Any]:
        """All that the rest of the training depends on, as tensors and plain values."""
        base, transformed = _layers(self.env)
        return {
            "frames": self.frames,
            "model": self.model.state_dict(),
            "optimizer": self.learner.optimizer.state_dict(),
            "env": base.state_dict(),
            "transforms": [env.transform.state_dict() for env in transformed],
            "carried": self.carried.to_dict(),
            "torch_rng": torch.get_rng_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict()`` of the same configuration."""
        base, transformed = _layers(self.env)
        self.frames = state["frames"]
        self.model.load_state_dict(state["model"])
        self.learner.optimizer.load_state_dict(state["optimizer"])
        base.load_state_dict(state["env"])
        for env, saved in zip(transformed, state["transforms"], strict=True):
            env.transform.load_state_dict(saved)
        self.carried = self.env.fake_tensordict().empty().update(state["carried"])
        torch.set_rng_state(state["torch_rng"].cpu())


def _layers(env: EnvBase) -> tuple[EnvBase, list[TransformedEnv]]:
    """The env at the bottom, and those around it from the outermost."""
    transformed = []
    while isinstance(env, TransformedEnv):
        transformed.append(env)
        env = env.base_env
    return env, transformed


def _episodes(batch: TensorDictBase) -> dict[str, float]:
    ended = batch["next"][batch["next", "done"].squeeze(-1)]
    outcome = ended["outcome"]
    return {
        "episodes": len(ended),
        "success": (outcome == Outcome.GOAL).float().mean().item(),
        "collision": (outcome == Outcome.COLLISION).float().mean().item(),
        "return": ended["episode_return"].mean().item(),
        "length": ended["step_count"].float().mean().item(),
    }
