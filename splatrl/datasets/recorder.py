"""Recording demonstrations: the planner drives robots along shortest paths to the goal."""

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import one_hot

from splatrl.curriculum import Plan
from splatrl.datasets.demonstrations import AFTER, Demonstrations, joined
from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World
from splatrl.values import require_number

ROBOTS = 32
TRIES = 4
"""Starts tried per requested episode: off a lattice, a path along an obstacle may run into it."""


def planner_episodes(
    world: World, episodes: int, seed: int = 0, progress: Callable[[int], object] = lambda frames: None
) -> Demonstrations:
    """Record episodes in which the robot follows a shortest path to the goal.

    Starts are drawn from all that an episode is long enough for, without repetition until these have been used. Where
    several actions begin a shortest path, one of them is chosen at random. Only episodes that reach the goal are kept.

    Args:
        world: scene and task; its camera noise and appearance apply, but stacked views are stored as single ones.
        episodes: number of episodes.
        seed: seed of starts and random choices.
        progress: called for each episode that is kept, with its number of frames.

    Raises:
        ValueError: for a task whose episodes do not end at goal states, or whose goal the planner does not reach often
            enough.
    """
    require_number("episodes", episodes, 1, 10**6, whole=True)
    plan = world.plan
    if not world.planned:
        raise ValueError(f"planner: expected a task whose episodes end at goal states, got {type(world.task).__name__}")
    generator = torch.Generator().manual_seed(seed)
    kept: list[TensorDictBase] = []
    tried = unseen = 0
    waiting: list[Tensor] = []
    near = plan.in_reach.starts
    for _ in range(TRIES * (1 + episodes // ROBOTS)):
        while sum(map(len, waiting)) < ROBOTS:
            waiting.append(near[torch.randperm(len(near), generator=generator)])
        starts, rest = torch.cat(waiting).split([ROBOTS, sum(map(len, waiting)) - ROBOTS])
        waiting, starts = [rest], world.task.motion.varied(starts, generator)
        for episode in _walked(world, plan, starts, seed + len(kept), generator):
            tried += 1
            if int(episode["next", "outcome"][-1]) != Outcome.GOAL:
                unseen += bool(plan.at_goal(episode["state"]).any())
            elif len(kept) < episodes:
                kept.append(episode)
                progress(len(episode))
        if len(kept) == episodes:
            names = tuple(world.task.motion.action_names)
            return Demonstrations(joined(kept), names, repeats=world.repeats, scene=world.digest)
    judged = f"; {unseen:,} stood where paths end, but the task did not find the goal in view" if unseen else ""
    raise ValueError(
        f"planner: expected {episodes} episodes that reach the goal, got only {len(kept)} of {tried:,}{judged}"
    )


@torch.no_grad()
def _walked(world: World, plan: Plan, starts: Tensor, seed: int, generator: torch.Generator) -> list[TensorDictBase]:
    """Run one episode from each start along shortest paths, or at random where none exists: frames [T], on the CPU."""
    env, names, told = world.env(len(starts), seed=seed), world.task.motion.action_names, world.told
    now = env.reset(TensorDict({"state": starts}, [len(starts)], device=env.device), set_state=True)
    steps: list[TensorDictBase] = []
    length = torch.zeros(len(starts), dtype=torch.int64)  # frames of each ended episode
    running = torch.ones(len(starts), dtype=torch.bool)
    while running.any() and len(steps) < world.task.max_steps:
        best = plan.optimal(now["state"].to(plan.states.device)).cpu()
        chosen = torch.multinomial(best.float() + 1e-9, 1, generator=generator).squeeze(1)
        now["action"] = plan.actions.cpu()[chosen].to(env.device)
        step = env.step(now)
        seen = recorded(step, told)
        if names:
            seen["optimal"] = best.float() @ one_hot(plan.actions.cpu(), len(names)).float() > 0
        steps.append(seen)
        ended = running & seen["next", "done"].squeeze(1)
        length[ended] = len(steps)
        running &= ~ended
        now = env.step_mdp(step)
    whole = torch.stack(steps, 1)
    return [whole[row, :count] for row, count in enumerate(length.tolist()) if count]


def recorded(step: TensorDictBase, told: Sequence[str]) -> TensorDictBase:
    """Select what demonstrations store of a step, on the CPU; of stacked views, only the last.

    Args:
        step: [B], as returned by ``env.step``.
        told: keys of sensor readings and memory; see ``World.told``.
    """
    seen = step.select("pixels", "action", "state", *told).cpu()
    seen["pixels"] = seen["pixels"][..., -3:].clone()
    seen["next"] = step["next"].select(*AFTER).cpu()
    return seen
