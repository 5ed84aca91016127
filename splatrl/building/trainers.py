"""Builds policies and their trainers."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs import EnvBase
from torchrl.modules import ActorValueOperator

from splatrl.building.envs import worker_seed
from splatrl.building.instantiation import instantiate
from splatrl.building.misfits import check_stack, warn_of_unknown_goal
from splatrl.configuration import with_absolute_paths
from splatrl.datasets import (
    Demonstrations,
    Imitation,
    check_imitation,
    check_taught,
    planner_episodes,
    read_demonstrations,
    teacher_episodes,
)
from splatrl.device import AUTO
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.episode_sets import require_episodes
from splatrl.evaluation.rollouts import run_episodes
from splatrl.evaluation.starts import spread_starts
from splatrl.files import expanded
from splatrl.made_with import actions_of, made_with
from splatrl.training import (
    KEPT,
    PPO,
    Actor,
    Cloner,
    Matcher,
    Stage,
    Trainer,
    check_frames,
    check_reads,
    check_tracker,
    inputs_of,
    make_tracker,
    views,
)
from splatrl.values import require_number
from splatrl.waits import Bar, late_bar


def build_model(cfg: DictConfig, env: EnvBase) -> ActorValueOperator:
    """Build the actor and critic for an env; their initial weights come from PyTorch's global generator."""
    image_shape = env.observation_spec["pixels"].shape[1:]
    inputs = inputs_of(cfg.get("inputs") or {}, env.observation_spec)
    given = {"inputs": inputs} if inputs else {}
    if told := inputs_of(cfg.get("critic_inputs") or {}, env.observation_spec, "critic_inputs"):
        given["critic_inputs"] = told
    return instantiate(cfg.network)(image_shape, env.action_spec, **given).to(env.device)


def check_training(cfg: DictConfig, new: bool) -> None:
    """Refuse settings that only a trainer or the evaluation would notice, before a world is built, which takes long.

    Args:
        cfg: the complete config.
        new: whether the training begins, and has yet to learn from demonstrations.

    Raises:
        FileNotFoundError: for episodes or demonstrations that do not exist.
        ImportError: if the package of ``logger.backend`` is not installed.
        ValueError: for a setting out of range, settings that do not fit each other, or damaged demonstrations.
    """
    check_frames(cfg.collector.frames_per_batch, cfg.collector.total_frames, cfg.env.num_envs)
    check_tracker(cfg.logger.backend, cfg.logger.exp_name)
    if cfg.evaluation.episodes is not None:
        require_episodes(Path(str(cfg.evaluation.episodes)))
    for node in ("loss", "optim", "cloning"):
        instantiate(cfg[node])
    dagger, matching = instantiate(cfg.dagger), instantiate(cfg.matching)
    if not new:
        return
    shown = sum(map(len, _demonstrations(cfg)))
    if cfg.demos is None and dagger.last_epochs and not dagger.rounds:
        raise ValueError(f"dagger.last_epochs: expected 0 without dagger.rounds and demos, got {dagger.last_epochs}")
    if matching.frames:
        check_reads(list(cfg.inputs) or ["pixels"])
    check_taught(dagger, cfg.env.num_envs, cfg.collector.total_frames, shown, matching.frames)


