"""``splatrl-train``: train a policy, evaluate it, and leave pictures in the run folder."""

import sys
from pathlib import Path

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from splatrl.build import build_trainer, build_world
from splatrl.commands.evaluate import evaluate_run
from splatrl.configuration import check_config, command_line, conf_dir, resumed_config, save_config
from splatrl.device import device_line


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="train")
def run(cfg: DictConfig) -> None:
    """Train and evaluate what a config describes, or resume a run folder."""
    resume = cfg.resume
    folder = Path(resume or HydraConfig.get().runtime.output_dir)
    if resume:
        cfg = resumed_config(folder, HydraConfig.get().overrides.task)
    elif any(folder.glob("checkpoints/*.pt")):
        raise ValueError(f"hydra.run.dir: expected a new folder, got a run; continue it with resume={folder}")
    check_config(cfg)
    save_config(cfg, folder)
    torch.set_num_threads(cfg.threads)
    world = build_world(cfg)
    print(device_line(world.device))
    trainer = build_trainer(cfg, world, folder)
    if resume:
        trainer.resume()
    trainer.fit()
    evaluate_run(cfg, folder, world)


def main() -> None:
    """Entry point of the command."""
    sys.argv[1:] = command_line("train", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
