"""Tests of policies in scenes other than the one in which they were trained."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from splatrl.building import build_world
from splatrl.configuration import placed, run_config
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.report import summarise
from splatrl.evaluation.rollouts import run_episodes
from splatrl.evaluation.starts import spread_starts
from splatrl.experiments.experiment import Run
from splatrl.runs import load_policy
from splatrl.waits import Bar, late_bar

KEPT = ("success_rate", "success_rate_argmax", "collision_rate", "timeout_rate", "step_spl", "spl", "soft_spl")


def score_everywhere(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Test finished runs in every scene in which any of them was trained, without pose noise.

    Starts are spread over the whole start set of the test scene.

    Args:
        runs: finished runs with the same task and motion.
        folder: folder of the experiment; nothing is written to it.

    Returns:
        One row per run and scene: ``run`` (name of its folder), ``place`` (name of the scene), ``starts`` and rates.
    """
    return score_in(runs, {run.scene: run_config(run.folder) for run in reversed(runs)})


def score_in(runs: Sequence[Run], places: Mapping[str, DictConfig]) -> list[dict[str, Any]]:
    """Test finished runs in each of the given places without pose noise; see ``score_everywhere``.

    Args:
        runs: finished runs with the same task and motion.
        places: config of each place, by name; its scene, robot and task replace a run's own.
    """
    worlds: dict[tuple[str, str], World | Worlds] = {}
    rows = []
    for run in Bar(runs, unit="run", desc="tests"):
        own = run_config(run.folder)
        for name, place in places.items():
            cfg = placed(own, place)
            cfg.transforms.pose_noise = {}
            key = name, OmegaConf.to_yaml({"of": [cfg.sensors, cfg.transforms, cfg.network]})  # what envs depend on
            if key not in worlds:
                worlds[key] = build_world(cfg)
            rows.append({"run": run.folder.name, "place": name, **tested(run.folder, cfg, worlds[key])})
    return rows


def tested(folder: Path, cfg: DictConfig, world: World | Worlds) -> dict[str, Any]:
    """Test a run's policy in a world, from starts spread over its start set, and return the rates.

    Args:
        folder: the run folder.
        cfg: config with which the policy is tested.
        world: world built from ``cfg``.
    """
    torch.set_num_threads(cfg.threads)
    policy, starts = load_policy(folder, cfg=cfg, world=world).policy, spread_starts(world, cfg.evaluation.starts)
    env = world.env(min(cfg.evaluation.batch_size, len(starts.state)))
    with late_bar(folder.name, 2 * len(starts.state), "episode") as bar:
        sampled, argmax = (
            run_episodes(env, policy, starts.state, way, cfg.evaluation.seed, bar.update, starts.scene, starts.memory)
            for way in (True, False)
        )
    summary = summarise(sampled, argmax, starts.distance if world.planned else None)
    return {"starts": len(starts.state), **kept(summary)}


def kept(summary: Mapping[str, float]) -> dict[str, float]:
    """Select the rates that are reported of a test from the output of ``summarise``."""
    return {key: summary[key] for key in KEPT if key in summary}
