"""Runs episodes from given starts, and computes their statistics."""

import copy
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import NamedTuple, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.envs.nesting import layers
from splatrl.envs.restart import restart_from
from splatrl.envs.tasks import NavigationTask, Outcome
from splatrl.envs.tasks.base import ChoosingTask, Memory
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.episode_sets import places_of, read_episodes, write_episodes

MEASURES = ("distance_to_goal", "start_distance", "path_length", "collisions")
"""Observations of navigation tasks from which their measures are computed."""
EPISODES_SEED = 3000
"""Seed of the starts and goals drawn for tests; each scene adds its index."""


@dataclass(frozen=True)
class Episodes:
    """N finished episodes, in the order of their starts.

    Attributes:
        start: [N, D] states.
        outcome: [N] int64, each an ``Outcome``.
        length: [N] int64, steps.
        episode_return: [N] float32.
        goals: [N] int64, number of goals reached.
        success: [N] bool, whether that number was enough for the task.
        scene: [N] int64, index of the scene; None in an env with one scene.
        measures: navigation measures by name, [N] each: ``distance_to_goal``, ``start_distance`` and ``path_length`` in
            metres, and ``collisions``; empty for other tasks.
    """

    start: Tensor
    outcome: Tensor
    length: Tensor
    episode_return: Tensor
    goals: Tensor
    success: Tensor
    scene: Tensor | None = None
    measures: Mapping[str, Tensor] = field(default_factory=dict)

    def of(self, scene: int) -> "Episodes":
        """Return the episodes of one scene."""
        if self.scene is None:
            return self
        mine = self.scene == scene
        columns = {each.name: getattr(self, each.name)[mine] for each in fields(self) if each.name != "measures"}
        return replace(self, **columns, measures={key: value[mine] for key, value in self.measures.items()})

    def rate(self, outcome: Outcome) -> float:
        """Return the fraction of episodes that ended with an outcome."""
        return (self.outcome == outcome).double().mean().item()

    def navigation(self) -> dict[str, float]:
        """Compute navigation measures under Habitat's names, averaged over the episodes; empty for other tasks.

        ``success``: the fraction of episodes in which the robot stopped at its goal. ``spl``: success weighted by path
        length (Anderson et al. 2018, eq. 1), that is start distance / max(start distance, path length), or 0 without
        success. ``soft_spl`` (Datta et al. 2020): the same with progress, the fraction of the start distance by which
        the robot came nearer, in place of success. ``distance_to_goal``: distance at the end of the episode, metres.
        ``collisions``: their number. Distances to goals are geodesic.
        """
        if not self.measures:
            return {}
        far, start, path = (self.measures[key].double() for key in MEASURES[:3])
        ratio = start / torch.maximum(start, path).clamp_min(1e-9)
        progress = (1.0 - far / start.clamp_min(1e-9)).clamp_min(0.0)
        means = {"success": self.success.double(), "spl": self.success * ratio, "soft_spl": progress * ratio}
        means |= {"distance_to_goal": far, "collisions": self.measures["collisions"].double()}
        return {key: values.mean().item() for key, values in means.items()}

    def step_spl(self, shortest: Tensor) -> float:
        """Compute success weighted by path length (Anderson et al. 2018, eq. 1), with lengths in steps.

        Args:
            shortest: [N] int64, length of the shortest path from each start, steps.
        """
        ratio = shortest.double() / torch.maximum(shortest, self.length).double()
        return (self.success * ratio).mean().item()


def spread(rows: Tensor, most: int) -> Tensor:
    """Return an evenly spaced subset of the rows of a start set: [N] -> [min(N, most)]."""
    count = min(most, len(rows))
    return rows[torch.linspace(0, len(rows) - 1, count, dtype=torch.float64).round().long()]


class Chosen(NamedTuple):
    """N chosen starts in a world.

    Attributes:
        state: [N, D] states.
        scene: [N] int64, index of the scene; None in a world with one scene.
        distance: [N] int64, length of the shortest path from each, steps; unused if each episode has its own goal.
        memory: the task's memory at each start, by key, for tasks whose episodes have goals of their own.
    """

    state: Tensor
    scene: Tensor | None
    distance: Tensor
    memory: Mapping[str, Tensor] = {}

    def repeated(self, times: int) -> "Chosen":
        """Repeat each start ``times`` times in a row."""
        scene = None if self.scene is None else self.scene.repeat_interleave(times, 0)
        memory = {key: value.repeat_interleave(times, 0) for key, value in self.memory.items()}
        return Chosen(self.state.repeat_interleave(times, 0), scene, self.distance.repeat_interleave(times, 0), memory)


