"""Episodes from given starts, and their statistics."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from splatrl.envs.tasks import Outcome
from splatrl.envs.world import World, Worlds


@dataclass(frozen=True)
class Episodes:
    """N finished episodes, in the order of their starts.

    Attributes:
        start: [N, D] states.
        outcome: [N] int64, each an ``Outcome``.
        length: [N] int64, steps.
        episode_return: [N] float32.
        goals: [N] int64, reached in the episode.
        success: [N] bool, whether they were enough for the task.
        scene: [N] int64, the scene of each; None in an env of one.
    """

    start: Tensor
    outcome: Tensor
    length: Tensor
    episode_return: Tensor
    goals: Tensor
    success: Tensor
    scene: Tensor | None = None

    def of(self, scene: int) -> "Episodes":
        """Those of one scene."""
        if self.scene is None:
            return self
        mine = self.scene == scene
        return Episodes(*(getattr(self, field.name)[mine] for field in fields(self)))

    def rate(self, outcome: Outcome) -> float:
        """Share of the episodes that ended with an outcome."""
        return (self.outcome == outcome).double().mean().item()

    def spl(self, shortest: Tensor) -> float:
        """Success weighted by path length (Anderson et al. 2018, eq. 1).

        Args:
            shortest: [N] int64, steps of the shortest path from each start.
        """
        ratio = shortest.double() / torch.maximum(shortest, self.length).double()
        return (self.success * ratio).mean().item()


def spread(rows: Tensor, most: int) -> Tensor:
    """An evenly spaced subset of the rows of a start set: [N] -> [min(N, most)]."""
    count = min(most, len(rows))
    return rows[torch.linspace(0, len(rows) - 1, count, dtype=torch.float64).round().long()]


class Chosen(NamedTuple):
    """N starts of a world.

    Attributes:
        state: [N, D].
        scene: [N] int64, the scene of each; None in a world of one.
        distance: [N] int64, steps of the shortest path from each.
    """

    state: Tensor
    scene: Tensor | None
    distance: Tensor

    def repeated(self, times: int) -> "Chosen":
        """Each of them some times in a row."""
        state, scene, distance = self
        scene = None if scene is None else scene.repeat_interleave(times)
        return Chosen(state.repeat_interleave(times, 0), scene, distance.repeat_interleave(times))


def spread_starts(world: World | Worlds, most: int) -> Chosen:
    """Starts evenly spaced over the start set, or over that of each scene, which has an equal share of them."""
    plans = [one.plan for one in world.worlds]
    rows = [spread(plan.start_rows, max(1, most // len(plans))) for plan in plans]
    scene = torch.arange(len(plans)).repeat_interleave(torch.tensor([len(own) for own in rows]))
    states = torch.cat([plan.states[own] for plan, own in zip(plans, rows, strict=True)])
    distance = torch.cat([plan.distance[own] for plan, own in zip(plans, rows, strict=True)])
    return Chosen(states, scene if len(plans) > 1 else None, distance)


@contextmanager
def acting(sampled: bool, seed: int, device: torch.device | None = None) -> Iterator[None]:
    """A block in which policies act, either by sampling from ``seed`` or by their mode.

    It tracks no gradients and restores PyTorch's global generators, of the CPU and of this device, at its end.
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
) -> Episodes:
    """Run one episode from each start; PyTorch's global generator is left as it was.

    A robot whose episode ends takes the next waiting start, so the batch stays full.

    Args:
        env: takes ``reset(set_state=True)``; these episodes do not advance its curriculum.
        policy: reads ``pixels``, writes ``action``.
        starts: [N, D] states.
        sampled: whether to sample from the policy's distribution or take its mode.
        seed: seed of the sampling.
        progress: called with the number of episodes that just ended.
        scene: [N] int64, the scene of each start, for an env of several.
    """
    count, rows = len(starts), env.numel()
    kept = {
        "outcome": torch.int64,
        "step_count": torch.int64,
        "episode_return": torch.float32,
        "goals": torch.int64,
        "success": torch.bool,
    }
    columns = {key: torch.zeros(count, dtype=dtype) for key, dtype in kept.items()}
    episode = torch.arange(rows)  # the episode of each robot; from count on the robot is idle
    waiting = rows
    with acting(sampled, seed, env.device):
        given = {"state": starts} if scene is None else {"state": starts, "scene": scene.unsqueeze(1)}
        first = {key: value[episode.clamp_max(count - 1)] for key, value in given.items()}
        td = env.reset(TensorDict(first, batch_size=[rows], device=env.device), set_state=True)
        while (episode < count).any():
            td = env.step(policy(td))
            after = td["next"]
            ended = (after["done"].squeeze(1).cpu() & (episode < count)).nonzero().squeeze(1)
            for key, column in columns.items():
                column[episode[ended]] = after[key].squeeze(1)[ended].cpu()
            progress(len(ended))
            done = after["done"].squeeze(1).cpu().nonzero().squeeze(1)
            episode[done] = torch.arange(waiting, waiting + len(done))
            waiting += len(done)
            td = env.step_mdp(td)
            if len(done):
                for key, value in given.items():
                    fresh = value[episode[done].clamp_max(count - 1)].to(env.device)
                    td[key] = td[key].index_put((done.to(env.device),), fresh)
                td["_reset"] = after["done"].clone()
                td = env.reset(td, set_state=True)
    outcome, length, episode_return, goals, success = columns.values()
    return Episodes(starts, outcome, length, episode_return, goals, success, scene)
