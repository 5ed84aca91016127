"""Scoring of trained policies on labelled clips, and recording of clips in a world that training never saw."""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from splatrl.building import build_one_world
from splatrl.configuration import config_elsewhere, run_config
from splatrl.envs.world import World
from splatrl.evaluation.clip_files import film_images, read_clips
from splatrl.evaluation.clips import ClipResult, match
from splatrl.evaluation.film import draw_film
from splatrl.evaluation.policy_camera import Eye
from splatrl.evaluation.walk_looks import Lens
from splatrl.evaluation.walks import Hand, record_walks
from splatrl.experiments.experiment import Run
from splatrl.files import new_folder
from splatrl.runs import load_policy
from splatrl.waits import Bar


def altered(cfg: DictConfig, seed: int) -> DictConfig:
    """Alter the config of a run so that its scene looks as training never saw it.

    A generated scene gets different leaves and grass, and its small objects are moved. Every scene is rendered as
    classic 3DGS, without antialiasing, and with all its Gaussians.

    Args:
        cfg: config of the run.
        seed: seed of the alteration, from 0; each gives a different generated scene.
    """
    cfg = cfg.copy()
    for node, changes in (
        (cfg.scene, {"seed": cfg.scene.get("seed", 0) + 1000 + seed, "clutter": 1 + seed}),
        (cfg.renderer, {"antialiased": False, "tolerance": 0.0}),
    ):
        for key, value in changes.items():
            if key in node:
                node[key] = value
    return cfg


def record_clips(
    world: World,
    folder: Path,
    count: int = 12,
    seed: int = 0,
    height: int = 96,
    hand: Hand | None = None,
    lens: Lens | None = None,
) -> list[Path]:
    """Record walks in a world as clips, with a progress bar; see ``record_walks``."""
    with Bar(total=count, unit="clip", desc="record") as bar:
        return record_walks(folder, world, count, seed, height, hand, lens, bar.update)


@dataclass(frozen=True)
class Watcher:
    """The policy of a run, as it watches films that it cannot influence.

    Attributes:
        name: name of the run, for progress bars.
        policy: the policy.
        names: names of its actions.
        eye: the camera through which it sees films.
        known: its other inputs, as at the start of an episode.
    """

    name: str
    policy: TensorDictModuleBase
    names: Sequence[str]
    eye: Eye
    known: TensorDictBase

    @classmethod
    def of_run(
        cls,
        folder: Path,
        checkpoint: str | None = None,
        device: str | None = None,
        allow_targets: Sequence[str] = (),
        fov: float | None = None,
        place: Sequence[str] = (),
    ) -> "Watcher":
        """Load the policy of a run folder.

        Args:
            folder: the run folder.
            checkpoint: last or best; None takes the run's own setting.
            device: device of the policy; None takes the run's own setting.
            allow_targets: your own packages from which the run's config may build objects.
            fov: horizontal field of view of the films, degrees; None takes that of the policy's camera.
            place: overrides of the place in which the policy is loaded, such as ``scene.path`` of a scene that has
                moved.

        Raises:
            ValueError: for a task whose actions have no names.
        """
        cfg = config_elsewhere(folder, place, allow_targets)
        torch.set_num_threads(cfg.threads)
        trained = load_policy(folder, checkpoint, device, cfg, place=place)
        motion, policy, begun = trained.world.task.motion, trained.policy, trained.beginning()
        if not motion.action_names:
            raise ValueError(
                f"task: expected a motion with named actions, got {type(motion).__name__}; run_policy.py of "
                "splatrl-export prints continuous actions"
            )
        known = begun.select(*(key for key in policy.in_keys if key != "pixels"), strict=False)
        height, width, channels = begun["pixels"].shape[1:]
        eye = Eye(height, width, channels // 3, trained.world.robot.fov_deg, fov)
        return cls(folder.name, policy, motion.action_names, eye, known)

    def score(self, clips: Path) -> list[ClipResult]:
        """Score the policy on a folder of clips; a line says for each what it does not see of its field of view."""
        found = read_clips(clips, self.names)
        for clip in found:
            _tell(self.eye, clip.source)
        with Bar(unit="frame", desc=self.name) as bar:
            return match(self.policy, self.names, found, self.eye, self.known, bar.update)

    def film(self, film: Path, output: Path) -> list[Path]:
        """Overlay a film with what the policy would do; see ``draw_film``."""
        _tell(self.eye, film)
        output.parent.mkdir(parents=True, exist_ok=True)
        with Bar(unit="frame", desc=self.name) as bar:
            return draw_film(self.policy, self.names, film, self.eye, output, self.known, bar.update)


def _tell(eye: Eye, film: Path) -> None:
    """Print which part of a policy's field of view a film shows, unless that is all of it."""
    first = next(film_images(film), None) if film.exists() else None
    if first is not None and (note := eye.note(first)):
        print(f"{film} {note}")


def score_experiment(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Score finished runs on clips recorded in altered versions of their scenes.

    The clips are recorded anew each time, since those of an earlier scoring may show the scene as it was then.

    Args:
        runs: finished runs with the same task, in one or several scenes.
        folder: folder of the experiment; clips are written to ``clips/<scene>``.

    Returns:
        One row per run and clip: ``run`` (name of its folder), ``clip``, ``frames``, ``matches`` and ``mass``.
    """
    clips = {run.scene: folder / "clips" / run.scene for run in runs}
    for run in {run.scene: run for run in reversed(runs)}.values():
        shutil.rmtree(clips[run.scene], ignore_errors=True)
        clips[run.scene].parent.mkdir(parents=True, exist_ok=True)
        with new_folder(clips[run.scene]) as whole:
            record_clips(build_one_world(altered(run_config(run.folder), 0)), whole)
    return [
        {"run": run.folder.name, "clip": one.name, **asdict(one)}
        for run in runs
        for one in Watcher.of_run(run.folder).score(clips[run.scene])
    ]