def given_episodes(world: World | Worlds, path: Path) -> tuple[World | Worlds, Chosen]:
    """Read episodes from a file, and give the world a task that knows the shortest paths to their goals.

    Returns:
        The world with that task, and the starts of the episodes with the task's memory at each.

    Raises:
        ValueError: for a task whose episodes have no goals of their own, starts that are not free, or a file that
            ``read_episodes`` or ``Geodesics.with_goals`` refuses.
    """
    task = world.task
    if not isinstance(task, NavigationTask):
        raise ValueError(
            f"evaluation.episodes: expected a navigation task, such as task=pointnav, got {type(task).__name__}"
        )
    state, goal, scene = read_episodes(path, world.names)
    for number, (name, one) in enumerate(zip(world.names, world.worlds, strict=True)):
        mine = (scene == number).nonzero().squeeze(1)
        blocked = one.plan.checker.collides(one.task.motion.body_to_world(state[mine]))
        wrong = mine[blocked | ~one.task.motion.inside(state[mine])].tolist()
        if wrong:
            place = [round(value, 3) for value in state[wrong[0], :2].tolist()]
            raise ValueError(
                f"{path}: episode {wrong[0]}: expected a start where the robot fits, got {place} in scene {name}"
            )
    task = copy.copy(task)
    task._modules = dict(task._modules)
    try:
        task.geodesics, rows = task.geodesics.with_goals(places_of(goal), scene.numpy())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    memory = task.episode(state, rows, goal[:, 2:])
    chosen = Chosen(state, scene if len(world.worlds) > 1 else None, torch.zeros(len(state), dtype=torch.int64), memory)
    return replace(world, task=task, made_by=None), chosen


def save_episodes(path: Path, world: World | Worlds, chosen: Chosen, radius: float) -> None:
    """Write the episodes of a navigation task in the format that ``given_episodes`` reads.

    Args:
        path: file to write.
        world: world in which they take place.
        chosen: starts of the episodes, with the task's memory at each.
        radius: distance from the goal within which a stop is a success, metres.
    """
    numbers = [0] * len(chosen.state) if chosen.scene is None else chosen.scene.tolist()
    heights = torch.tensor([world.worlds[number].robot.height for number in numbers])
    write_episodes(path, chosen.state, chosen.memory, [world.names[number] for number in numbers], heights, radius)


