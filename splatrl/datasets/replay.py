"""Replaying demonstrations: states and actions must be reproduced byte for byte."""

from collections.abc import Callable

import torch
from tensordict import TensorDict

from splatrl.datasets.demonstrations import AFTER, Demonstrations
from splatrl.envs.world import World

ROBOTS = 32


@torch.no_grad()
def replay(
    world: World, demonstrations: Demonstrations, progress: Callable[[int], object] = lambda frames: None
) -> tuple[list[str], int]:
    """Start each episode from its recorded state, repeat its actions, and compare the results with the recording.

    Args:
        world: the world in which the demonstrations were recorded.
        demonstrations: the demonstrations to replay.
        progress: called with the number of frames just replayed.

    Returns:
        The differences, one line for each key that differs (``pixels`` excluded), and the number of views that are
        identical byte for byte; views may differ, because the noise of camera poses and images is drawn anew.

    Raises:
        ValueError: for states or actions that do not exist in the world.
    """
    frames, starts, lengths = demonstrations.frames, demonstrations.starts, demonstrations.lengths
    env = world.env(min(ROBOTS, len(starts)))
    told_keys = ["state", *(key for key in world.told if key in frames.keys())]  # noqa: SIM118, it is no dict
    _check(world, demonstrations)
    different: dict[str, int] = {}
    equal = 0
    for rows in torch.arange(len(starts)).split(env.numel()):
        begin = starts[rows].repeat(env.numel())[: env.numel()]  # spare robots rerun one, unchecked
        length = torch.cat([lengths[rows], torch.zeros(env.numel() - len(rows), dtype=torch.int64)])
        given = frames[begin].select(*told_keys)
        now = env.reset(TensorDict(given.to_dict(), [env.numel()], device=env.device), set_state=True)
        for step in range(int(length.max())):
            here = (step < length).nonzero().squeeze(1)
            written = frames[torch.minimum(begin + step, torch.tensor(len(frames) - 1))]
            now["action"] = written["action"].to(env.device)
            taken = env.step(now)
            seen, told = taken.cpu()[here], written[here]
            for key in (*told_keys, *(("next", name) for name in AFTER)):
                wrong = (seen[key] != told[key]).flatten(1).any(1) if seen[key].ndim > 1 else seen[key] != told[key]
                name = key if isinstance(key, str) else ".".join(key)
                different[name] = different.get(name, 0) + int(wrong.sum())
            equal += int((seen["pixels"][..., -3:] == told["pixels"]).flatten(1).all(1).sum())
            now = env.step_mdp(taken)
            progress(len(here))
    return [f"{name}: differs in {count:,} frames" for name, count in different.items() if count], equal


def _check(world: World, demonstrations: Demonstrations) -> None:
    """Refuse actions that do not exist in the world; states are checked when an env is reset to them."""
    spec, action = world.task.motion.action_spec, demonstrations.frames["action"]
    many = spec.expand(len(action), *spec.shape)
    if action.dtype != spec.dtype or action.shape != many.shape or not many.to(action.device).is_in(action):
        raise ValueError(f"demos: expected valid actions of the task ({spec.dtype} {list(spec.shape)}), got others")
