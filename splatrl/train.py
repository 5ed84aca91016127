"""``splatrl-train``: train a policy, evaluate it, and leave pictures in the run folder."""

import sys
from pathlib import Path

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig

from splatrl.configuration import check_overrides, conf_dir, require_values, resumed_config, save_config
from splatrl.device import AUTO, device_line
from splatrl.evaluate import evaluate
from splatrl.evaluation.rollouts import run_episodes, spread
from splatrl.training import PPO, Trainer
from splatrl.world import World, build_model, build_world


def make_trainer(cfg: DictConfig, world: World, folder: Path) -> Trainer:
    """Build the learner and the loop around it.

    Args:
        cfg: the whole config.
        world: what the envs share.
        folder: the run folder.
    """
    curriculum = instantiate(cfg.curriculum)(world.plan)
    env = world.env(cfg.env.num_envs, curriculum, cfg.seed)
    torch.manual_seed(cfg.seed)
    model = build_model(cfg, env)
    loss, optim, collector = instantiate(cfg.loss), instantiate(cfg.optim), cfg.collector
    ppo = PPO(env, model, loss, optim, collector.frames_per_batch, collector.total_frames, _cuda_graph(collector))
    starts = world.plan.states[spread(world.plan.start_rows, cfg.logger.num_test_episodes)]
    test_env = world.env(min(cfg.env.num_envs, len(starts)), seed=cfg.seed)

    def test() -> float:
        return (
            run_episodes(test_env, model.get_policy_operator(), starts, seed=cfg.evaluation.seed)
            .success.double()
            .mean()
            .item()
        )

    logger, checkpoint = cfg.logger, cfg.checkpoint
    return Trainer(ppo, folder, test, logger.test_interval, checkpoint.interval, logger.backend, logger.exp_name)


def _cuda_graph(collector: DictConfig) -> bool | None:
    """Whether to capture steps; None where that is left to what there is, as in runs of before there were graphs.

    Raises:
        ValueError: for anything but true, false and auto.
    """
    choice = collector.get("cuda_graph", AUTO)
    if choice not in (True, False, AUTO):
        raise ValueError(f"collector.cuda_graph: expected true, false or auto, got {choice}")
    return None if choice == AUTO else choice


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="train")
def run(cfg: DictConfig) -> None:
    """Train and evaluate what a config describes, or go on with what a run folder holds."""
    resume = cfg.resume
    folder = Path(resume or HydraConfig.get().runtime.output_dir)
    if resume:
        cfg = resumed_config(folder, HydraConfig.get().overrides.task)
    elif any(folder.glob("checkpoints/*.pt")):
        raise ValueError(f"hydra.run.dir: expected a new folder, got a run; go on with it by resume={folder}")
    require_values(cfg)
    save_config(cfg, folder)
    torch.set_num_threads(cfg.threads)
    world = build_world(cfg)
    print(device_line(world.device))
    trainer = make_trainer(cfg, world, folder)
    if resume:
        trainer.resume()
    trainer.fit()
    evaluate(cfg, folder, world)


def main() -> None:
    """Entry point of the command."""
    check_overrides("train", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
