"""Tests a finished training from its whole start set, and writes numbers and pictures into the run folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from splatrl.envs.world import World
from splatrl.evaluation.pictures import Pictures
from splatrl.evaluation.report import summarise, write_json
from splatrl.evaluation.rollouts import run_episodes, spread

EPISODES_IN_VIDEO = 4


@dataclass(frozen=True)
class EvaluationSettings:
    """How a policy is tested.

    Attributes:
        checkpoint: last or best.
        starts: largest number of starts, evenly spaced over the start set.
        repeats: sampled episodes from each start.
        batch_size: number of robots in parallel.
        seed: seed of the sampling.
    """

    checkpoint: str
    starts: int
    repeats: int
    batch_size: int
    seed: int


def evaluate(
    world: World,
    policy: TensorDictModuleBase,
    checkpoint: dict[str, Any],
    folder: Path,
    settings: EvaluationSettings,
    seed: int,
    video: bool = True,
) -> tuple[dict[str, Any], list[Path]]:
    """Test a policy, and write ``evaluation.json`` and the pictures.

    Args:
        world: world in which the policy is tested.
        policy: reads an observation, writes ``action``.
        checkpoint: the policy's checkpoint, which holds facts about the training.
        folder: the run folder.
        settings: how the policy is tested.
        seed: seed of the training, for the report.
        video: whether to record a video.

    Returns:
        The content of ``evaluation.json``, and the pictures' files.
    """
    plan = world.plan
    rows = spread(plan.start_rows, settings.starts)
    starts = plan.states[rows]
    repeated = starts.repeat_interleave(settings.repeats, 0)
    env = world.env(min(settings.batch_size, len(repeated)))
    with tqdm(total=len(repeated) + len(starts), unit="episode", desc="evaluate", dynamic_ncols=True) as bar:
        sampled = run_episodes(env, policy, repeated, True, settings.seed, bar.update)
        argmax = run_episodes(env, policy, starts, False, settings.seed, bar.update)
    ends = plan.field is not None and world.task.goals_for_success is None
    summary: dict[str, Any] = summarise(sampled, argmax, plan.distance[rows] if ends else None)
    summary |= {
        "frames": checkpoint["ppo"]["frames"],
        "wall_seconds": checkpoint["seconds"],
        "level": int(checkpoint["ppo"]["env"]["curriculum.progress"][0]) + 1,
        "checkpoint": settings.checkpoint,
        "seed": seed,
        "start_poses": len(plan.start_rows),
        "evaluated_starts": len(starts),
        "longest_path": int(plan.distance[plan.start_rows].max()),
    }
    write_json(folder / "evaluation.json", summary)
    pictures = Pictures(world.scene.gaussians, world.occupancy, plan, env, folder)
    files = [pictures.learning_curve(checkpoint["history"])]
    if plan.field is not None:
        files += [pictures.starts(sampled), pictures.success_map(sampled)]
    if video:
        files.append(pictures.video(world.env(EPISODES_IN_VIDEO), policy, settings.seed))
    return summary, files


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """The results of an evaluation, in words."""
    rates = [f"success {summary['success_rate']:.3f} (argmax {summary['success_rate_argmax']:.3f})"]
    rates.append(f"SPL {summary['spl']:.3f}" if "spl" in summary else f"return {summary['mean_return']:.1f}")
    if summary["mean_goals"] > summary["success_rate"]:  # in tasks that go on after a goal
        rates.append(f"{summary['mean_goals']:.2f} goals an episode")
    rates.append(f"collisions {summary['collision_rate']:.3f}")
    where = f"over {summary['evaluated_starts']:,} of {summary['start_poses']:,} start poses"
    level = f"curriculum level {summary['level']}"
    return [
        f"{', '.join(rates)} {where}",
        f"{summary['frames']:,} frames in {summary['wall_seconds']:.0f} s, {level}",
    ]
