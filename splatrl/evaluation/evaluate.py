"""Evaluates a trained policy over its start set, and writes numbers and pictures into the run folder."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase

from splatrl.documents import write_json
from splatrl.envs.transforms import simulated
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.episode_sets import EPISODES
from splatrl.evaluation.pictures import START_MAP, SUCCESS_MAP, VIDEO, Pictures
from splatrl.evaluation.report import by_scene, summarise
from splatrl.evaluation.rollouts import Episodes, run_episodes
from splatrl.evaluation.starts import Chosen, given_episodes, save_episodes, some_in, spread_starts
from splatrl.evaluation.training_figures import learning_curve, scene_bars
from splatrl.files import refusing
from splatrl.values import tenths
from splatrl.waits import Bar

Policy = Callable[[TensorDictBase], TensorDictBase]
RESULTS, BARS = "evaluation.json", "scenes.png"
EPISODES_IN_VIDEO = 4
SCENES_SHOWN = 4
"""Maximum number of scenes that get maps and a video of their own: the first ones that have episodes."""
FRAMES_IN_VIDEOS = 1200
"""Approximate total of frames in all these videos: each frame is rendered large, while the user waits."""


@dataclass(frozen=True)
class EvaluationSettings:
    """Settings of an evaluation.

    Attributes:
        checkpoint: which checkpoint to test, last or best.
        starts: maximum number of starts, evenly spaced over the start set; of a file of episodes, the first ones.
        repeats: number of sampled episodes from each start.
        batch_size: number of robots in parallel.
        seed: seed of the sampled actions, and of what the env draws, such as looks and apples.
        episodes: file of episodes for a navigation task; None draws them, and writes them into the run folder.
    """

    checkpoint: str
    starts: int
    repeats: int
    batch_size: int
    seed: int
    episodes: str | None = None


def evaluate(
    world: World | Worlds,
    policy: Policy,
    checkpoint: dict[str, Any],
    folder: Path,
    settings: EvaluationSettings,
    seed: int,
    video: bool = True,
) -> tuple[dict[str, Any], list[Path]]:
    """Evaluate a policy, and write the pictures and then ``evaluation.json``.

    Args:
        world: world in which the policy is tested.
        policy: reads an observation, writes ``action``.
        checkpoint: content of the policy's checkpoint, including statistics of the training.
        folder: the run folder.
        settings: settings of the evaluation.
        seed: seed of the training, for the report.
        video: whether to record videos.

    Returns:
        The content of ``evaluation.json``, and the files of the pictures and videos.
    """
    facts = _facts_of_training(checkpoint, folder) | {"evaluation": asdict(settings), "seed": seed}
    facts["transforms"] = simulated(world.make_transforms())
    if settings.episodes is None:
        starts = spread_starts(world, settings.starts)
    else:
        world, starts = given_episodes(world, Path(settings.episodes), settings.starts)
    sampled, argmax = _run(world, policy, starts, settings)
    summary = summarise(sampled, argmax, starts.distance if world.planned else None) | facts
    summary |= _facts_of_starts(world, starts)
    if len(world.names) > 1:
        summary["scenes"] = by_scene(world.names, sampled, argmax)
    if world.task.goal_radius is not None and settings.episodes is None:
        save_episodes(folder / EPISODES, world, starts, world.task.goal_radius)
    files = _draw_curves(checkpoint["history"], summary, folder)
    files += _draw_places(world, policy, starts, sampled, folder, settings.seed, video)
    write_json(folder / RESULTS, summary)  # last, since a run that has it counts as finished
    return summary, files


def remove_results(folder: Path) -> None:
    """Remove what an earlier evaluation found, by which a run would be taken for a finished one.

    The learning curve, which stays true, and the episodes, which do not depend on the policy, are kept.
    """
    for place in (folder, *folder.glob("scenes/*")):
        for name in (RESULTS, BARS, VIDEO, START_MAP, SUCCESS_MAP):
            (place / name).unlink(missing_ok=True)


def _facts_of_training(checkpoint: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return what the report says about the training, from the content of a checkpoint in a run folder."""
    with refusing(folder / "checkpoints", "a training checkpoint"):
        levels = [row["level"] for row in checkpoint["history"] if "level" in row]  # none without a curriculum
        return {
            "frames": int(checkpoint["ppo"]["frames"]),
            "wall_seconds": float(checkpoint["seconds"]),
            "level": int(levels[-1]) if levels else None,
        }


