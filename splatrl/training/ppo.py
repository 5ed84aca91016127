"""Proximal policy optimisation (Schulman et al. 2017) on one batched env, resumable to the byte."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value.functional import vec_generalized_advantage_estimate

from splatrl.envs.tasks import Outcome
from splatrl.training.settings import LossSettings, OptimSettings


class PPO:
    """Collects a batch of frames, learns from it, and can be stopped and gone on with at any batch.

    Args:
        env: batched, with ``pixels``, ``outcome`` and ``level``.
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
        self.env, self.model, self.loss, self.optim = env, model, loss, optim
        self.frames_per_batch, self.total_frames = frames_per_batch, total_frames
        self.trunk = model.module[0].select_subsequence(in_keys=["image"], out_keys=["hidden"])
        self.objective = ClipPPOLoss(
            model.get_policy_head(),
            model.get_value_head(),
            clip_epsilon=loss.clip_epsilon,
            entropy_coeff=loss.entropy_coeff,
            critic_coeff=loss.critic_coeff,
            normalize_advantage=True,
        )
        self.optimizer = torch.optim.Adam(model.parameters(), lr=optim.lr, eps=optim.eps)
        self.frames = 0
        self.carried: TensorDictBase | None = None

    @property
    def finished(self) -> bool:
        """Whether another batch would go beyond ``total_frames``."""
        return self.frames + self.frames_per_batch > self.total_frames

    def iterate(self) -> dict[str, float]:
        """Collect one batch and learn from it.

        Returns:
            What happened: frames, episodes, success, collisions, mean return and length of the episodes that ended
            (NaN when none did), level, and the losses.
        """
        batch = self._collect()
        self.frames += batch.numel()
        report = self._episodes(batch) | self._learn(batch)
        report["frames"] = self.frames
        return report

    def _collect(self) -> TensorDictBase:
        start = self.env.reset() if self.carried is None else self.carried
        with torch.no_grad():
            batch = self.env.rollout(
                self.frames_per_batch // self.env.numel(),
                self.model,
                auto_reset=False,
                tensordict=start,
                break_when_any_done=False,
            )
            self.carried = self.env.step_mdp(batch[:, -1].clone())  # the next rollout resets what is done
        return batch

    def _episodes(self, batch: TensorDictBase) -> dict[str, float]:
        ended = batch["next"][batch["next", "done"].squeeze(-1)]
        outcome = ended["outcome"]
        return {
            "episodes": len(ended),
            "success": (outcome == Outcome.GOAL).float().mean().item(),
            "collision": (outcome == Outcome.COLLISION).float().mean().item(),
            "return": ended["episode_return"].mean().item(),
            "length": ended["step_count"].float().mean().item(),
        }

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        batch["advantage"], batch["value_target"] = self._advantages(batch)
        used = ["image", "action", "action_log_prob", "advantage", "value_target", "state_value"]
        frames = batch.reshape(-1).select(*used)
        sums: dict[str, Tensor] = {}
        updates = 0
        self._anneal()
        for _ in range(self.loss.ppo_epochs):
            for rows in torch.randperm(len(frames), device=frames.device).split(self.loss.mini_batch_size):
                losses = self._update(frames[rows])
                sums = {key: sums.get(key, 0.0) + value for key, value in losses.items()}
                updates += 1
        return {key: (value / updates).item() for key, value in sums.items()}

    @torch.no_grad()
    def _advantages(self, batch: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Generalised advantages and value targets, [B, T, 1] each.

        The value of the next observation is the next column's own; only where the rollout ends, or was truncated and
        so goes on from a new start, the critic is asked again.
        """
        value, after = batch["state_value"], batch["next"]
        next_value = torch.cat([value[:, 1:], value[:, -1:]], 1)
        asked = after["truncated"].squeeze(-1).clone()
        asked[:, -1] = True
        next_value[asked] = self.model.get_value_operator()(after.select("pixels")[asked])["state_value"]
        return vec_generalized_advantage_estimate(
            self.loss.gamma,
            self.loss.gae_lambda,
            value,
            next_value,
            after["reward"] * self.loss.reward_scale,
            after["done"],
            after["terminated"],
        )

    def _anneal(self) -> None:
        left = max(1.0 - (self.frames - self.frames_per_batch) / self.total_frames, 0.0)
        if self.optim.anneal_lr:
            for group in self.optimizer.param_groups:
                group["lr"] = self.optim.lr * left
        if self.loss.anneal_entropy:
            self.objective.entropy_coeff.fill_(self.loss.entropy_coeff * left)

    def _update(self, frames: TensorDictBase) -> dict[str, Tensor]:
        frames = self.trunk(frames)  # once; both heads read its output
        losses = self.objective(frames)
        total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        self.optimizer.zero_grad()
        total.backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), self.optim.max_grad_norm)
        self.optimizer.step()
        keys = ("loss_objective", "loss_critic", "entropy", "kl_approx", "clip_fraction")
        return {key: losses[key].detach() for key in keys}

    def state_dict(self) -> dict[str, Any]:
        """All that the rest of the training depends on, as tensors and plain values."""
        return {
            "frames": self.frames,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "env": self.env.state_dict(),
            "carried": None if self.carried is None else self.carried.to_dict(),
            "torch_rng": torch.get_rng_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a ``state_dict()`` of the same configuration."""
        self.frames = state["frames"]
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.env.load_state_dict(state["env"])
        carried = state["carried"]
        self.carried = None if carried is None else self.env.fake_tensordict().empty().update(carried)
        torch.set_rng_state(state["torch_rng"].cpu())
