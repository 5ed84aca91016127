"""Imitation learning: clone demonstrations, then learn from the planner in states that the policy visits (DAgger)."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from splatrl.curriculum import Curriculum
from splatrl.datasets.demonstrations import Demonstrations
from splatrl.envs.world import World, Worlds
from splatrl.training import PPO, Cloner, DaggerSettings, targets, visited
from splatrl.training.room import with_room


def imitate(
    ppo: PPO, cloner: Cloner, world: World | Worlds, shown: Sequence[Demonstrations], dagger: DaggerSettings, seed: int
) -> Iterator[dict[str, float]]:
    """Train a policy by imitation; demonstrated frames and frames in which it acts both count towards the frame budget.

    Args:
        ppo: holds the policy, the critic and the frame count.
        cloner: fits the policy, each time to all frames gathered so far.
        world: the world in which the policy acts and the planner plans.
        shown: demonstration sets to clone first; if empty, the first DAgger round starts from the untrained policy.
        dagger: settings of the DAgger rounds, whose episodes begin at any start in reach (``Plan.in_reach``).
        seed: seed of the starts of these episodes.

    Yields:
        The loss after cloning the demonstrations, after each DAgger round, and after any final epochs.

    Raises:
        ValueError: for demonstrations that do not fit the policy, a task without a teacher, or a need for more frames
            than ``collector.total_frames``.
    """
    known = _together([_frames(each, ppo, cloner.reads, world.repeats) for each in shown], ppo.device)
    check_imitation(world, dagger)
    frames = len(known.get("frame", ()))
    check_taught(dagger, ppo.env.numel(), ppo.total_frames, frames, ppo.frames)
    if known:
        ppo.frames += frames
        yield {"loss_cloning": cloner.fit(known)}
    plans = [one.plan for one in world.worlds]
    env = world.env(ppo.env.numel(), Curriculum([plan.in_reach for plan in plans], first=None), seed)
    for number in range(dagger.rounds):
        guided = 1.0 if number < dagger.shown_rounds else dagger.guided
        new = visited(env, ppo.learner, plans, dagger.frames_per_round, cloner.reads, guided)
        known = _together([known, new] if known else [new], ppo.device)
        ppo.frames += dagger.frames_per_round
        yield {"loss_cloning": cloner.fit(known, dagger.epochs)}
    if dagger.last_epochs:
        yield {"loss_cloning": cloner.fit(known, dagger.last_epochs, anneal=True)}


def _together(parts: Sequence[dict[str, Tensor]], device: torch.device) -> dict[str, Tensor]:
    """Concatenate frames on a device ``with_room``; the caller can then free the parts, which fill the memory."""
    device = with_room(device, sum(value.nbytes for part in parts for value in part.values()))
    return {key: torch.cat([part[key].to(device) for part in parts]) for key in (parts[0] if parts else ())}


def check_imitation(world: World | Worlds, dagger: DaggerSettings, walked: int = 0) -> None:
    """Refuse an imitation of teachers that a task does not have.

    Args:
        world: the world in which the policy acts.
        dagger: settings of the DAgger rounds.
        walked: number of the planner's episodes that are to be recorded and cloned.

    Raises:
        ValueError: for a task without the planner's paths or a teacher, or a teacher whose actions are repeated.
    """
    name, taught = type(world.task).__name__, bool(dagger.rounds) and _has_teacher(world)
    if walked and not world.planned:
        raise ValueError(f"demos: expected null or a folder for a task without goal states ({name}), got {walked}")
    if taught and world.repeats > 1:
        raise ValueError(
            f"dagger.rounds: expected 0 with transforms/skip, since the teacher of {name} chooses single steps, got "
            f"{dagger.rounds}; type transforms/skip=none"
        )
    if dagger.rounds and not world.planned and not taught:
        raise ValueError(
            f"dagger.rounds: expected 0 for a task with neither goal states nor a teacher ({name}), got {dagger.rounds}"
        )


def check_taught(dagger: DaggerSettings, num_envs: int, total_frames: int, shown: int, matched: int) -> None:
    """Refuse numbers of frames to be taught with that the robots cannot share evenly, or that exceed the frame budget.

    Args:
        dagger: settings of the DAgger rounds.
        num_envs: number of robots.
        total_frames: frames that the whole training may use.
        shown: number of demonstrated frames; 0 if they are not known yet.
        matched: number of frames that are used before, for matching.

    Raises:
        ValueError: for rounds or a matching that are no multiple of the batch, or a need for more frames than
            ``collector.total_frames``.
    """
    acted = dagger.rounds * dagger.frames_per_round
    a_round = dagger.frames_per_round if acted else 0
    for name, frames in (("dagger.frames_per_round", a_round), ("matching.frames", matched)):
        if frames % num_envs:
            raise ValueError(f"{name}: expected a multiple of env.num_envs = {num_envs}, got {frames}")
    if (needed := matched + shown + acted) > total_frames:
        of_matching = f"{matched:,} of matching.frames, " if matched else ""
        raise ValueError(
            f"collector.total_frames: expected at least {needed:,}, the sum of {of_matching}{shown:,} frames of demos "
            f"and {acted:,} frames of dagger.rounds, got {total_frames:,}"
        )


def _has_teacher(world: World | Worlds) -> bool:
    """Return whether the task has a teacher of its own."""
    one = world.worlds[0]
    memory = {key: spec.zero((1,)) for key, spec in one.task.memory_spec.items()}
    return one.task.teach(one.plan.starts[:1], memory) is not None


def _frames(shown: Demonstrations, ppo: PPO, reads: Sequence[str], repeats: int) -> dict[str, Tensor]:
    """Convert demonstrations to what ``Cloner.fit`` expects.

    Raises:
        ValueError: for demonstrations whose actions, repetitions of actions or images differ from the policy's, or that
            lack a key it reads.
    """
    if shown.repeats != repeats:
        raise ValueError(
            f"demos: expected each action to be carried out {_times(repeats)}, as in this training (transforms.skip), "
            f"got {_times(shown.repeats)}"
        )
    frames, env = shown.frames, ppo.env
    (height, width, channels), spec = env.observation_spec["pixels"].shape[1:], env.action_spec
    names, found = env.task.motion.action_names, (frames["pixels"].shape[1:3], frames["action"].shape[1:])
    if shown.action_names != tuple(names) or found != ((height, width), spec.shape[1:]):
        ours = ", ".join(names) or list(spec.shape[1:])
        theirs = ", ".join(shown.action_names) or list(found[1])
        raise ValueError(
            f"demos: expected images of {width} × {height} pixels and the task's actions {ours}, "
            f"got {found[0][1]} × {found[0][0]} and {theirs}"
        )
    seen = {key: shown.stacked(channels // 3) if key == "pixels" else frames.get(key, None) for key in reads}
    for key, values in seen.items():
        spec_of = env.observation_spec[key]
        if values is None or (values.shape[1:], values.dtype) != (spec_of.shape[1:], spec_of.dtype):
            got = "none" if values is None else f"{values.dtype} {list(values.shape[1:])}"
            raise ValueError(f"demos: expected {key} as {spec_of.dtype} {list(spec_of.shape[1:])} per frame, got {got}")
    target = frames["action"]
    if names:
        optimal = frames.get("optimal", None)
        optimal = one_hot(target, len(names)).bool() if optimal is None else optimal
        target = targets(optimal, torch.arange(len(names)), spec)
    return {
        **seen,
        "target": target,
        "value_target": shown.returns(ppo.learner.loss.gamma) * ppo.learner.loss.reward_scale,
        "frame": frames["frame"],
    }


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
