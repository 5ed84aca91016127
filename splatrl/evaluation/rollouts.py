"""Runs episodes from given starts, and computes their statistics."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.envs.nesting import layers
from splatrl.envs.restart import restart_from
from splatrl.envs.tasks import Outcome
from splatrl.envs.tasks.base import Memory
from splatrl.envs.tasks.measures import path_measures

MEASURES = ("distance_to_goal", "start_distance", "path_length", "collisions")
"""Observations of navigation tasks from which their measures are computed."""
RESULTS = {
    "outcome": torch.int64,
    "step_count": torch.int64,
    "episode_return": torch.float32,
    "goals": torch.int64,
    "success": torch.bool,
}
"""What every env says at the end of an episode, in the order of the attributes of ``Episodes``."""


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

    def mishaps(self) -> dict[str, float]:
        """Compute the fractions of episodes with a collision, that left the bounds, and that ended by timeout.

        Where collisions do not end episodes but are counted, as in navigation tasks, ``collision_rate`` is the fraction
        of episodes with at least one.
        """
        ended = {"collision_rate": Outcome.COLLISION, "out_of_bounds_rate": Outcome.OUT_OF_BOUNDS}
        rates = {key: self.rate(outcome) for key, outcome in ended.items()}
        if "collisions" in self.measures:
            rates["collision_rate"] = (self.measures["collisions"] > 0).double().mean().item()
        return {**rates, "timeout_rate": self.rate(Outcome.TIMEOUT)}

    def navigation(self) -> dict[str, float]:
        """Compute navigation measures under Habitat's names, averaged over the episodes; empty for other tasks.

        ``success``: the fraction of episodes in which the robot stopped at its goal. ``spl`` and ``soft_spl``: see
        ``path_measures``. ``distance_to_goal``: distance at the end of the episode, metres. ``collisions``: their
        number. Distances to goals are geodesic.
        """
        if not self.measures:
            return {}
        means = {"success": self.success, **path_measures(self.success, self.measures)}
        means |= {key: self.measures[key] for key in ("distance_to_goal", "collisions")}
        return {key: values.double().mean().item() for key, values in means.items()}

    def step_spl(self, shortest: Tensor) -> float:
        """Compute success weighted by path length (Anderson et al. 2018, eq. 1), with lengths in steps.

        Args:
            shortest: [N] int64, length of the shortest path from each start, steps.
        """
        ratio = shortest.double() / torch.maximum(shortest, self.length).double()
        return (self.success * ratio).mean().item()


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
    progress: Callable[[int], object] = lambda episodes: None,
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
        progress: called with how many more episodes' worth of steps are done. Running ones count in part, by the share
            of their steps, since those of a batch may all end together; in the end all are counted.
        scene: [N] int64, index of each start's scene, for an env with several.
        memory: the task's memory at each start, [N, ...] by key, such as goals; None draws it.
    """
    count, rows = len(starts), env.numel()
    columns = {key: torch.zeros(count, dtype=dtype) for key, dtype in _results(env).items()}
    episode = torch.arange(rows)  # the episode of each robot; an index of count or more means idle
    waiting, over, counted, limit = rows, 0, 0, layers(env)[0].task.max_steps
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
            # The host waits for a GPU once per step; a double holds each of these values exactly.
            told = torch.stack([after[key].squeeze(1).double() for key in ("done", *columns)]).cpu()
            ended = ((told[0] > 0) & acts).nonzero().squeeze(1)
            for column, values in zip(columns.values(), told[1:], strict=True):
                column[episode[ended]] = values[ended].to(column.dtype)
            over += len(ended)
            done = over + int((told[2] * (acts & (told[0] == 0))).sum() / limit)  # told[2] is step_count
            progress(done - counted)
            counted = done
            episode[ended] = torch.arange(waiting, waiting + len(ended))
            waiting += len(ended)
            begins = ended[episode[ended] < count]
            td = env.step_mdp(td)
            if len(begins):
                anew = {key: value[episode[begins]].to(env.device) for key, value in given.items()}
                td = restart_from(env, td, begins.to(env.device), anew)
    outcome, length, episode_return, goals, success = (columns.pop(key) for key in RESULTS)
    return Episodes(starts, outcome, length, episode_return, goals, success, scene, measures=columns)


def _results(env: EnvBase) -> dict[str, torch.dtype]:
    """Return what is kept of the end of an episode, by key: ``RESULTS``, and those of ``MEASURES`` that the env has."""
    specs = env.observation_spec
    return RESULTS | {key: specs[key].dtype for key in MEASURES if key in specs.keys()}  # noqa: SIM118, no dict


def _begun(env: EnvBase, given: Mapping[str, Tensor], count: int) -> dict[str, Tensor]:
    """Draw the initial memory of task and sensors for all episodes, for keys missing in ``given``: [N, ...] by key."""
    base, rows = layers(env)[0], env.numel()
    keys = [key for key in base.remembered if key not in given]
    found: dict[str, list[Tensor]] = {key: [] for key in keys}
    for first in range(0, count if keys else 0, rows):
        some = torch.arange(first, first + rows).clamp_max(count - 1)
        asked = TensorDict({key: value[some] for key, value in given.items()}, [rows], device=env.device)
        td = base.reset(asked, set_state=True)
        for key in keys:
            found[key].append(td[key].cpu())
    return {key: torch.cat(parts)[:count] for key, parts in found.items()}
