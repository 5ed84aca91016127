"""Step-by-step recordings of episodes, for videos."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.envs.sensors.goals import ImageGoal
from splatrl.envs.tasks.base import Mark, Memory, Outcome
from splatrl.evaluation.rollouts import acting
from splatrl.renderers.parts import Parts


@dataclass(frozen=True)
class Recording:
    """One finished episode of T steps, including its start.

    Attributes:
        planar: [T + 1, 3] x and y in metres and yaw in radians.
        body_to_world: [T + 1, 4, 4] poses, metres.
        pixels: [T + 1, H, W, 3] uint8, the policy's view; of stacked frames only the latest.
        action: [T, ...] actions.
        episode_return: [T + 1] float32, return so far.
        outcome: how the episode ended.
        memory: the task's memory when each view was drawn, before it judged that step, [T + 1, ...] by key.
        parts: models that the task placed in the picture, with T + 1 rows; None is the scene alone.
        marks: the task's marks on a map in each of the T + 1 states; empty for a task without memory.
        goals: [T + 1] int64, goals reached so far, if episodes can have several; otherwise None.
        goal_image: [H, W, 3] uint8, the image of an image goal; None without one.
    """

    planar: Tensor
    body_to_world: Tensor
    pixels: Tensor
    action: Tensor
    episode_return: Tensor
    outcome: Outcome
    memory: Memory = field(default_factory=dict)
    parts: Parts | None = None
    marks: Sequence[list[Mark]] = ()
    goals: Tensor | None = None
    goal_image: Tensor | None = None

    @cached_property
    def named_marks(self) -> list[Mark]:
        """One mark for each name, in order of first appearance."""
        return list({mark.name: mark for marks in self.marks for mark in marks}.values())


def record_episodes(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: Tensor,
    seed: int = 0,
    memory: Memory | None = None,
    progress: Callable[[int], object] = lambda steps: None,
) -> list[Recording]:
    """Record one episode from each start, in one batch, with sampled actions; PyTorch's generator is left as it was.

    Args:
        env: env with as many robots as there are starts.
        policy: reads ``pixels``, writes ``action``.
        starts: [N, D] states.
        seed: seed of the action sampling.
        memory: the task's memory at each start, [N, ...] by key, such as goals; None draws it.
        progress: called with the number of steps that the batch has just taken.

    Raises:
        ValueError: for an env with another number of robots.
    """
    if env.numel() != len(starts):
        raise ValueError(f"env: expected one robot per start ({len(starts)}), got {env.numel()}")
    steps: list[TensorDictBase] = []
    with acting(sampled=True, seed=seed, device=env.device):
        given = TensorDict({"state": starts, **(memory or {})}, batch_size=env.batch_size, device=env.device)
        now = env.reset(given, set_state=True)
        running = torch.ones(len(starts), dtype=torch.bool)
        while running.any():  # finished robots continue but are not recorded
            step = env.step(policy(now))
            steps.append(step.cpu())
            running &= ~steps[-1]["next", "done"].squeeze(1)
            now = env.step_mdp(step)
            progress(1)
    return [_recording(env, [step[row] for step in steps]) for row in range(len(starts))]


def _recording(env: EnvBase, steps: list[TensorDictBase]) -> Recording:
    length = next(i for i, step in enumerate(steps, 1) if step["next", "done"])
    steps = steps[:length]
    states = [steps[0], *(step["next"] for step in steps)]
    keys = "state", "pixels", "episode_return"
    state, pixels, episode_return = (torch.stack([now[key] for now in states]) for key in keys)
    task, state = env.task, state.to(env.device)
    motion = task.motion
    memory = {key: torch.stack([now[key] for now in states]) for key in task.memory_spec}
    rows = [{key: value[row] for key, value in memory.items()} for row in range(len(states))] if memory else []
    drawn = {key: torch.cat([value[:1], value[:-1]]) for key, value in memory.items()}
    return Recording(
        planar=motion.planar(state).cpu(),
        body_to_world=motion.body_to_world(state).cpu(),
        pixels=pixels[..., -3:],
        action=torch.stack([step["action"] for step in steps]),
        episode_return=episode_return.squeeze(1),
        outcome=Outcome(int(steps[-1]["next", "outcome"])),
        memory=drawn,
        parts=task.parts(state, {key: value.to(env.device) for key, value in drawn.items()}),
        marks=[task.marks(row) for row in rows],
        goals=None if task.goals_for_success is None else torch.stack([now["goals"] for now in states]).squeeze(1),
        goal_image=states[0].get(ImageGoal.KEY, None),
    )
