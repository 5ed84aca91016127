"""``splatrl-evaluate``: evaluate a finished or interrupted run from every pose of its start set."""

import sys
from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from splatrl.configuration import check_overrides, conf_dir, require_values, run_config
from splatrl.evaluation.pictures import Pictures
from splatrl.evaluation.report import summarise, write_json
from splatrl.evaluation.rollouts import run_episodes, spread
from splatrl.training import load_checkpoint
from splatrl.world import World, build_model, build_world

EPISODES_IN_VIDEO = 4


def evaluate(cfg: DictConfig, folder: Path, world: World) -> dict[str, Any]:
    """Evaluate a checkpoint of a run folder, write ``evaluation.json`` and the pictures there, and print what came out.

    Args:
        cfg: of the run.
        folder: the run folder.
        world: built from ``cfg``.
    """
    settings = cfg.evaluation
    state = load_checkpoint(folder / "checkpoints" / f"{settings.checkpoint}.pt")
    rows = spread(world.plan.start_rows, settings.starts)
    starts = world.plan.states[rows]
    repeated = starts.repeat_interleave(settings.repeats, 0)
    env = world.env(min(settings.batch_size, len(repeated)))
    model = build_model(cfg, env)
    model.load_state_dict(state["ppo"]["model"])
    policy = model.get_policy_operator()
    with tqdm(total=len(repeated) + len(starts), unit="episode", desc="evaluate", dynamic_ncols=True) as bar:
        sampled = run_episodes(env, policy, repeated, True, settings.seed, bar.update)
        argmax = run_episodes(env, policy, starts, False, settings.seed, bar.update)
    summary: dict[str, Any] = summarise(sampled, argmax, world.plan.distance[rows])
    summary |= {
        "frames": state["ppo"]["frames"],
        "wall_seconds": state["seconds"],
        "level": int(state["ppo"]["env"]["curriculum.progress"][0]) + 1,
        "checkpoint": settings.checkpoint,
        "seed": cfg.seed,
        "start_poses": len(world.plan.start_rows),
        "evaluated_starts": len(starts),
        "longest_path": int(world.plan.distance[world.plan.start_rows].max()),
    }
    write_json(folder / "evaluation.json", summary)
    pictures = Pictures(world.scene.gaussians, world.occupancy, world.plan, env, folder)
    files = [
        pictures.learning_curve(state["history"]),
        pictures.starts(sampled),
        pictures.success_map(sampled),
    ]
    if cfg.logger.video:
        files.append(pictures.video(world.env(EPISODES_IN_VIDEO), policy, settings.seed))
    print(_words(summary, folder, files))
    return summary


def _words(summary: dict[str, Any], folder: Path, files: list[Path]) -> str:
    lines = [
        f"success {summary['success_rate']:.3f} (argmax {summary['success_rate_argmax']:.3f}), "
        f"SPL {summary['spl']:.3f}, collisions {summary['collision_rate']:.3f} "
        f"over {summary['evaluated_starts']:,} of {summary['start_poses']:,} start poses",
        f"{summary['frames']:,} frames in {summary['wall_seconds']:.0f} s, curriculum level {summary['level']}",
        f"pictures in {folder}: {', '.join(path.name for path in files)}",
    ]
    return "\n".join(lines)


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="evaluate")
def run(cfg: DictConfig) -> None:
    """Evaluate the run folder ``cfg.run`` with its own config."""
    require_values(cfg)
    folder = Path(cfg.run)
    own = run_config(folder)
    for key in ("checkpoint", "repeats", "seed"):
        if cfg[key] is not None:
            OmegaConf.update(own, f"evaluation.{key}", cfg[key])
    own.logger.video = cfg.video
    own.device = cfg.device or own.device
    torch.set_num_threads(own.threads)
    evaluate(own, folder, build_world(own))


def main() -> None:
    """Entry point of the command."""
    check_overrides("evaluate", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
