"""Recording demonstrations: the planner, or a task's own teacher, drives robots, and what succeeds is kept."""

from collections.abc import Callable, Iterator, Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import one_hot
from torchrl.envs import EnvBase

from splatrl.curriculum import Curriculum
from splatrl.datasets.demonstrations import AFTER, FASTEST, Demonstrations, joined
from splatrl.envs.tasks.base import Outcome, Task
from splatrl.envs.world import World
from splatrl.evaluation.rollouts import knowing
from splatrl.values import require_number

ROBOTS = 32
TRIES = 4
"""Episodes tried per requested one: off a lattice, a path along an obstacle may run into it, and teachers may fail."""

Act = Callable[[TensorDictBase], TensorDictBase]
"""Writes ``action``, and whatever is to be stored beside it, into the TensorDict of a batch of robots."""
Progress = Callable[[int], object]


def check_single_steps(task: Task, repeats: int, asking: str) -> None:
    """Refuse a task's own teacher where actions are repeated.

    Args:
        task: the task.
        repeats: number of times that a robot carries out each action.
        asking: the setting that asks for the teacher, for the message.

    Raises:
        ValueError: names the setting and what to type.
    """
    if repeats > 1:
        raise ValueError(
            f"{asking}: expected transforms/skip=none, since the teacher of {type(task).__name__} chooses single "
            f"steps, got actions of {repeats} steps"
        )


def planner_episodes(
    world: World, episodes: int, seed: int = 0, progress: Progress = lambda episodes: None
) -> Demonstrations:
    """Record episodes in which the robot follows a shortest path to the goal.

    Starts are drawn from all that an episode is long enough for, without repetition until these have been used. Where
    several actions begin a shortest path, one of them is chosen at random. Only episodes that reach the goal are kept.

    Args:
        world: scene and task; its camera noise and appearance apply, but stacked views are stored as single ones.
        episodes: number of episodes.
        seed: seed of starts and random choices.
        progress: called with 1 as each of the episodes that are kept ends.

    Raises:
        ValueError: for a task whose episodes do not end at goal states, or whose goal the planner does not reach often
            enough.
    """
    require_number("episodes", episodes, 1, 10**6, whole=True)
    plan = world.plan
    if not world.planned:
        raise ValueError(f"planner: expected a task whose episodes end at goal states, got {type(world.task).__name__}")
    generator, env = torch.Generator().manual_seed(seed), world.env(ROBOTS, seed=seed)
    begins = _spread(plan.in_reach.starts, generator)

    def begin() -> TensorDictBase:
        states = world.task.motion.varied(next(begins), generator)
        return env.reset(TensorDict({"state": states}, [ROBOTS], device=env.device), set_state=True)

    kept, failed = _successes(world, env, begin, _shortest(world, generator), episodes, progress)
    if len(kept) == episodes:
        return demonstrations_of(world, kept)
    unseen = sum(bool(plan.at_goal(one["state"]).any()) for one in failed)
    judged = f"; {unseen:,} stood where paths end, but the task did not find the goal in view" if unseen else ""
    tried = len(kept) + len(failed)
    raise ValueError(
        f"planner: expected {episodes} episodes that reach the goal, got only {len(kept)} of {tried:,}{judged}"
    )


def teacher_episodes(
    world: World, episodes: int, seed: int = 0, progress: Progress = lambda episodes: None
) -> Demonstrations:
    """Record episodes in which the task's own teacher acts, the one that labels states in DAgger.

    Starts, goals and whatever else an episode has are drawn as in a training without curriculum. Only successful
    episodes are kept.

    Args:
        world: scene and task; its camera noise and appearance apply, but stacked views are stored as single ones.
        episodes: number of episodes.
        seed: seed of everything that is drawn.
        progress: called with 1 as each of the episodes that are kept ends.

    Raises:
        ValueError: for a task without a teacher, one whose actions would be repeated, or one that fails too often.
    """
    require_number("episodes", episodes, 1, 10**6, whole=True)
    name = type(world.task).__name__
    if not world.task.teaches:
        raise ValueError(f"teacher: expected a task with a teacher of its own, got {name}")
    check_single_steps(world.task, world.repeats, "teacher")
    env = world.env(ROBOTS, Curriculum([world.plan.in_reach], first=None), seed)
    kept, failed = _successes(world, env, env.reset, knowing(env, env.task.teach), episodes, progress)
    if len(kept) == episodes:
        return demonstrations_of(world, kept)
    ends = [Outcome(int(one["next", "outcome"][-1])).name.lower() for one in failed]
    counts = ", ".join(f"{ends.count(end):,} in {end}" for end in sorted(set(ends), key=ends.count, reverse=True))
    raise ValueError(
        f"teacher: expected {episodes} episodes in which the teacher of {name} succeeds, got only {len(kept)} of "
        f"{len(kept) + len(failed):,}; the others ended {counts}"
    )