def spread_starts(world: World | Worlds, most: int) -> Chosen:
    """Choose up to ``most`` starts, evenly spaced over the start set.

    With several scenes, each gets an equal number, at least one, spaced over its own start set. If each episode of the
    task has its own goal, starts and goals are drawn at random instead, with a fixed seed.
    """
    if world.task.chooses_episodes:
        return _drawn_episodes(world, most)
    plans = [one.plan for one in world.worlds]
    rows = [spread(plan.start_rows, max(1, most // len(plans))) for plan in plans]
    scene = torch.arange(len(plans)).repeat_interleave(torch.tensor([len(own) for own in rows]))
    states = torch.cat([plan.states[own] for plan, own in zip(plans, rows, strict=True)])
    distance = torch.cat([plan.distance[own] for plan, own in zip(plans, rows, strict=True)])
    return Chosen(states, scene if len(plans) > 1 else None, distance)


def _drawn_episodes(world: World | Worlds, most: int) -> Chosen:
    """Draw starts and goals for tests, equally many in each scene."""
    count = max(1, most // len(world.worlds))
    drawn: list[dict[str, Tensor]] = []
    for number, one in enumerate(world.worlds):
        task = cast(ChoosingTask, one.task)
        drawn.append(task.episodes(one.plan.starts.cpu(), count, EPISODES_SEED + number))
        if len(world.worlds) > 1:  # goals of all scenes are numbered consecutively
            assert isinstance(world.task, NavigationTask)
            drawn[-1]["goal_row"] = drawn[-1]["goal_row"] + world.task.geodesics.begins[number].cpu()
    episodes = {key: torch.cat([each[key] for each in drawn]) for key in drawn[0]}
    scene = torch.arange(len(drawn)).repeat_interleave(count)
    state = episodes.pop("state")
    return Chosen(state, scene if len(drawn) > 1 else None, torch.zeros(len(state), dtype=torch.int64), episodes)


def knowing(env: EnvBase, act: Callable[[Tensor, Memory], Tensor | None]) -> Callable[[TensorDictBase], TensorDictBase]:
    """Make a policy from a function of state and memory, such as a task's teacher.

    Args:
        env: env in which the policy acts.
        act: maps states [B, ...] and the task's memory to actions [B, ...], as ``Task.teach`` does.
    """
    keys, dtype = tuple(env.task.memory_spec), env.action_spec.dtype

    def policy(td: TensorDictBase) -> TensorDictBase:
        action = act(td["state"], {key: td[key] for key in keys})
        assert action is not None, "expected act to return actions, got None"
        return td.set("action", action.to(dtype))

    return policy


@contextmanager
def acting(sampled: bool, seed: int, device: torch.device | None = None) -> Iterator[None]:
    """Let policies act within the block, either by sampling, with a seed, or by their mode.

    No gradients are tracked, and PyTorch's global generators, of the CPU and of ``device``, are restored at the end.
    """
    devices = [device] if device is not None and device.type == "cuda" else []
    kind = ExplorationType.RANDOM if sampled else ExplorationType.DETERMINISTIC
    with torch.random.fork_rng(devices=devices), set_exploration_type(kind), torch.no_grad():
        torch.manual_seed(seed)
        yield


def run_episodes(
    env: EnvBase,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: Tensor,
    sampled: bool = True,
    seed: int = 0,
    progress: Callable[[int], object] = lambda finished: None,
    scene: Tensor | None = None,
    memory: Mapping[str, Tensor] | None = None,
) -> Episodes:
    """Run one episode from each start; PyTorch's global generator is left as it was.

    A robot whose episode ends takes the next waiting start, so the batch stays full; when no start is waiting, it
    idles while the others continue.

    Args:
        env: takes ``reset(set_state=True)``; these episodes do not advance its curriculum.
        policy: reads ``pixels``, writes ``action``.
        starts: [N, D] states.
        sampled: whether to sample from the policy's distribution or take its mode.
        seed: seed of the action sampling.
        progress: called with the number of episodes that just ended.
        scene: [N] int64, index of each start's scene, for an env with several.
        memory: the task's memory at each start, [N, ...] by key, such as goals; None draws it.
    """
    count, rows = len(starts), env.numel()
    kept = {
        "outcome": torch.int64,
        "step_count": torch.int64,
        "episode_return": torch.float32,
        "goals": torch.int64,
        "success": torch.bool,
    }
    specs = env.observation_spec
    measured = [key for key in MEASURES if key in specs.keys()]  # noqa: SIM118, a spec is not a dict
    kept |= {key: specs[key].dtype for key in measured}
    columns = {key: torch.zeros(count, dtype=dtype) for key, dtype in kept.items()}
    episode = torch.arange(rows)  # the episode of each robot; an index of count or more means idle
    waiting = rows
    with acting(sampled, seed, env.device):
        given = {"state": starts, **(memory or {})}
        if scene is not None:
            given["scene"] = scene.unsqueeze(1)
        given |= _begun(env, given, count)
        first = {key: value[episode.clamp_max(count - 1)] for key, value in given.items()}
        td = env.reset(TensorDict(first, batch_size=[rows], device=env.device), set_state=True)
        while (acts := episode < count).any():
            td = policy(td)
            if not acts.all():
                td["_step"] = acts.unsqueeze(1).to(env.device)
            td = env.step(td)
            after = td["next"]
            ended = (after["done"].squeeze(1).cpu() & acts).nonzero().squeeze(1)
            for key, column in columns.items():
                column[episode[ended]] = after[key].squeeze(1)[ended].cpu()
            progress(len(ended))
            episode[ended] = torch.arange(waiting, waiting + len(ended))
            waiting += len(ended)
            begins = ended[episode[ended] < count]
            td = env.step_mdp(td)
            if len(begins):
                anew = {key: value[episode[begins]].to(env.device) for key, value in given.items()}
                td = restart_from(env, td, begins.to(env.device), anew)
    measures = {key: columns.pop(key) for key in measured}
    outcome, length, episode_return, goals, success = columns.values()
    return Episodes(starts, outcome, length, episode_return, goals, success, scene, measures)


def _begun(env: EnvBase, given: Mapping[str, Tensor], count: int) -> dict[str, Tensor]:
    """Draw the initial memory of task and sensors for all episodes, for keys missing in ``given``: [N, ...] by key."""
    base, rows = layers(env)[0], env.numel()
    keys = [key for key in getattr(base, "remembered", ()) if key not in given]
    found: dict[str, list[Tensor]] = {key: [] for key in keys}
    for first in range(0, count if keys else 0, rows):
        some = torch.arange(first, first + rows).clamp_max(count - 1)
        asked = TensorDict({key: value[some] for key, value in given.items()}, [rows], device=env.device)
        td = base.reset(asked, set_state=True)
        for key in keys:
            found[key].append(td[key].cpu())
    return {key: torch.cat(parts)[:count] for key, parts in found.items()}
