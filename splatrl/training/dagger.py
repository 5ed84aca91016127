"""Dataset aggregation (DAgger, Ross et al. 2011): the policy acts, and a teacher labels its states with right actions.

The teacher is the task's own, if it has one, or else the planner.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import one_hot
from torchrl.data import Categorical, TensorSpec
from torchrl.envs import EnvBase

from splatrl.curriculum import Plan
from splatrl.training.actor import Actor
from splatrl.training.collectors import HostCollector
from splatrl.training.learner import Learner
from splatrl.values import require_number
from splatrl.waits import Bar

TAUGHT = "taught"
"""Key of the action that the teacher would have taken in a frame."""


@dataclass(frozen=True)
class DaggerSettings:
    """Settings of DAgger.

    Attributes:
        rounds: number of times that the policy acts for a while and then learns from all frames so far; 0 is off.
        frames_per_round: frames in which it acts per round, a multiple of ``env.num_envs``.
        epochs: passes over all frames so far, per round.
        shown_rounds: number of rounds at the start in which the teacher acts in place of the policy.
        guided: fraction of the robots that the teacher drives in the other rounds, so that there are also frames from
            further along the way than the policy gets.
        last_epochs: passes over all frames after the last round, while the learning rate falls to zero.

    Raises:
        ValueError: if a value is out of range, or more rounds are shown than there are; the message names it.
    """

    rounds: int
    frames_per_round: int
    epochs: int
    shown_rounds: int = 0
    guided: float = 0.0
    last_epochs: int = 0

    def __post_init__(self) -> None:
        for name in ("rounds", "shown_rounds", "last_epochs"):
            require_number(f"dagger.{name}", getattr(self, name), 0, whole=True)
        require_number("dagger.guided", self.guided, 0.0, 1.0)
        for name in ("frames_per_round", "epochs"):
            require_number(f"dagger.{name}", getattr(self, name), 1, whole=True)
        if 0 < self.rounds < self.shown_rounds:
            raise ValueError(f"dagger.shown_rounds: expected at most rounds = {self.rounds}, got {self.shown_rounds}")


def visited(
    env: EnvBase,
    learner: Learner,
    plans: Sequence[Plan],
    frames: int,
    reads: Sequence[str] = ("pixels",),
    guided: float = 0.0,
) -> dict[str, Tensor]:
    """Let the policy act in new episodes, and label every state that it visits.

    Value targets are those of the actions that were taken, bootstrapped by the policy's critic as in PPO.

    Args:
        env: batched env of B robots.
        learner: holds the policy and its critic.
        plans: one for each of the env's scenes, which knows the actions that begin a shortest path.
        frames: N, a multiple of B.
        reads: keys that the policy reads.
        guided: fraction of the robots that the teacher drives in place of the policy.

    Returns:
        Frames as ``Cloner.fit`` takes them, one robot after another.
    """
    drives = torch.rand(env.numel()) < guided if guided else torch.zeros(env.numel(), dtype=torch.bool)
    acts = partial(_taught_actor, Actor(learner.model), env, plans, drives.to(env.device))
    with Bar(total=frames, desc="collect and label", unit="frame", leave=False) as bar:

        def actor(td: TensorDictBase) -> TensorDictBase:
            bar.update(env.numel())
            return acts(td)

        batch = HostCollector(env, actor, frames // env.numel()).collect()
    with torch.no_grad():
        _, value = learner.advantages(batch)
    rows = batch.flatten(0, 1)
    return {
        **{key: rows[key] for key in reads},
        "target": rows[TAUGHT].to(value.device),
        "value_target": value.flatten(),
        "frame": rows["step_count"].flatten(),
    }


def _taught_actor(
    actor: Callable[[TensorDictBase], TensorDictBase],
    env: EnvBase,
    plans: Sequence[Plan],
    drives: Tensor,
    td: TensorDictBase,
) -> TensorDictBase:
    """Let an actor act, and add the teacher's actions, which the robots [B] that it drives take where it knows one."""
    td = actor(td)
    target = _taught(td, env, plans).to(td["action"].device)
    td = td.set(TAUGHT, target)
    if not drives.any():
        return td
    knows = drives & ~target.isnan().any(1)
    if isinstance(env.action_spec, Categorical):
        target = torch.multinomial(torch.where(knows.unsqueeze(1), target, 1.0), 1).squeeze(1)
    chosen = knows if td["action"].ndim == 1 else knows.unsqueeze(1)
    return td.set("action", torch.where(chosen, target.to(td["action"].dtype), td["action"]))


def _taught(rows: TensorDictBase, env: EnvBase, plans: Sequence[Plan]) -> Tensor:
    """Return what the task's teacher, or else the planner, would have done in frames: [N, D]; see ``targets``."""
    task = env.task
    taught = task.teach(rows["state"], {key: rows[key] for key in task.memory_spec})
    if taught is None:
        return _planned(rows, plans, env.action_spec)
    if isinstance(env.action_spec, Categorical):
        return one_hot(taught, env.action_spec.space.n).float()
    return taught.to(env.action_spec.dtype)


def _planned(rows: TensorDictBase, plans: Sequence[Plan], spec: TensorSpec) -> Tensor:
    """Return what the planner would have done in frames: [N, D]; see ``targets``."""
    state, actions = rows["state"].to(plans[0].states.device), plans[0].actions
    optimal = torch.zeros(len(state), len(actions), dtype=torch.bool, device=state.device)
    scene = rows.get("scene", torch.zeros_like(rows["step_count"])).flatten().to(state.device)
    for number, plan in enumerate(plans):
        here = (scene == number).nonzero().squeeze(1)
        optimal[here] = plan.optimal(state[here])
    return targets(optimal, actions, spec)


def targets(optimal: Tensor, actions: Tensor, spec: TensorSpec) -> Tensor:
    """Make targets to imitate from the set of right actions in each frame; see ``imitation``.

    Args:
        optimal: [N, A] bool, whether each action is right.
        actions: [A, ...], the actions.
        spec: action spec of an env, batched or not.

    Returns:
        Equal probabilities of all right actions if actions are discrete, or else one of them, drawn at random: [N, D]
        float32; NaN where none is right.
    """
    known = optimal.any(1, keepdim=True)
    if isinstance(spec, Categorical):
        right = optimal.float() @ one_hot(actions, spec.space.n).float()
        return torch.where(known, right / right.sum(1, keepdim=True), torch.nan)
    drawn = torch.multinomial(optimal.float() + ~known, 1).squeeze(1)
    return torch.where(known, actions[drawn], torch.nan)