def demonstrations_of(world: World, episodes: list[TensorDictBase]) -> Demonstrations:
    """Return episodes that were recorded in a world, frames [T] each, as demonstrations."""
    motion, repeats = world.task.motion, world.repeats
    seconds = motion.seconds_per_step
    fps = Demonstrations.fps if seconds is None else min(max(1, round(1.0 / (seconds * repeats))), FASTEST)
    return Demonstrations(joined(episodes), tuple(motion.action_names), fps, repeats, world.digest)


def _spread(starts: Tensor, generator: torch.Generator) -> Iterator[Tensor]:
    """Yield start states for the robots, [ROBOTS, D], none of them again before all have been used."""
    waiting = starts[:0]
    while True:
        while len(waiting) < ROBOTS:
            waiting = torch.cat([waiting, starts[torch.randperm(len(starts), generator=generator)]])
        yield waiting[:ROBOTS]
        waiting = waiting[ROBOTS:]


def _shortest(world: World, generator: torch.Generator) -> Act:
    """Let robots follow shortest paths, or act at random where none exists."""
    plan, names = world.plan, world.task.motion.action_names

    def act(now: TensorDictBase) -> TensorDictBase:
        best = plan.optimal(now["state"].to(plan.states.device)).cpu()
        chosen = torch.multinomial(best.float() + 1e-9, 1, generator=generator).squeeze(1)
        now["action"] = plan.actions.cpu()[chosen].to(now.device)
        if names:
            now["optimal"] = best.float() @ one_hot(plan.actions.cpu(), len(names)).float() > 0
        return now

    return act


def _successes(
    world: World, env: EnvBase, begin: Callable[[], TensorDictBase], act: Act, episodes: int, progress: Progress
) -> tuple[list[TensorDictBase], list[TensorDictBase]]:
    """Run batches of episodes until enough of them have succeeded, or too many have been tried.

    Which ones are kept does not depend on how long they are: a batch always runs to its end.

    Returns:
        The first ``episodes`` that succeeded, frames [T] each; and those that did not, of which only ``state`` and
        ``outcome`` are left.
    """
    kept: list[TensorDictBase] = []
    failed: list[TensorDictBase] = []
    for _ in range(TRIES * (1 + episodes // ROBOTS)):
        for episode in _acted(env, begin(), act, world.told, episodes - len(kept), progress):
            if not episode["next", "success"][-1]:
                failed.append(episode.select("state", ("next", "outcome")))
            elif len(kept) < episodes:
                kept.append(episode)
        if len(kept) == episodes:
            break
    return kept, failed


@torch.no_grad()
def _acted(
    env: EnvBase, now: TensorDictBase, act: Act, told: Sequence[str], needed: int, progress: Progress
) -> list[TensorDictBase]:
    """Run one episode of each robot; a robot whose episode has ended waits for the others.

    Args:
        env: the robots.
        now: [B], the beginning of their episodes.
        act: chooses their actions.
        told: see ``recorded``.
        needed: number of successes after which ``progress`` is no longer called.
        progress: called with 1 as an episode succeeds.

    Returns:
        The frames of each robot's episode, [T], on the CPU.
    """
    running, steps, robots = torch.arange(env.numel()), list[TensorDictBase](), list[Tensor]()
    while len(running):
        now = act(now)
        if len(running) < env.numel():
            stepping = torch.zeros(env.numel(), 1, dtype=torch.bool)
            stepping[running] = True
            now["_step"] = stepping.to(env.device)
        step = env.step(now)
        seen = recorded(step, told)[running]
        steps.append(seen)
        robots.append(running)
        ended = seen["next", "done"].squeeze(1)
        for _ in range(min(needed, int((ended & seen["next", "success"].squeeze(1)).sum()))):
            progress(1)
            needed -= 1
        running, now = running[~ended], env.step_mdp(step)
    frames, robot = TensorDict.cat(steps), torch.cat(robots)
    return [frames[robot == number] for number in range(env.numel())]


def recorded(step: TensorDictBase, told: Sequence[str]) -> TensorDictBase:
    """Select what demonstrations store of a step, on the CPU; of stacked views, only the last.

    Args:
        step: [B], as returned by ``env.step``.
        told: keys of sensor readings and memory; see ``World.told``.
    """
    seen = step.select("pixels", "action", "state", *told).cpu()
    if "optimal" in step.keys():  # noqa: SIM118, it is no dict
        seen["optimal"] = step["optimal"].cpu()
    seen["pixels"] = seen["pixels"][..., -3:].clone()
    seen["next"] = step["next"].select(*AFTER).cpu()
    return seen
