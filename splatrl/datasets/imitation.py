"""Imitation learning: clone demonstrations, then learn from a teacher in states that the policy visits (DAgger)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import one_hot
from torchrl.envs import EnvBase

from splatrl.array_files import read_arrays
from splatrl.curriculum import Curriculum
from splatrl.datasets.demonstrations import Demonstrations
from splatrl.datasets.recorder import check_single_steps
from splatrl.envs.nesting import set_state, state_of
from splatrl.envs.world import World, Worlds
from splatrl.files import replacing
from splatrl.training import PPO, Cloner, DaggerSettings, targets, visited
from splatrl.training.device_memory import with_room


class Imitation:
    """A stage of a training in which the policy learns by imitation, lesson by lesson, and which can be continued.

    The first lesson is to clone the demonstrations, if there are any; then each DAgger round is one, and any final
    epochs are the last. Demonstrated frames and frames in which the policy acts both count towards the frame budget.

    Args:
        ppo: holds the policy, the critic and the frame count.
        cloner: fits the policy, each time to all frames gathered so far.
        world: the world in which the policy acts, and whose task's teacher, or else planner, labels its states.
        shown: returns the demonstration sets to clone first; None begins DAgger with the untrained policy.
        dagger: settings of the DAgger rounds, whose episodes begin at any start in reach (``Plan.in_reach``).
        seed: seed of the starts of these episodes.
        folder: folder for a file of each lesson's frames, made if necessary, without which a ``state_dict()`` is of no
            use; None keeps none.

    Attributes:
        paused: called between the passes of a lesson, where ``state_dict()`` holds what has been learned.
    """

    def __init__(
        self,
        ppo: PPO,
        cloner: Cloner,
        world: World | Worlds,
        shown: Callable[[], Sequence[Demonstrations]] | None,
        dagger: DaggerSettings,
        seed: int,
        folder: Path | None = None,
    ):
        self.ppo, self.cloner, self.world, self.shown, self.dagger = ppo, cloner, world, shown, dagger
        self.seed, self.folder = seed, folder
        self.paused: Callable[[], object] = lambda: None
        self._lesson = self._epoch = 0  # lessons, and passes of the next one, that are done
        self._count = 0  # new frames of that one
        self._left: Mapping[str, Any] | None = None
        self._env: EnvBase | None = None

    def __call__(self) -> Iterator[dict[str, float]]:
        """Yield the loss after each lesson that is not done yet.

        Raises:
            FileNotFoundError: if frames to continue with are not there.
            OSError: if frames cannot be written.
            ValueError: for demonstrations that do not fit the policy, a task without a teacher, or a need for more
                frames than ``collector.total_frames``.
        """
        check_imitation(self.world, self.dagger)
        if self._lesson or self._epoch:
            self._check_left()
        elif self.shown is None:
            self._check_taught(0)
        lessons, known, row = self._lessons(), self._kept(), dict[str, float]()
        for number in range(self._lesson, len(lessons)):
            find, epochs = lessons[number]
            if self._epoch == 0:
                new = find()
                self._count = len(new.get("frame", ()))
                if new:
                    self._keep(number, new)
                    known = _together([known, new] if known else [new], self.ppo.device)
                del new
            for loss in self.cloner.passes(known, epochs, self._count == 0, min(self._epoch, epochs - 1)):
                row = {"loss_cloning": loss}
                self._epoch += 1
                if self._epoch < epochs:
                    self.paused()
            self.ppo.frames += self._count
            self._lesson, self._epoch = number + 1, 0
            yield row

    def state_dict(self) -> dict[str, Any]:
        """Return what the rest of the imitation depends on, besides the state of PPO and the frames in the folder."""
        return {
            "lesson": self._lesson,
            "epoch": self._epoch,
            "count": self._count,
            "optimizer": self.cloner.optimizer.state_dict(),
            "env": (self._left or {}).get("env") if self._env is None else state_of(self._env),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a ``state_dict()`` of the same settings, and with the same folder."""
        self._lesson, self._epoch, self._count = (int(state[key]) for key in ("lesson", "epoch", "count"))
        self.cloner.optimizer.load_state_dict(state["optimizer"])
        self._left = state

    def _lessons(self) -> list[tuple[Callable[[], dict[str, Tensor]], int]]:
        """Return, for each lesson, what finds its new frames, if any, and the number of passes over all of them."""
        dagger = self.dagger
        cloned = [] if self.shown is None else [(self._demonstrated, self.cloner.settings.epochs)]
        rounds = [(partial(self._visited, number), dagger.epochs) for number in range(dagger.rounds)]
        return [*cloned, *rounds, *([(dict, dagger.last_epochs)] if dagger.last_epochs else [])]

    def _demonstrated(self) -> dict[str, Tensor]:
        assert self.shown is not None
        parts = [_frames(each, self.ppo, self.cloner.reads, self.world.repeats) for each in self.shown()]
        self._check_taught(sum(len(part["frame"]) for part in parts))
        return _together(parts, self.ppo.device)

    def _visited(self, number: int) -> dict[str, Tensor]:
        """Let the policy act for a round, in an env of its own, which goes on where an interrupted one was."""
        plans, dagger, ppo = [one.plan for one in self.world.worlds], self.dagger, self.ppo
        if self._env is None:
            curriculum = Curriculum([plan.in_reach for plan in plans], first=None)
            self._env = self.world.env(ppo.env.numel(), curriculum, self.seed)
            if self._left is not None and self._left["env"] is not None:
                set_state(self._env, self._left["env"])
        guided = 1.0 if number < dagger.shown_rounds else dagger.guided
        return visited(self._env, ppo.learner, plans, dagger.frames_per_round, self.cloner.reads, guided)

    def _check_left(self) -> None:
        """Refuse to continue with less than the frames that the lesson that has begun and further rounds need."""
        rounds = self.dagger.rounds - (self._lesson + (self._epoch > 0) - (self.shown is not None))
        needed = self.ppo.frames + (self._count if self._epoch else 0) + max(0, rounds) * self.dagger.frames_per_round
        if needed > self.ppo.total_frames:
            raise ValueError(
                f"collector.total_frames: expected at least {needed:,} to continue with imitation, after "
                f"{self.ppo.frames:,}, got {self.ppo.total_frames:,}"
            )

    def _check_taught(self, shown: int) -> None:
        check_taught(self.dagger, self.ppo.env.numel(), self.ppo.total_frames, shown, self.ppo.frames)

    def _keep(self, number: int, frames: Mapping[str, Tensor]) -> None:
        """Write the new frames of a lesson."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        arrays: Any = {key: value.cpu().numpy() for key, value in frames.items()}
        with replacing(self.folder / f"{number}.npz") as stream:
            np.savez(stream, **arrays)

    def _kept(self) -> dict[str, Tensor]:
        """Read the frames of the lessons that have begun, unless all are done."""
        begun = self._lesson + (1 if self._epoch and self._count else 0)
        if begun == 0 or self._lesson == len(self._lessons()):
            return {}
        assert self.folder is not None
        parts = [read_arrays(self.folder / f"{number}.npz") for number in range(begun)]
        return _together([{key: torch.from_numpy(part[key]) for key in part} for part in parts], self.ppo.device)


def _together(parts: Sequence[dict[str, Tensor]], device: torch.device) -> dict[str, Tensor]:
    """Concatenate frames on a device ``with_room``; the caller can then free the parts, which fill the memory."""
    device = with_room(device, sum(value.nbytes for part in parts for value in part.values()))
    return {key: torch.cat([part[key].to(device) for part in parts]) for key in (parts[0] if parts else ())}


def check_imitation(world: World | Worlds, dagger: DaggerSettings, asked: int = 0) -> None:
    """Refuse an imitation of teachers that a task does not have.

    Args:
        world: the world in which the policy acts.
        dagger: settings of the DAgger rounds.
        asked: number of episodes that are to be recorded and cloned.

    Raises:
        ValueError: for a task without the planner's paths or a teacher, or a teacher whose actions are repeated.
    """
    name = type(world.task).__name__
    for key, others, number in (("demos", "null or a folder", asked), ("dagger.rounds", "0", dagger.rounds)):
        if number and world.worlds[0].task.teaches:
            check_single_steps(world.worlds[0].task, world.worlds[0].repeats, key)
        elif number and not world.planned:
            raise ValueError(
                f"{key}: expected {others} for a task with neither goal states nor a teacher ({name}), got {number}"
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
            f"got {found[0][1]} × {found[0][0]} and {theirs}; type task, robot and scene as they were recorded, "
            "which config.yaml in the folder of the demonstrations says"
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