def _facts_of_starts(world: World | Worlds, starts: Chosen) -> dict[str, int]:
    """Return what the report says about the chosen starts and, unless the task draws them, the sets they are from."""
    chosen = {"evaluated_starts": len(starts.state)}
    if world.task.chooses_episodes:
        return chosen
    plans = [one.plan for one in world.worlds]
    longest = max(int(plan.distance[plan.start_rows].max()) for plan in plans)
    return {"start_poses": sum(len(plan.start_rows) for plan in plans), **chosen, "longest_path": longest}


def _run(
    world: World | Worlds, policy: Policy, starts: Chosen, settings: EvaluationSettings
) -> tuple[Episodes, Episodes]:
    """Run the episodes: ``repeats`` from each start with sampled actions, and one with the most probable ones."""
    repeated = starts.repeated(settings.repeats)
    env = world.env(min(settings.batch_size, len(repeated.state)), seed=settings.seed)
    total = len(repeated.state) + len(starts.state)
    with Bar(total=total, unit="episode", desc="evaluate") as bar:
        sampled, argmax = (
            run_episodes(env, policy, chosen.state, how, settings.seed, bar.update, chosen.scene, chosen.memory)
            for chosen, how in ((repeated, True), (starts, False))
        )
    return sampled, argmax


def _draw_curves(history: Sequence[Mapping[str, float]], summary: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the learning curve and, with several scenes, the success in each; return the files."""
    files = [folder / "learning_curve.png"]
    learning_curve(history, files[0])
    if "scenes" in summary:
        files.append(folder / BARS)
        rows = summary["scenes"]
        success, intervals = ([row[key] for row in rows] for key in ("success_rate", "success_interval"))
        scene_bars([row["scene"] for row in rows], success, intervals, files[1])
    return files


def _draw_places(
    world: World | Worlds, policy: Policy, starts: Chosen, sampled: Episodes, folder: Path, seed: int, video: bool
) -> list[Path]:
    """Draw maps of the sampled episodes and, if asked for, a video in each of the first scenes; return the files."""
    files, held = list[Path](), range(1) if starts.scene is None else starts.scene.unique().tolist()
    shown = held[:SCENES_SHOWN]
    for number in shown:
        one, chosen = world.worlds[number], None
        if one.task.goal_radius is not None:
            one, chosen = some_in(world, number, starts, EPISODES_IN_VIDEO)
        elif one.task.chooses_episodes:
            chosen = spread_starts(one, EPISODES_IN_VIDEO)
        place = folder if len(world.names) == 1 else folder / "scenes" / f"{number}-{world.names[number]}"
        place.mkdir(parents=True, exist_ok=True)
        env = one.env(EPISODES_IN_VIDEO if chosen is None else len(chosen.state))
        pictures = Pictures(one.scene.surroundings, one.occupancy, one.plan, env, place)
        if one.plan.field is not None:
            files += [pictures.starts(sampled.of(number)), pictures.success_map(sampled.of(number))]
        if video:
            files.append(pictures.video(env, policy, seed, FRAMES_IN_VIDEOS // len(shown), chosen))
    return files


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """Describe the results of an evaluation in two lines of text."""
    low, high = summary["success_interval"]
    rates = [f"success {summary['success_rate']:.3f}, 95 % CI {low:.3f} to {high:.3f}"]
    rates.append(f"argmax {summary['success_rate_argmax']:.3f}")
    by_steps = f"SPL by steps {summary['step_spl']:.3f}" if "step_spl" in summary else ""
    by_distance = f"SPL {summary['spl']:.3f}, soft SPL {summary['soft_spl']:.3f}" if "spl" in summary else ""
    rates.append(by_distance or by_steps or f"return {tenths(summary['mean_return'])}")
    if summary["mean_goals"] > summary["success_rate"]:  # in tasks that continue after a goal
        rates.append(f"{summary['mean_goals']:.2f} goals per episode")
    if "spl" in summary:
        rates.append(f"{summary['collisions']:.1f} collisions per episode")
        rates.append(f"{summary['distance_to_goal']:.2f} m from the goal at the end")
    else:
        rates.append(f"collisions {summary['collision_rate']:.3f}")
    count = f"over {summary['evaluated_starts']:,}"
    drawn = f"{count} episodes{', each with its own goal' if 'spl' in summary else ''}"
    where = f"{count} of {summary['start_poses']:,} start poses" if "start_poses" in summary else drawn
    under = ", ".join(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower() for name in summary["transforms"])
    level = "" if summary["level"] is None else f", curriculum level {summary['level']}"
    return [
        f"{', '.join(rates)} {where}{f', under {under}' if under else ''}",
        f"{summary['frames']:,} frames in {summary['wall_seconds']:.0f} s{level}",
    ]
