"""``splatrl-evaluate``: evaluate a finished or interrupted run from every pose of its start set."""

import sys
from pathlib import Path
from typing import Any

import hydra
import torch
from omegaconf import DictConfig, OmegaConf

from splatrl.commands.faults import in_one_line
from splatrl.configuration import check_config, command_line, conf_dir, run_config
from splatrl.envs.world import World, Worlds
from splatrl.evaluation.evaluate import EvaluationSettings, evaluate, summary_lines
from splatrl.runs import load_policy
from splatrl.training import Actor


def evaluate_run(cfg: DictConfig, folder: Path, world: World | Worlds | None = None) -> dict[str, Any]:
    """Evaluate a run folder with a config, and print the results.

    Args:
        cfg: config of the run, with the settings of the evaluation.
        folder: the run folder.
        world: world built from ``cfg``, if there is one already.
    """
    trained = load_policy(folder, cfg=cfg, world=world)
    settings = EvaluationSettings(**cfg.evaluation)
    policy, checkpoint = Actor(trained.model, judges=False), trained.checkpoint
    summary, files = evaluate(trained.world, policy, checkpoint, folder, settings, cfg.seed, cfg.logger.video)
    print("\n".join(summary_lines(summary)))
    print(f"pictures in {folder}: {', '.join(str(path.relative_to(folder)) for path in files)}")
    return summary


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="evaluate")
@in_one_line("splatrl-evaluate")
def run(cfg: DictConfig) -> None:
    """Evaluate the run folder ``cfg.run`` with its own config."""
    check_config(cfg)
    folder = Path(cfg.run)
    own = run_config(folder, cfg.allow_targets)
    for key in ("checkpoint", "starts", "repeats", "seed", "episodes"):
        if cfg[key] is not None:
            OmegaConf.update(own, f"evaluation.{key}", cfg[key])
    own.logger.video = cfg.video
    own.device = cfg.device or own.device
    torch.set_num_threads(own.threads)
    evaluate_run(own, folder)


def main() -> None:
    """Entry point of the command."""
    sys.argv[1:] = command_line("evaluate", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