def build_trainer(
    cfg: DictConfig, world: World | Worlds, folder: Path, resumes: Callable[[Any, Any], None] | None = None
) -> Trainer:
    """Build the learner and the training loop around it.

    Args:
        cfg: the complete config.
        world: everything that the envs share.
        folder: the run folder.
        resumes: continues the training in the folder, unless this refuses its ``made_with``, given that of the config
            and then that of the checkpoint; None begins a training. Demonstrations are read only if the policy has not
            yet learned from them.
    """
    read = list(cfg.get("inputs") or ["pixels"])
    check_stack(world.make_transforms(), read)
    curriculum = instantiate(cfg.curriculum)([one.plan for one in world.worlds])
    env = world.env(cfg.env.num_envs, curriculum, cfg.seed)
    torch.manual_seed(cfg.seed)
    model = build_model(cfg, env)
    loss, optim, collector = instantiate(cfg.loss), instantiate(cfg.optim), cfg.collector
    ppo = PPO(
        env, model, loss, optim, collector.frames_per_batch, collector.total_frames, _cuda_graph(collector.cuda_graph)
    )
    teaching = _teaching(cfg, world, ppo, folder) if resumes is None else []  # refuses before anything is written
    warn_of_unknown_goal(world.task, world.sensors, read)
    starts = spread_starts(world, cfg.logger.num_test_episodes)
    test_env = world.env(min(cfg.env.num_envs, len(starts.state)), seed=cfg.seed)

    def test() -> dict[str, float]:
        test_env.set_seed(cfg.logger.test_seed)  # a test depends on the policy alone, not on the tests before it
        actor, seed = Actor(model, judges=False), cfg.logger.test_seed
        with late_bar("test", len(starts.state), "episode") as bar:
            episodes = run_episodes(test_env, actor, starts.state, True, seed, bar.update, starts.scene, starts.memory)
        result = {"success": episodes.success.double().mean().item()}
        if world.task.goals_for_success is not None:
            result["goals"] = episodes.goals.double().mean().item()
        if measures := episodes.navigation():
            result["spl"] = measures["spl"]
        return result

    logger, checkpoint, plain = cfg.logger, cfg.checkpoint, cast(dict[str, Any], OmegaConf.to_container(cfg))
    made = {**made_with(with_absolute_paths(cfg), world.digest), "actions": actions_of(world.task.motion)}
    trainer = Trainer(
        ppo,
        folder,
        test,
        logger.test_interval,
        checkpoint.interval,
        made_with=made,
        prepare=teaching,
    )
    if resumes is not None:
        trainer.resume(partial(resumes, made))
        trainer.prepare = [] if trainer.prepared else _teaching(cfg, world, ppo, folder)
    trainer.tracker = make_tracker(
        logger.backend, folder, logger.exp_name, logger.project, logger.online, plain, ppo.frames
    )
    return trainer


def _teaching(cfg: DictConfig, world: World | Worlds, ppo: PPO, folder: Path) -> list[Stage]:
    """Return the stages of teaching that precede learning from reward: matching, then cloning and DAgger.

    Matching is left out if it is done, as after an interruption: it comes first, and alone is saved before all is done.

    Raises:
        ValueError: if ``demos`` is neither a folder of demonstrations nor a number, or for settings that do not
            fit each other, the policy, the task or the frame budget.
    """
    cloning, dagger, matching = instantiate(cfg.cloning), instantiate(cfg.dagger), instantiate(cfg.matching)
    shown = _demonstrations(cfg)
    for one in shown:
        one.warn_of_another_scene(world)
    if cfg.demos is None and not dagger.rounds and not matching.frames:
        return []
    check_imitation(world, dagger, 0 if shown else cfg.demos or 0)
    check_taught(dagger, cfg.env.num_envs, ppo.total_frames, sum(map(len, shown)), matching.frames)
    matcher = Matcher(ppo.model, matching) if matching.frames else None

    def match() -> Iterator[dict[str, float]]:
        assert matcher is not None
        env = world.env(cfg.env.num_envs, seed=worker_seed(cfg.seed, 1))
        loss = matcher.fit(views(env, matching.frames))  # keep no reference: the views take gigabytes
        ppo.frames += matching.frames
        yield {"loss_matching": loss}

    def episodes() -> list[Demonstrations]:
        return shown or _recorded(world, cfg.demos, cfg.seed)

    cloner, kept = Cloner(ppo.model, cloning), folder / KEPT
    seed = worker_seed(cfg.seed, 0)
    teach = Imitation(ppo, cloner, world, episodes if cfg.demos is not None else None, dagger, seed, kept)
    return [match, teach] if matching.frames and ppo.frames == 0 else [teach]


def _demonstrations(cfg: DictConfig) -> list[Demonstrations]:
    """Open the folder of demonstrations that a config names; empty if it names none."""
    if isinstance(cfg.demos, str):
        return [read_demonstrations(expanded(cfg.demos))]
    if cfg.demos is not None:
        require_number("demos", cfg.demos, 1, 10**6, whole=True)
    return []


def _recorded(world: World | Worlds, episodes: int, seed: int) -> list[Demonstrations]:
    """Record episodes of the task's teacher, or else of the planner, divided evenly among the scenes."""
    every, record = len(world.worlds), teacher_episodes if world.worlds[0].task.teaches else planner_episodes
    shares = [(episodes + every - 1 - number) // every for number in range(every)]
    with Bar(total=episodes, unit="episode", desc="demonstrate", leave=False) as bar:
        return [record(one, share, seed, bar.update) for one, share in zip(world.worlds, shares, strict=True) if share]


def _cuda_graph(choice: bool | str) -> bool | None:
    """Return whether to capture steps in a CUDA graph; None for auto.

    Raises:
        ValueError: for anything but true, false and auto.
    """
    if choice == AUTO:
        return None
    if not isinstance(choice, bool):
        raise ValueError(f"collector.cuda_graph: expected true, false or auto, got {choice}")
    return choice
