"""``splatrl-clips``: compare what trained policies do in labelled clips with the labels, and record such clips."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import hydra
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from tqdm import tqdm

from splatrl.cameras import Cameras
from splatrl.configuration import check_overrides, conf_dir, require_values, run_config
from splatrl.envs.tasks.base import SeenGoal
from splatrl.envs.transforms import overlay, sprite_among
from splatrl.evaluation.clip_files import new_folder, read_clips
from splatrl.evaluation.clips import ClipResult, match, table, total
from splatrl.evaluation.report import write_json
from splatrl.evaluation.walk_looks import Lens
from splatrl.evaluation.walks import Hand, Overlay, record_walks
from splatrl.files import replacing
from splatrl.scenes.scene import BACKYARD
from splatrl.training import load_checkpoint
from splatrl.world import World, build_model, build_world

REPORT = "clips"
HEADLINE = (
    "Share of labelled frames in which the policy's most probable action is one of the label's; "
    "in brackets the mean probability that it gives to the label's actions together."
)


class TrainedRun(Protocol):
    """What scoring an experiment needs to know of a training."""

    @property
    def scene(self) -> str: ...

    @property
    def folder(self) -> Path: ...


def altered(cfg: DictConfig, seed: int) -> DictConfig:
    """The config of a run in a scene that training never saw so.

    The backyard gets other leaves and grass, and its small things stand elsewhere; any scene is drawn in the classic
    way, and every Gaussian of it.

    Args:
        cfg: of the run.
        seed: from 0; each gives another backyard.
    """
    cfg = cfg.copy()
    if cfg.scene.path == BACKYARD:
        cfg.scene.seed, cfg.scene.clutter = cfg.scene.seed + 1000 + seed, 1 + seed
    for key, value in (("antialiased", False), ("tolerance", 0.0)):
        if key in cfg.renderer.views:
            cfg.renderer.views[key] = value
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
    """Record walks in a world as clips, with a progress bar; see ``record_walks``.

    Args:
        world: of an ``altered`` config.
        folder: of the clips.
        count: of clips.
        seed: of all that is random in them.
        height: of the images, pixels.
        hand: how the camera sways.
        lens: what the cameras are like.
    """
    sprite = _sprite(world)
    names = action_names(world)
    with tqdm(total=count, unit="clip", desc="record", dynamic_ncols=True) as bar:
        return record_walks(
            folder, world.plan, world.robot, world.renderer, names, count, seed, height, hand, lens, sprite, bar.update
        )


def action_names(world: World) -> tuple[str, ...]:
    """Names of a task's actions, in their order.

    Raises:
        ValueError: for a task whose actions have none.
    """
    names = getattr(world.task.motion, "action_names", None)
    if names is None:
        raise ValueError(f"task: expected actions with names, got {type(world.task.motion).__name__}")
    return tuple(names)


def _sprite(world: World) -> Overlay | None:
    """Draws the sprite of a world where its task has it; None without one."""
    drawn = sprite_among(world.make_transforms())
    if drawn is None:
        return None
    target = drawn.position
    if target is None:
        assert isinstance(world.task, SeenGoal), world.task
        target = world.task.targets(world.plan.states[world.plan.start_rows[:1]])[0]
    sprite, size, near = drawn.sprite, drawn.size, drawn.near

    def draw(pixels: Tensor, depth: Tensor, cameras: Cameras) -> Tensor:
        return overlay(pixels, depth, cameras.camera_to_world, cameras.K[0], target, sprite, size, near)[0]

    return draw


def trained_policy(
    folder: Path, cfg: DictConfig, world: World
) -> tuple[TensorDictModuleBase, Sequence[int], TensorDictBase]:
    """A run's policy, the shape (H, W, C) of its image, and what else it reads where an episode begins, [1].

    Args:
        folder: of the run.
        cfg: of the run.
        world: built from it.
    """
    state = load_checkpoint(folder / "checkpoints" / f"{cfg.evaluation.checkpoint}.pt")
    env = world.env(1)
    model = build_model(cfg, env)
    model.load_state_dict(state["ppo"]["model"])
    policy = model.get_policy_operator()
    others = [key for key in policy.in_keys if key != "pixels"]
    return policy, env.observation_spec["pixels"].shape[1:], env.reset().select(*others, strict=False)


def score_run(folder: Path, clips: Path, checkpoint: str | None = None, device: str | None = None) -> list[ClipResult]:
    """Show clips to the policy of a run folder.

    Args:
        folder: of the run.
        clips: folder of clips.
        checkpoint: last or best; None takes the run's own setting.
        device: of the policy; None takes the run's own setting.
    """
    cfg = run_config(folder)
    cfg.device = device or cfg.device
    if checkpoint is not None:
        cfg.evaluation.checkpoint = checkpoint
    torch.set_num_threads(cfg.threads)
    world = build_world(cfg)
    names = action_names(world)
    policy, image_shape, start = trained_policy(folder, cfg, world)
    found = read_clips(clips, names)
    with tqdm(unit="frame", desc=folder.name, dynamic_ncols=True) as bar:
        return match(policy, names, found, image_shape, start, bar.update)


def score_experiment(runs: Sequence[TrainedRun], folder: Path) -> list[dict[str, Any]]:
    """Score finished runs on recorded clips of their scenes, which are recorded where there are none yet.

    Args:
        runs: trained in one or several scenes, with the same task.
        folder: of the experiment; clips are in ``clips/<scene>``.

    Returns:
        A row a run and clip: ``run`` (name of its folder), ``clip``, ``frames``, ``matches`` and ``mass``.
    """
    rows = []
    for run in runs:
        clips = folder / "clips" / run.scene
        if not clips.is_dir():
            clips.parent.mkdir(parents=True, exist_ok=True)
            with new_folder(clips) as whole:
                record_clips(build_world(altered(run_config(run.folder), 0)), whole)
        for one in score_run(run.folder, clips):
            rows.append({"run": run.folder.name, "clip": one.name, **asdict(one)})
    return rows


def write_report(results: Mapping[str, Sequence[ClipResult]], folder: Path) -> str:
    """Write ``clips.md`` and ``clips.json``; returns the former.

    Args:
        results: of each run, on the same clips.
        folder: where to.
    """
    page = f"{HEADLINE}\n\n{table(results)}"
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        run: {"clips": [asdict(one) | {"rate": one.rate} for one in found], "rate": total(found).rate}
        for run, found in results.items()
    }
    write_json(folder / f"{REPORT}.json", content)
    with replacing(folder / f"{REPORT}.md") as stream:
        stream.write(page.encode())
    return page


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="clips")
def run(cfg: DictConfig) -> None:
    """Record clips, score the runs of ``cfg.run`` on clips, or first the one and then the other."""
    require_values(cfg)
    runs = [str(one) for one in cfg.run] if isinstance(cfg.run, ListConfig) else [str(cfg.run)]
    if cfg.record is None and cfg.clips is None:
        raise ValueError("clips: expected a folder of clips, or record: one to record some into, got neither")
    if len(set(runs)) < len(runs) or not runs:
        raise ValueError(f"run: expected different run folders, got {', '.join(runs) or 'none'}")
    if cfg.record is not None:
        own = run_config(Path(runs[0]))
        own.device = cfg.device or own.device
        torch.set_num_threads(own.threads)
        world = build_world(altered(own, cfg.seed))
        settings = (cfg.count, cfg.seed, cfg.height, instantiate(cfg.hand), instantiate(cfg.lens))
        written = record_clips(world, Path(cfg.record), *settings)
        print(f"{len(written)} clips in {cfg.record}")
    if cfg.clips is not None:
        results = {name: score_run(Path(name), Path(cfg.clips), cfg.checkpoint, cfg.device) for name in runs}
        folder = Path(cfg.output or cfg.clips)
        print(write_report(results, folder))
        print(f"{folder / REPORT}.md, {folder / REPORT}.json")


def main() -> None:
    """Entry point of the command."""
    check_overrides("clips", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
